"""In a noisy closed loop the direct estimator keeps its error whatever the data; the reference-based one's falls."""

import re
from dataclasses import replace

import numpy as np
import pytest
from bench_nouns import Block
from conversions import TWO_PI, db
from known_loops import CONTROLLER, LOOP, RATE, estimates, plant, record, run_loop
from scipy.signal import butter, chirp, lfilter, sosfilt

import loopshape as ls
from loopshape.identify.frequency_response import estimate_frf
from loopshape.identify.settings import Settings

BIASED = "direct estimator in closed loop: biased towards -1/C where noise outweighs the excitation"
LENGTHS_S = (60, 240, 960)
RECORDS = 16


def signals(length_s, records=RECORDS):
    """White n and a disturbance of low frequency that is as large, in the loop's band, as what n makes of y."""
    rng = np.random.default_rng(length_s)
    n = rng.standard_normal((records, round(length_s * RATE)))
    return n, lfilter([1.0], [1.0, -0.9], 0.25 * rng.standard_normal(n.shape))


def relative_error(estimator, length_s, place="controller_input"):
    """RMS relative error between 1 and 8 Hz over several recordings."""
    found = estimates(place, "noise", *signals(length_s), Settings(estimator, resolution_hz=0.5))
    band = [frf.between(1.0, 8.0) for frf in found]
    return float(np.sqrt(np.mean([np.abs(x.siso / plant(x.frequency_hz) - 1.0) ** 2 for x in band])))


def exponent(errors):
    return np.polyfit(np.log(LENGTHS_S), np.log(errors), 1)[0]


def test_reference_based_error_falls_as_one_over_the_root_of_the_length():
    errors = [relative_error("reference", length) for length in LENGTHS_S]
    assert errors[0] < 0.5  # small enough that a ratio of averages behaves as its linearisation
    assert exponent(errors) == pytest.approx(-0.5, abs=0.08)


def test_direct_error_stays_whatever_the_length():
    errors = [relative_error("direct", length) for length in LENGTHS_S]
    assert min(errors) > 0.5
    assert exponent(errors) == pytest.approx(0.0, abs=0.03)


def test_direct_estimate_without_excitation_is_minus_the_inverse_controller():
    _, v = signals(960, 1)
    frf = estimates("controller_input", "noise", 1e-6 * v, v, Settings("direct", resolution_hz=0.5))[0].between(
        1.0, 8.0
    )
    # the segments' ends leave 1 to 2 % of the controller's own memory (5 Hz low-pass, 2 s segments)
    np.testing.assert_allclose(frf.siso, -1.0 / LOOP.controller.response(frf.frequency_hz), rtol=0.05)


@pytest.mark.long
def test_in_open_loop_both_estimators_are_one():
    both = [relative_error(estimator, 240, "control") for estimator in ("reference", "direct")]
    assert both[0] == both[1] < 0.2


def direct_notes(place, *, drop=(), loop=LOOP):
    n, v = (x[0] for x in signals(60, 1))
    whole = record(place, "noise", n, *run_loop(place, n, 0.01 * v))
    kept = ls.Recording(whole.info, RATE, {k: x for k, x in whole.columns.items() if k not in drop})
    return " ".join(estimate_frf(kept, loop, Settings("direct")).notes)


@pytest.mark.long
@pytest.mark.parametrize("place", ["controller_input", "plant_input", "reference"])
def test_direct_estimator_warns_where_there_is_feedback(place):
    note = direct_notes(place)
    assert BIASED in note
    change_db, at_hz = re.search(r"feedback changes what reaches the plant by (\S+) dB at (\S+) Hz", note).groups()
    f = np.arange(0.5, 45.0, 0.01)
    change = -db(1.0 + LOOP.controller.response(f) * plant(f))  # of S, the same at every place
    worst = np.argmax(np.abs(change))
    # ten averages of a nearly noiseless loop, and lines 0.17 Hz apart
    assert float(change_db) == pytest.approx(change[worst], abs=0.3)
    assert float(at_hz) == pytest.approx(f[worst], abs=0.5)


def test_direct_estimator_warns_in_closed_loop_without_an_injected_signal():
    assert direct_notes("controller_input", drop=("n_rad",)) == BIASED


def test_direct_estimator_does_not_warn_in_open_loop():
    assert "direct" not in direct_notes("control")


def test_reference_based_estimator_does_not_warn():
    n, v = (x[0] for x in signals(60, 1))
    frf = estimate_frf(record("plant_input", "noise", n, *run_loop("plant_input", n, 0.01 * v)), LOOP)
    assert frf.notes == ()


@pytest.mark.long
def test_direct_estimator_warns_of_feedback_without_knowing_the_controller():
    unknown = replace(LOOP, controller=None)
    for place in ("controller_input", "reference"):
        assert direct_notes(place, loop=unknown) == BIASED
    # what is injected at the plant's input is known there: the change can be computed without the controller
    assert "feedback changes what reaches the plant by" in direct_notes("plant_input", loop=unknown)


@pytest.mark.parametrize("method", ["welch", "local"])
@pytest.mark.parametrize("share", [1e-4, 0.01, 0.03])
def test_an_injection_that_drowns_is_never_trusted_though_its_residual_is_small(method, share):
    # both answers to the instrument are then noise: their quotient is -1/C, and y - G u is nothing
    rng = np.random.default_rng(7)
    n, v = share * rng.standard_normal((1, 8000)), 0.3 * rng.standard_normal((1, 8000))
    frf = estimates("controller_input", "noise", n, v, Settings(method=method))[0]
    low = frf.between(0.5, 20.0)
    inverse = -1.0 / CONTROLLER.response(low.frequency_hz)
    assert np.median(np.abs(low.siso / inverse - 1.0)) < 0.6  # it is the controller that was measured
    assert np.median(np.sqrt(low.variance[:, 0, 0]) / np.abs(low.siso)) < 0.6  # and its variance does not say so
    assert not frf.valid.any()
    assert "loop noise exceeds the excitation at the plant input" in " ".join(frf.notes)


