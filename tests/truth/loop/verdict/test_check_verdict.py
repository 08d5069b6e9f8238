"""A verdict: each requirement at its worst operating point; no signature on a loop that is not known to be stable."""

import re
from dataclasses import replace

import numpy as np
import pytest
from bench_nouns import Block, Loop, LoopSetup, Rational, RecordingInfo, ThirdOrder, TransferFunction
from conversions import TWO_PI, db

import loopshape as ls
from loopshape.identify.fit import fit
from loopshape.identify.frequency_response import estimate_frf
from loopshape.loop.loops import loops_of
from loopshape.loop.margin.margins import margins

RATE = 1000.0
F = np.geomspace(0.1, 100.0, 1500)


def arm(recording, f_hz=6.3, kappa=780.0, zeta=0.05, f=F, std=1e-6):
    w = TWO_PI * f_hz
    G = TransferFunction([kappa], [1.0, 2.0 * zeta * w, w * w, 0.0]).response(f)[:, None, None]
    return ls.FRF(
        f, G, (std * np.abs(G)) ** 2 + 0j, np.ones(f.size, dtype=bool), ("z_v",), ("y_rad",), "made up",
        recording=recording, loop="theta2", rate_hz=RATE,
    )  # fmt: skip


def controller(gain=55.0, notch_hz=6.1, rate_hz=RATE):
    return ls.Controller(
        "theta2",
        (
            Block("gain", {"gain": gain}),
            Block("lead_lag", {"f1_hz": 1.0, "f2_hz": 15.0}),
            Block("notch", {"f1_hz": notch_hz, "f2_hz": notch_hz, "damping1": 0.05, "damping2": 5.0}),
            Block("low_pass_2", {"f_hz": 15.0, "damping": 0.7}),
        ),
        rate_hz,
    )


def wish(**words):
    return ls.Requirements("theta2", **{"integrators": 1, "unstable_poles": 0} | words)


POINTS = [arm("calm"), arm("stiff", f_hz=6.6), arm("strong", kappa=1500.0)]


def line_of(verdict, quantity):
    (line,) = (x for x in verdict.lines if x.quantity == quantity)
    return line


def test_a_requirement_missed_at_one_point_fails_and_names_point_and_frequency():
    verdict = ls.check(POINTS, controller(), wish(gain_margin_db=8.0, phase_margin_deg=20.0))
    gain, phase = (line_of(verdict, q) for q in ("gain_margin_db", "phase_margin_deg"))
    alone = {x.plant.recording: margins(x) for x in loops_of(POINTS, controller(), wish())[0]}
    worst = min(alone, key=lambda name: alone[name].gain_margin_db)
    assert not verdict.passed
    assert (gain.passed, gain.recording) == (False, worst) == (False, "strong")
    assert gain.value == pytest.approx(alone[worst].gain_margin_db, abs=1e-5)  # lines known to 1e-6
    assert gain.slack == pytest.approx(gain.value - 8.0, abs=1e-4)
    assert gain.at_hz == alone[worst].at_hz["gain_margin_db"]
    assert gain.unit == "dB"
    assert phase.passed
    assert phase.value == pytest.approx(min(m.phase_margin_deg for m in alone.values()), abs=1e-4)
    assert verdict.unstable == ()


def test_without_the_point_that_misses_it_passes():
    assert ls.check(POINTS[:2], controller(), wish(gain_margin_db=8.0, phase_margin_deg=20.0)).passed


@pytest.mark.parametrize("quantity", ["sensitivity_peak_db", "complementary_peak_db", "control_peak_db"])
def test_a_peak_is_at_most_what_is_required(quantity):
    found = margins(Loop(POINTS[0], controller(), 1, unstable_poles=0))
    value = getattr(found, quantity)
    over, under = (ls.check(POINTS[:1], controller(), wish(**{quantity: value + s})) for s in (-0.01, 0.01))
    assert (over.passed, under.passed) == (False, True)
    (read,) = over.margins.values()
    low, high = read.intervals[quantity]
    assert high - low < 1e-3  # dB: lines known to 1e-6, joined by chords over 0.5 % of frequency
    assert line_of(over, quantity).slack == pytest.approx(value - 0.01 - high, abs=1e-6)
    assert line_of(over, quantity).at_hz == found.at_hz[quantity]


