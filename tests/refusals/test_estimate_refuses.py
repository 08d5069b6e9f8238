"""Recordings that cannot carry an estimate, settings that make no sense, and the sentences that say so."""

from dataclasses import replace

import numpy as np
import pytest
from bench_nouns import Block, LoopSetup, RecordingInfo, Settings
from scipy.signal import lfilter

import loopshape as ls
from loopshape.identify.frequency_response import estimate_frf
from loopshape.identify.matrix.matrix import estimate_matrix

RATE, N = 100.0, 4000
LOOP = LoopSetup("axis", "r_rad", "n_rad", "z_v", "y_rad", ls.Controller("axis", (Block("gain", {"gain": 0.5}),), RATE))
INFO = RecordingInfo("r1.parquet", "noise", "controller_input", excites="axis")


def recording(n=N, *, drop=(), offset=0.0, setpoint=0.0, columns=None, **info):
    """A loop around y+ = 0.9 y + 0.1 u with white noise at the controller's input and on the sensor."""
    rng = np.random.default_rng(0)
    moved, v = rng.standard_normal(n), 0.05 * rng.standard_normal(n)
    into = moved - v
    z = 0.5 * lfilter([1.0, -0.9], [1.0, -0.85], into)
    y = lfilter([0.0, 0.05], [1.0, -0.85], into) + v + offset
    whole = {"r_rad": np.full(n, setpoint), "n_rad": moved, "z_v": z, "y_rad": y} | (columns or {})
    return ls.Recording(replace(INFO, **info), RATE, {k: x for k, x in whole.items() if k not in drop})


def refusal(error, call):
    with pytest.raises(error) as caught:
        call()
    return str(caught.value)


def estimate_refusal(settings=None, **words):
    return refusal(ls.errors.BadSignalError, lambda: estimate_frf(recording(**words), LOOP, settings))


def test_a_column_that_is_missing_is_named():
    text = estimate_refusal(drop=("y_rad",))
    assert "has no column y_rad" in text
    assert "r1.parquet" in text
    assert "z_v" in text


def test_a_value_that_is_not_a_number_is_counted_and_placed():
    y = np.zeros(N)
    y[[17, 40]] = np.nan, np.inf
    text = estimate_refusal(columns={"y_rad": y})
    assert "column y_rad" in text
    assert "2 values that are not numbers" in text
    assert "row 17" in text


@pytest.mark.parametrize(("column", "what"), [("z_v", "input"), ("y_rad", "output"), ("n_rad", "injected signal")])
def test_a_constant_signal_is_refused_by_its_place(column, what):
    text = estimate_refusal(columns={column: np.full(N, 2.5)})
    assert f"the {what} of loop axis" in text
    assert "is constant" in text
    assert "2.5 in every row" in text


def test_a_closed_loop_without_an_injected_signal_is_refused():
    text = estimate_refusal(drop=("n_rad",))
    assert "closed loop and has no injected signal for loop axis" in text
    assert "direct estimator" in text
    assert "n_rad" not in text


def test_a_moving_reference_that_was_not_logged_is_refused():
    text = estimate_refusal(drop=("r_rad",), injection="reference")
    assert "no injected signal" in text


@pytest.mark.parametrize("words", [{"estimator": "spectral"}, {"estimator": ""}])
def test_an_unknown_estimator_is_refused(words):
    text = refusal(ls.errors.WrongUseError, lambda: Settings(**words))
    assert "an estimator is not known" in text
    assert "use reference, direct, joint" in text


@pytest.mark.parametrize("overlap", [-0.1, 0.95, 1.0, float("nan")])
def test_an_overlap_out_of_range_is_refused(overlap):
    assert "between 0 and 0.9" in refusal(ls.errors.WrongUseError, lambda: Settings(overlap=overlap))


@pytest.mark.parametrize("resolution_hz", [0.0, -1.0, float("nan")])
def test_a_resolution_that_is_not_positive_is_refused(resolution_hz):
    assert "resolution must be positive" in refusal(
        ls.errors.WrongUseError, lambda: Settings(resolution_hz=resolution_hz)
    )


@pytest.mark.parametrize("n", [60, 237, 1001, 4000])
@pytest.mark.parametrize("overlap", [0.0, 0.5, 0.75])
def test_a_record_too_short_is_refused_with_a_resolution_that_works(n, overlap):
    required = Settings(resolution_hz=1.2 * RATE / n, overlap=overlap)
    text = estimate_refusal(required, n=n)
    assert f"too short for a resolution of {RATE / round(n / 1.2):.3g} Hz" in text
    assert f"{n / RATE:g} s, which gives" in text
    coarser = float(text.split("ask for ")[1].split(" Hz")[0])
    estimate_frf(recording(n), LOOP, replace(required, resolution_hz=coarser))


@pytest.mark.parametrize(("periods", "word"), [(1.9, "1 whole period of 10 s"), (0.5, "0 whole periods of 10 s")])
def test_fewer_than_two_periods_are_refused(periods, word):
    text = estimate_refusal(n=round(1000 * periods) + 100, kind="multisine", period_s=10.0, periodic_from_s=1.0)
    assert word in text
    assert "at least two" in text
    assert "periodic from 1 s" in text


def test_a_period_that_is_no_whole_number_of_samples_is_refused():
    text = estimate_refusal(kind="multisine", period_s=1.005)
    assert "no whole number of samples" in text
    assert "1.005 s at 100 Hz" in text