@pytest.mark.long
@pytest.mark.parametrize("method", ["welch", "local"])
@pytest.mark.parametrize("share", [0.0, 0.03, 0.3])
def test_direct_lines_that_are_minus_the_inverse_controller_are_outside_the_valid_band(method, share):
    # noise alone drives the loop, or the excitation is far below it: coherence is near 1 and the answer is -1/C
    rng = np.random.default_rng(11)
    n, v = share * rng.standard_normal((1, 8000)), 0.3 * rng.standard_normal((1, 8000))
    if share == 0.0:
        n = 1e-6 * v  # no excitation of its own
    frf = estimates("controller_input", "noise", n, v, Settings("direct", method=method))[0]
    biased = np.abs(frf.siso / plant(frf.frequency_hz) - 1.0) > 0.3
    assert np.mean(biased) > 0.5
    assert not (frf.valid & biased).any()
    assert "-1/C of the loop's own controller" in " ".join(frf.notes)


def test_direct_lines_with_little_noise_stay_in_the_valid_band():
    n, v = (x[0] for x in signals(60, 1))
    whole = record("controller_input", "noise", n, *run_loop("controller_input", n, 0.01 * v))
    frf = estimate_frf(whole, LOOP, Settings("direct", method="welch"))
    inside = frf.between(1.0, 20.0)
    assert inside.valid.all()
    assert np.median(np.abs(inside.siso / plant(inside.frequency_hz) - 1.0)) < 0.05
    assert "-1/C of the loop's own controller" not in " ".join(frf.notes)


def excited_below_1_5_hz(kind, rng, size=20_000):
    """An external signal with power up to 1.5 Hz only, as noise (steep or not), as a sweep, as a multisine."""
    if kind == "sweep":
        return chirp(np.arange(size) / RATE, 0.1, size / RATE, 1.5), {}
    if kind == "multisine":
        lines, each = np.arange(1, 31), 2000
        period = np.cos(TWO_PI * np.outer(np.arange(each) / each, lines) + rng.uniform(0, TWO_PI, 30)).sum(axis=1) / 5
        return np.tile(period, size // each), {"period_s": each / RATE, "from_s": 2 * each / RATE}
    return 5.0 * sosfilt(butter(8 if kind == "noise" else 3, 1.5, fs=RATE, output="sos"), rng.standard_normal(size)), {}


#: the controller as it runs, none declared, and one that is not what runs
DECLARED = {
    "true": CONTROLLER,
    "none": None,
    "wrong": replace(CONTROLLER, blocks=(Block("gain", {"gain": 0.35}), *CONTROLLER.blocks[1:])),
}


def valid_wrong_right_lost(kind, place, level, estimator, method, declared, seed):
    """Lines that are valid, those of them that are wrong (by more than 10 % and three deviations), lines known to 10 %
    that are right, and those of them that are not valid."""
    rng = np.random.default_rng(seed)
    n, period = excited_below_1_5_hz(kind, rng)
    band = sosfilt(butter(4, [4.0, 30.0], "bandpass", fs=RATE, output="sos"), rng.standard_normal(n.size))
    z, y = run_loop(place, n, 2.0 * level * band + 0.1 * level * rng.standard_normal(n.size))
    one = record(place, kind if period or kind == "sweep" else "noise", n, z, y, **period)
    frf = estimate_frf(one, replace(LOOP, controller=DECLARED[declared]), Settings(estimator, method=method))
    error = np.abs(frf.siso / plant(frf.frequency_hz) - 1.0)
    std = np.sqrt(frf.variance[:, 0, 0]) / np.abs(frf.siso)
    wrong = frf.valid & (error > 0.1) & (error > 3.0 * std)
    right = (error < 0.1) & (std < 0.1)
    return np.array([frf.valid.sum(), wrong.sum(), right.sum(), (right & ~frf.valid).sum()])


@pytest.mark.parametrize("declared", DECLARED)
@pytest.mark.parametrize(
    ("estimator", "method", "kinds"),
    [
        ("direct", "welch", ("noise", "smooth", "sweep")),
        pytest.param("direct", "local", ("noise", "smooth"), marks=pytest.mark.long),
        ("direct", "auto", ("sweep", "multisine")),
        pytest.param("reference", "welch", ("noise", "smooth", "sweep"), marks=pytest.mark.long),
        pytest.param("reference", "local", ("noise", "smooth"), marks=pytest.mark.long),
        pytest.param("joint", "auto", ("sweep", "multisine"), marks=pytest.mark.long),
    ],
)
def test_minus_the_inverse_controller_is_never_valid_where_an_external_signal_is_known(
    estimator, method, kinds, declared
):
    # u is the loop's own noise above 1.5 Hz: P - (P + 1/C) there, whatever is known of C
    found = [
        valid_wrong_right_lost(kind, place, level, estimator, method, declared, seed)
        for seed, kind in enumerate(kinds)
        for place in ("reference", "plant_input")
        for level in (0.01, 0.1)
        if (estimator, kind) != ("direct", "multisine") or level < 0.1  # u then repeats no more, and is refused
    ]
    valid, wrong, right, lost = np.sum(found, axis=0)
    assert right > 20 * len(found)
    assert valid > 0.8 * right
    assert wrong <= 0.01 * valid
    assert lost <= 0.05 * right