@pytest.mark.parametrize("quantity", ["gain_margin_db", "phase_margin_deg", "modulus_margin", "delay_margin_s"])
def test_a_margin_is_at_least_what_is_required(quantity):
    value = getattr(margins(Loop(POINTS[0], controller(), 1, unstable_poles=0)), quantity)
    over, under = (ls.check(POINTS[:1], controller(), wish(**{quantity: value * s})) for s in (1.01, 0.99))
    assert (over.passed, under.passed) == (False, True)


def test_a_margin_that_no_line_shows_is_as_large_as_l_at_the_first_line():
    first_db = 20.0 * np.log10(abs(margins_loop().L[0]))
    for required, outcome in ((20.0, "passed"), (first_db + 3.0, "undecided")):
        line = line_of(
            ls.check(POINTS[:1], controller(), wish(gain_reduction_margin_db=required)), "gain_reduction_margin_db"
        )
        assert (line.outcome, line.bound) == (outcome, np.inf)
        assert line.value == pytest.approx(first_db, abs=1e-3)


def margins_loop():
    return Loop(POINTS[0], controller(), 1, unstable_poles=0)


def test_bandwidth_met_and_missed():
    crossover = margins(Loop(POINTS[0], controller(), 1, unstable_poles=0)).bandwidth_hz
    assert crossover == pytest.approx(2.7, abs=0.05)
    met, missed = (ls.check(POINTS[:1], controller(), wish(bandwidth_hz=f)) for f in (2.5, 3.0))
    assert met.passed
    assert not missed.passed
    assert line_of(missed, "bandwidth_hz").slack == pytest.approx(crossover - 3.0, abs=1e-5)  # lines known to 1e-6


def test_a_loop_whose_crossover_lies_below_its_lines_has_no_bandwidth_and_does_not_pass():
    verdict = ls.check([arm("high lines", f=F[F > 7.0])], controller(), wish(bandwidth_hz=1.0))
    assert not verdict.passed
    assert verdict.unstable == ("high lines",)
    line = line_of(verdict, "bandwidth_hz")  # it lies somewhere below the first line
    assert (line.value, line.outcome, line.bound) == (0.0, "undecided", F[F > 7.0][0])
    assert np.isnan(verdict.margins["high lines"].phase_margin_deg)


def test_an_unstable_loop_fails_whatever_its_margins():
    verdict = ls.check(POINTS, controller(gain=500.0), wish(modulus_margin=1e-4))
    assert line_of(verdict, "modulus_margin").passed
    assert verdict.unstable == ("calm", "stiff", "strong")
    assert not verdict.passed
    assert "2 closed-loop poles in the right half plane" in verdict.margins["calm"].stability_reason


def test_a_loop_that_cannot_be_decided_does_not_pass():
    noisy = arm("noisy", std=8.0)
    verdict = ls.check([POINTS[0], noisy], controller(), wish(phase_margin_deg=30.0))
    assert line_of(verdict, "phase_margin_deg").outcome == "undecided"
    assert line_of(verdict, "phase_margin_deg").interval == (-np.inf, np.inf)  # errors as large as L tell nothing
    assert verdict.unstable == ("noisy",)
    assert verdict.margins["noisy"].stable == "undecided"
    assert not verdict.passed