def test_a_loop_that_did_not_hold_its_setpoint_is_noted():
    notes = " ".join(estimate_frf(recording(setpoint=1.0, offset=0.4), LOOP).notes)
    assert "loop axis did not hold its setpoint: 1 rad asked, 0.396 rad on average" in notes
    assert "where it stood" in notes


def test_a_loop_that_held_its_setpoint_is_not_noted():
    assert estimate_frf(recording(setpoint=1.0, offset=1.0), LOOP).notes == ()


def test_a_recording_that_ended_early_is_noted():
    notes = estimate_frf(recording(ended_early="the joint hit its stop"), LOOP).notes
    assert notes == ("the recording ended early: the joint hit its stop",)


def test_a_record_that_knows_no_line_well_says_so():
    rng = np.random.default_rng(3)
    frf = estimate_frf(recording(columns={"y_rad": 1e3 * rng.standard_normal(N)}), LOOP)
    assert not frf.valid.any()
    assert "is known to 10 %: excite more or measure longer" in " ".join(frf.notes)
    text = refusal(ls.errors.WrongUseError, frf.valid_lines)
    assert "no frequency of the FRF axis r1 is valid" in text
    assert np.isnan(frf.valid_band_hz).all()


def test_a_run_without_excited_loops_is_refused():
    run = ls.Run(RATE, (LOOP,), (recording(excites=None),))
    assert "no estimation recording of the run excites a loop" in refusal(
        ls.errors.BadSignalError, lambda: ls.frfs(run)
    )


def test_a_validation_recording_is_held_out():
    held = recording(role="validation", file="held.parquet")
    assert [frf.recording for frf in ls.frfs(ls.Run(RATE, (LOOP,), (held, recording())))] == ["r1"]
    text = refusal(ls.errors.BadSignalError, lambda: ls.frfs(ls.Run(RATE, (LOOP,), (held,))))
    assert "no estimation recording of the run excites a loop" in text
    assert 'role = "estimation"' in text


def test_a_run_names_its_loops_where_one_is_unknown():
    run = ls.Run(RATE, (LOOP,), (recording(excites="elbow"),))
    text = refusal(ls.errors.WrongUseError, lambda: ls.frfs(run))
    assert "'elbow'" in text
    assert "its loops are axis" in text


def test_a_matrix_needs_one_recording_for_each_loop():
    second = LoopSetup("elbow", "r_rad", "n_rad", "z_v", "y_rad", None)
    run = ls.Run(RATE, (LOOP, second), (recording(),))
    empty = refusal(ls.errors.WrongUseError, lambda: estimate_matrix(run, []))
    assert "recordings that excite its loops" in empty
    twice = refusal(
        ls.errors.WrongUseError, lambda: estimate_matrix(ls.Run(RATE, (LOOP,), ()), [recording(), recording()])
    )
    assert "both excite axis" in twice


def test_a_loop_that_no_recording_excites_has_no_column_and_that_is_said():
    second = LoopSetup("elbow", "r_rad", "n_rad", "z_v", "y_rad", LOOP.controller)
    frf = estimate_matrix(ls.Run(RATE, (LOOP, second), ()), [recording()], Settings(method="welch"))
    assert frf.loop == "axis"
    assert "no recording excites elbow" in " ".join(frf.notes)


def test_a_matrix_of_recordings_at_two_operating_points_is_refused():
    second = LoopSetup("elbow", "r_rad", "n_rad", "z_v", "y_rad", None)
    pair = [recording(operating_point={"x_m": 1.0}), recording(excites="elbow", operating_point={"x_m": 2.0})]
    text = refusal(ls.errors.WrongUseError, lambda: estimate_matrix(ls.Run(RATE, (LOOP, second), pair), pair))
    assert "differ in their operating point" in text


def some_frf(nf=5, ny=1, nu=1, **words):
    given = {
        "frequency_hz": np.arange(1.0, nf + 1),
        "response": np.ones((nf, ny, nu), dtype=complex),
        "covariance": np.ones((nf, ny * nu, ny * nu), dtype=complex),
        "valid": np.ones(nf, dtype=bool),
        "inputs": tuple(f"u{k}_v" for k in range(nu)),
        "outputs": tuple(f"y{k}_rad" for k in range(ny)),
        "method": "made up",
    }
    return ls.FRF(**given | words)


def test_a_band_without_lines_is_refused_with_the_lines_there_are():
    text = refusal(ls.errors.WrongUseError, lambda: some_frf().between(7.0, 9.0))
    assert "7 to 9 Hz" in text
    assert "the frequencies go from 1 to 5 Hz" in text
    assert some_frf().between(2.0, 4.0).frequency_hz.tolist() == [2.0, 3.0, 4.0]


def test_one_response_of_a_matrix_is_refused():
    text = refusal(ls.errors.WrongUseError, lambda: some_frf(ny=2).siso)
    assert "one loop's response was requested from an FRF with several" in text
    assert "(2, 1)" in text


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ({"response": np.ones((5, 1), dtype=complex)}, "(frequencies, outputs, inputs)"),
        ({"covariance": np.ones((5, 2, 2), dtype=complex)}, "a covariance is"),
        ({"frequency_hz": np.array([1.0, 2.0, 2.0, 3.0, 4.0])}, "positive and strictly increasing"),
    ],
)
def test_a_frf_that_does_not_fit_together_is_refused(words, said):
    assert said in refusal(ls.errors.WrongUseError, lambda: some_frf(**words))