def test_control_at_high_frequency_counts_the_controller_above_the_last_line():
    # |CS| is asked for from 50 Hz, the lines end at 30 Hz: above, |L| stays below its last value l, |CS| below
    # |C|/(1 - l)
    short = arm("short", f=F[F < 30.0])
    last = np.abs(Loop(short, controller(), 1, unstable_poles=0).L[-1])
    C = np.abs(controller().response(np.geomspace(50.0, 450.0, 2000))) / (1.0 - last)
    verdict = ls.check([short], controller(), wish(control_high_frequency_db=0.0, control_high_frequency_from_hz=50.0))
    line = line_of(verdict, "control_high_frequency_db")
    assert line.value == pytest.approx(db(C.max()), abs=0.5)  # above_hz has lines 3 % apart, |C| falls 40 dB a decade
    assert 50.0 <= line.at_hz < 53.0


def test_gain_margin_is_bounded_by_the_last_line():
    short = arm("short", f=F[F < 5.0])  # the phase crosses -180 deg above 5 Hz
    found = margins(Loop(short, controller(), 1, unstable_poles=0))
    L = Loop(short, controller(), 1, unstable_poles=0).L
    assert found.gain_margin_db == pytest.approx(-float(db(L[-1])))
    verdict = ls.check([short], controller(), wish(gain_margin_db=found.gain_margin_db + 0.1))
    assert not verdict.passed
    assert line_of(verdict, "gain_margin_db").at_hz == short.frequency_hz[-1]


def test_requirements_may_narrow_the_band():
    spoilt = POINTS[0].response.copy()
    spoilt[F > 60.0, 0, 0] = -0.8 / controller().response(F[F > 60.0])
    frf = replace(POINTS[0], response=spoilt)
    clean = ls.check(POINTS[:1], controller(), wish(sensitivity_peak_db=6.0))
    whole, narrow = (
        ls.check([frf], controller(), wish(sensitivity_peak_db=6.0, band_hz=b)) for b in (None, (0.5, 50.0))
    )
    assert not whole.passed
    assert line_of(whole, "sensitivity_peak_db").at_hz > 60.0
    assert narrow.passed
    assert any("is used from 0.5" in note and "|S| reads 14 dB" in note for note in narrow.warnings)
    assert line_of(narrow, "sensitivity_peak_db").value == pytest.approx(
        line_of(clean, "sensitivity_peak_db").value, abs=1e-5
    )


def test_a_band_that_ends_too_early_does_not_hide_a_peak():
    # |S| peaks at 6.9 Hz with 4.4 dB; cut off at 3.5 Hz, where |L| is l, it may reach 1/(1 - l) for all one knows
    whole, narrow = (
        ls.check(POINTS[:1], controller(), wish(sensitivity_peak_db=6.0, band_hz=b)) for b in (None, (0.5, 3.5))
    )
    lines = POINTS[0].between(0.5, 3.5)
    last = np.abs(Loop(lines, controller(), 1, unstable_poles=0).L[-1])
    found = line_of(narrow, "sensitivity_peak_db")
    assert found.value == pytest.approx(-float(db(1.0 - last)))
    assert found.at_hz == lines.frequency_hz[-1]
    assert found.value > line_of(whole, "sensitivity_peak_db").value
    assert whole.passed
    assert not narrow.passed


def test_integrators_come_from_the_requirements_then_a_fit_then_the_lowest_lines():
    plain = wish(integrators=None)
    fitted = replace(fit(POINTS[0], ThirdOrder()), p_value=0.5, runs_p_value=0.5)
    declared, against_fit, by_fit, by_lines = (
        loops_of(POINTS[:1], controller(), requirements, fits)
        for requirements, fits in (
            (wish(integrators=2), ()), (wish(integrators=2), (fitted,)), (plain, (fitted,)), (plain, ())
        )
    )  # fmt: skip
    assert declared[0][0].integrators == 2
    assert (against_fit[0][0].integrators, against_fit[0][0].model) == (2, None)
    assert "is not used: it has 1 integrators, and 2 are declared" in against_fit[1][0]
    assert (by_fit[0][0].integrators, by_fit[1]) == (1, ())
    assert by_fit[0][0].model is fitted.model
    assert by_lines[0][0].integrators == 1
    assert by_lines[1][0].startswith(
        "plant taken to have 1 integrator, from its lowest frequencies: 1.0 by phase, 1.0 by slope"
    )


def test_fits_that_leave_more_than_noise_are_named_in_one_sentence():
    left = [
        replace(fit(point, ThirdOrder()), p_value=0.001, misfit_db=db)
        for point, db in zip(POINTS, (0.25, 1.8, 0.7), strict=False)
    ]
    assert len(left) > 2
    _, notes = loops_of(POINTS[: len(left)], controller(), wish(), left)
    assert [note for note in notes if "not used" in note] == [
        f"the fits of {len(left)} recordings, {left[0].recording} to {left[-1].recording}, are not used: each leaves"
        " more than noise (misfit 0.25 to 1.8 dB)"
    ]


def seen(model, f=F):
    """An exact FRF of a model."""
    return replace(arm("seen", f=f), response=model.response(f)[:, None, None])


@pytest.mark.parametrize("gain", [5.0, -5.0])
@pytest.mark.parametrize("integrators", [0, 1, 2, 3])
def test_phase_and_slope_of_the_lowest_lines_tell_the_integrators_and_the_sign(integrators, gain):
    model = TransferFunction([gain], np.append([0.01, 1.0], np.zeros(integrators)))
    (loop,), notes = loops_of([seen(model)], controller(), wish(integrators=None))
    assert loop.integrators == integrators
    (note,) = notes
    assert note.startswith(
        f"plant taken to have {integrators} integrator{'s' * (integrators != 1)}"
        f"{' and a reversed sign' * (gain < 0.0)}, from its lowest frequencies"
    )
    found = re.search(r"(\S+) by phase, (\S+) by slope at \S+ Hz; declare integrators", note)
    assert [float(x) for x in found.groups()] == pytest.approx([integrators, integrators], abs=0.15)


UNCLEAR = {
    "a lag at its corner, phase and slope half way": (TransferFunction([5.0], [1.0 / (TWO_PI * 0.12), 1.0]), 0.5, 0.5),
    "a delay, phase of an integrator without its slope": (TransferFunction([5.0], [1.0], 1.6), 0.8, 0.0),
}


@pytest.mark.parametrize("name", UNCLEAR)
def test_where_phase_and_slope_do_not_agree_on_a_whole_number_nothing_is_assumed(name):
    model, by_phase, by_slope = UNCLEAR[name]
    frf = seen(model)
    (loop,), notes = loops_of([frf], controller(), wish(integrators=None))
    assert loop.integrators is None
    said = re.fullmatch(
        r"the plant's lowest frequencies look like (\S+) integrators by phase and (\S+) by slope", notes[0]
    )
    assert [float(x) for x in said.groups()] == pytest.approx([by_phase, by_slope], abs=0.15)
    verdict = ls.check([frf], controller(), wish(integrators=None, phase_margin_deg=1.0))
    assert not verdict.passed
    assert verdict.margins["seen"].stable == "undecided"
    assert "the number of integrators of the plant is not known" in verdict.margins["seen"].stability_reason
    assert verdict.warnings == notes
    declared, _ = loops_of([frf], controller(), wish(integrators=0))
    assert declared[0].integrators == 0


UNSTABLE = TransferFunction([4.0], np.polymul([1.0 / TWO_PI, -1.0], [0.01, 1.0]))


def test_unstable_poles_come_from_the_requirements_then_a_fit_that_leaves_nothing_but_noise():
    frf = seen(UNSTABLE)
    fitted = replace(fit(frf, Rational(0, 2)), p_value=0.5, runs_p_value=0.5)
    insufficient = replace(fitted, p_value=0.001)
    plain = wish(integrators=0, unstable_poles=None)
    (loop,), notes = loops_of([frf], controller(), plain, (fitted,))
    assert (loop.unstable_poles, loop.model) == (1, fitted.model)
    (note,) = notes
    assert "plant taken to have 1 unstable pole, from" in note
    assert "fit" in note
    (loop,), notes = loops_of([frf], controller(), plain, (insufficient,))
    assert (loop.unstable_poles, loop.model) == (None, None)
    assert "is not used: it leaves more than noise" in notes[0]
    (loop,), notes = loops_of([frf], controller(), wish(integrators=0, unstable_poles=0), (fitted,))
    assert (loop.unstable_poles, loop.model) == (0, None)
    assert "it has 1 unstable poles, and 0 are declared" in notes[0]
    (loop,), notes = loops_of([frf], controller(), wish(integrators=0, unstable_poles=1))
    assert (loop.unstable_poles, notes) == (1, ())


STABLE = TransferFunction([4.0], [1.0, 0.0])


def test_declared_unstable_poles_count():
    frf = seen(UNSTABLE)
    gain = ls.Controller("theta2", (Block("gain", {"gain": 1.0}),), RATE)
    said, unsaid = (
        ls.check([frf], gain, wish(integrators=0, unstable_poles=k, phase_margin_deg=1.0)) for k in (1, None)
    )
    assert said.passed
    assert (unsaid.outcome, unsaid.margins["seen"].stable) == ("undecided", "undecided")
    assert "the number of unstable poles of the plant is not known" in unsaid.margins["seen"].stability_reason


def test_a_record_without_feedback_that_stayed_bounded_has_no_unstable_pole():
    frf = replace(POINTS[0], open_loop=True)
    (loop,), _ = loops_of([frf], controller(), wish(unstable_poles=None))
    assert loop.unstable_poles == 0


def test_a_plant_without_integrators_is_not_taken_for_a_double_one():
    f = np.geomspace(0.01, 100.0, 200)
    G = 5.0 * np.exp(0.005j * (-1.0) ** np.arange(f.size)) / (1.0 + 1j * f / 20.0)  # +-0.3 deg around zero phase
    frf = replace(arm("flat", f=f), response=G[:, None, None])
    (loop,), _ = loops_of([frf], controller(), wish(integrators=None))
    assert loop.integrators == 0


def test_a_wrong_declaration_fails_the_check_instead_of_passing_it():
    verdict = ls.check(POINTS[:1], controller(), wish(integrators=2, phase_margin_deg=30.0))
    assert not verdict.passed
    assert verdict.margins["calm"].stable == "undecided"
    assert "does not fit 2 integrators" in verdict.margins["calm"].stability_reason


def test_a_fit_of_another_recording_or_one_that_misses_is_no_witness():
    fitted = replace(fit(POINTS[0], ThirdOrder()), p_value=0.5, runs_p_value=0.5)
    for witness in (
        replace(fitted, recording="other"),
        replace(fitted, runs_p_value=0.001),
        replace(fitted, outcome="not_converged"),
    ):
        (loop,), _ = loops_of(POINTS[:1], controller(), wish(integrators=None), (witness,))
        assert loop.model is None


def test_a_frf_of_white_noise_can_be_checked_to_its_last_line():
    z = np.random.default_rng(0).standard_normal(40000)
    y = np.convolve(z, [0.0, 0.5, 0.2])[: z.size]
    info = RecordingInfo("white.parquet", "noise", "control", excites="theta2", closed_loop=False)
    setup = LoopSetup("theta2", None, None, "z_v", "y_rad", controller())
    frf = estimate_frf(ls.Recording(info, RATE, {"z_v": z, "y_rad": y}), setup)
    ls.check(
        [frf], ls.Controller("theta2", (Block("gain", {"gain": 0.1}),), RATE), wish(integrators=0, phase_margin_deg=1.0)
    )


@pytest.mark.long
def test_lines_that_start_above_the_corners_are_never_judged_wrongly():
    rng = np.random.default_rng(3)
    for _ in range(300):
        corners = 10.0 ** rng.uniform(-0.3, 1.2, rng.integers(1, 4))
        k, dampings = int(rng.integers(0, 3)), 10.0 ** rng.uniform(-1.7, 0.0, corners.size)
        den = np.poly(np.zeros(k))
        for corner, damping in zip(corners, dampings, strict=True):
            w = TWO_PI * corner
            den = np.polymul(den, [1.0, 2.0 * damping * w, w * w])
        gain = float(np.abs(np.polyval(den, 2j * TWO_PI)) * 10.0 ** rng.uniform(-1.5, 1.5))
        seen_from = float(rng.choice([1.0, 2.0, 4.0])) * float(corners.min())
        frf = seen(TransferFunction([gain], den), np.geomspace(seen_from, 0.45 * RATE, 800))
        unit = ls.Controller("theta2", (Block("gain", {"gain": 1.0}),), RATE)
        answer = next(iter(ls.check([frf], unit, wish(integrators=k)).margins.values())).stable
        truth = "unstable" if np.any(np.roots(np.polyadd(den, [gain])).real > 1e-9) else "stable"
        assert answer in (truth, "undecided")


def plant_of(G, f=F):
    return ls.FRF.from_arrays(f, G, relative_std=1e-4, rate_hz=RATE)


def test_a_crossing_with_L_near_1_below_it_is_warned_of_and_that_of_an_integrator_is_not():
    """L = 1.1 / (1 + s/(2 pi 30)) crosses 0 dB at 30 sqrt(1.21 - 1) = 13.7 Hz and reduces the error by 20 log10 2.1."""
    C = ls.Controller("y", (Block("gain", {"gain": 1.0}),), RATE)
    asked = ls.Requirements("y", bandwidth_hz=10.0, unstable_poles=0, integrators=0)
    flat = ls.check([plant_of(1.1 / (1.0 + 1j * F / 30.0))], C, asked)
    (said,) = [w for w in flat.warnings if "crosses 0 dB" in w]
    crosses_hz, reduced_db = (float(x) for x in re.findall(r"at ([0-9.]+) Hz.* by ([0-9.]+) dB", said)[0])
    assert crosses_hz == pytest.approx(30.0 * np.sqrt(0.21), rel=2e-3)
    assert reduced_db == pytest.approx(db(2.1), abs=0.06)
    rising = ls.check([plant_of(13.7 / (1j * F))], C, replace(asked, integrators=1))
    assert not [w for w in rising.warnings if "crosses 0 dB" in w]


def test_a_crossing_is_not_warned_of_where_no_bandwidth_is_required():
    C = ls.Controller("y", (Block("gain", {"gain": 1.0}),), RATE)
    asked = ls.Requirements("y", phase_margin_deg=30.0, unstable_poles=0, integrators=0)
    assert not [w for w in ls.check([plant_of(1.1 / (1.0 + 1j * F / 30.0))], C, asked).warnings if "crosses 0 dB" in w]


def test_a_peak_near_the_crossing_does_not_hide_that_the_error_is_hardly_reduced_below():
    C = ls.Controller("y", (Block("gain", {"gain": 1.0}),), RATE)
    asked = ls.Requirements("y", bandwidth_hz=10.0, unstable_poles=0, integrators=0)
    peak = 1.0 + 8.0 / (1.0 + 20.0j * (F / 9.0 - 9.0 / F))  # |L| up to 20 dB at 9 Hz, near 1 below 4
    found = ls.check([plant_of(1.1 * peak / (1.0 + 1j * F / 30.0))], C, asked)
    assert db(1.0 + np.abs(1.1 * peak / (1.0 + 1j * F / 30.0)).max()) > 18.0
    assert any("crosses 0 dB" in w for w in found.warnings)
