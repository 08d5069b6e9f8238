"""A resonance sharper than the lines is found by its tails, and either counted or left open, never stepped over."""

from dataclasses import replace

import numpy as np
import pytest
from bench_nouns import Block, TransferFunction
from conversions import TWO_PI
from drawn_loops import LINES, PLANTS, by_roots, errors, frf_of, loop_of, real, unseen_damping, with_mode

import loopshape as ls
from loopshape.loop.margin.between import path_of, without_narrow
from loopshape.loop.stability.obstacles import obstacles, sampling
from loopshape.loop.stability.sampling import between_lines
from loopshape.loop.stability.stability import closed_loop_stability, count_unstable

PLANT = PLANTS["one integrator"]
GAP = 0.1


def hidden_poles(f, P, variance):
    return between_lines(f, P, variance).poles


def mode_at(f_hz, width, peak):
    """A mode `width` gaps wide, whose peak is `peak` times the plant's |P| there."""
    return with_mode(PLANT, f_hz, width * GAP / f_hz, peak * abs(PLANT.response([f_hz])[0]))


def loop_with(plant, noise, rng=None):
    P = plant.response(LINES)
    return loop_of(plant, frf_of(LINES, P, noise * np.abs(P), rng))


def answer(plant, noise, rng=None):
    return closed_loop_stability(loop_with(plant, noise, rng))


def unseen(loop):
    """Damping of what the lines of a loop do not show."""
    shown = between_lines(LINES, without_narrow(loop), loop.measured.variance[:, 0, 0])
    return unseen_damping(loop, shown.visible_residue)


@pytest.mark.parametrize("place", [0.05, 0.3, 0.5, 0.9])
@pytest.mark.parametrize("width", [0.05, 0.2, 0.7])
@pytest.mark.parametrize("noise", [1e-6, 0.02])
def test_a_hidden_pole_is_found_with_no_less_than_its_peak(place, width, noise):
    rng, f_hz = np.random.default_rng(0), 14.2 + place * GAP
    plant = mode_at(f_hz, width, 4.0)
    P = plant.response(LINES)
    std = noise * np.abs(P)
    (pole,) = hidden_poles(LINES, P + std * errors(rng, LINES.size), std**2)
    assert pole.low_hz - 0.01 < f_hz < pole.high_hz + 0.01
    assert pole.pole_hz.real == pytest.approx(f_hz, abs=0.2 * GAP)
    assert pole.pole_hz.imag == pytest.approx(width * GAP, rel=0.05 if noise == 1e-6 else 0.6)
    assert 1.0 < pole.peak / (4.0 * abs(PLANT.response([f_hz])[0])) < 20.0


def test_the_bound_on_a_hidden_poles_peak_is_one_and_a_tight_one_where_lines_are_known():
    f_hz, rng = 14.25, np.random.default_rng(7)
    for width, noise, most in ((0.05, 1e-6, 1.05), (0.2, 1e-6, 1.05), (0.2, 0.02, 1.5), (0.2, 0.1, 20.0)):
        plant = mode_at(f_hz, width, 4.0)
        P = plant.response(LINES)
        std = noise * np.abs(P)
        for _ in range(20):
            pole = hidden_poles(LINES, P + std * errors(rng, LINES.size), std**2)[-1]
            assert 1.0 < pole.peak / (4.0 * abs(PLANT.response([f_hz])[0])) < most


def test_a_pole_without_noise_is_told_with_its_residue():
    f_hz, width, peak = 14.237, 0.1, 4.0
    plant = mode_at(f_hz, width, peak)
    p = plant.poles()[np.argmax(plant.poles().imag)]
    residue = np.polyval(plant.num, p) / np.polyval(np.polyder(plant.den), p) / TWO_PI
    P = plant.response(LINES)
    (pole,) = hidden_poles(LINES, P, (1e-6 * np.abs(P)) ** 2)
    assert pole.pole_hz.real == pytest.approx(p.imag / TWO_PI, abs=1e-3 * GAP)
    assert pole.pole_hz.imag == pytest.approx(-p.real / TWO_PI, rel=0.02)
    assert pole.residue == pytest.approx(residue, rel=0.02)


def test_resonances_that_encircle_minus_one_are_counted_though_no_line_meets_them():
    right = stepped_over = 0
    for place in (0.2, 0.5, 0.8):
        for width in (0.03, 0.1, 0.4):
            for peak in (-30.0, 30.0):
                plant = mode_at(14.2 + place * GAP, width, peak)
                found = answer(plant, 1e-6)
                assert found.outcome == "undecided" or found.unstable_poles == by_roots(plant)
                right += found.outcome != "undecided"
                stepped_over += count_unstable(plant.response(LINES), 1, 0, np.zeros(0)) != by_roots(plant)
    assert right == 18
    assert stepped_over >= 6  # what the bare count of these lines makes of them


@pytest.mark.long
@pytest.mark.parametrize("noise", [0.02, 0.05])
def test_with_noise_they_are_counted_or_left_open_with_their_gap_to_measure(noise):
    rng, open_ones = np.random.default_rng(1), 0
    for _ in range(40):
        f_hz = rng.uniform(6.0, 30.0)
        plant = mode_at(
            f_hz, np.exp(rng.uniform(np.log(0.1), np.log(0.6))), rng.choice([-1.0, 1.0]) * rng.uniform(5, 50)
        )
        found = answer(plant, noise, rng)
        if found.outcome == "undecided" and "measure finer" in found.reason:
            open_ones += 1
            assert found.band_hz[0] < f_hz < found.band_hz[1]
            assert found.band_hz[1] - found.band_hz[0] < 12.0 * GAP
        elif found.outcome != "undecided":
            assert found.unstable_poles == by_roots(plant)
    assert 1 <= open_ones <= 30


def test_a_resonance_whose_tails_drown_is_not_seen_and_the_visible_residue_says_how_sharp_it_may_be():
    f_hz, width = 14.25, 0.02
    plant = mode_at(f_hz, width, -4.0)
    assert by_roots(plant) == 2
    drowned = loop_with(plant, 0.2, np.random.default_rng(2))
    assert closed_loop_stability(drowned).outcome == "stable"
    assert unseen(drowned) > width * GAP / f_hz
    assert answer(plant, 0.001, np.random.default_rng(2)).outcome != "stable"
    assert unseen(loop_with(PLANT, 1e-3, np.random.default_rng(2))) < 0.1 * unseen(drowned)


def test_smooth_plants_have_no_hidden_poles():
    rng, alarms = np.random.default_rng(3), 0
    for noise in (1e-6, 0.02, 0.1) * 60:
        num = np.polymul(real(rng.uniform(0.5, 30.0)), real(rng.uniform(0.5, 30.0)))
        den = np.polymul(real(rng.uniform(0.5, 30.0)), real(rng.uniform(0.5, 30.0)))
        plant = TransferFunction(num, np.append(den, np.zeros(rng.integers(0, 3))), rng.uniform(0.001, 0.02))
        f = LINES if rng.random() < 0.5 else np.geomspace(0.05, 200.0, 500)
        std = noise * np.abs(plant.response(f))
        alarms += bool(hidden_poles(f, plant.response(f) + std * errors(rng, f.size), std**2))
    assert alarms <= 2  # a chance of 0.1 % a record, and what polynomials round off


def test_a_resolved_resonance_is_none_of_them():
    plant = mode_at(14.25, 5.0, 10.0)
    P = plant.response(LINES)
    assert not hidden_poles(LINES, P, (1e-3 * np.abs(P)) ** 2)


def test_few_lines_show_none():
    P = PLANT.response(LINES[:9])
    assert hidden_poles(LINES[:9], P, (0.01 * np.abs(P)) ** 2) == ()
    assert np.isinf(between_lines(LINES[:9], P, (0.01 * np.abs(P)) ** 2).visible_residue).all()


@pytest.mark.parametrize("peak", [60.0, 4.0])
def test_a_resonance_of_the_controller_between_lines_is_counted(peak):
    # an inverted notch 0.2 gaps wide lifts L to 0.06 or 0.9 times `peak` between two lines
    f_hz = 30.03
    notch = Block("notch", {"f1_hz": f_hz, "f2_hz": f_hz, "damping1": peak * 0.0005, "damping2": 0.0005})
    loop = loop_of(PLANT, frf_of(LINES, PLANT.response(LINES), 1e-9 * np.abs(PLANT.response(LINES))), blocks=(notch,))
    b, a = notch.section()
    num, den = np.polymul(PLANT.num, b[::-1]), np.polymul(PLANT.den, a[::-1])
    poles = int(np.sum(np.roots(np.polyadd(num, den)).real > 0.0))
    assert poles == (2 if peak == 60.0 else 0)
    assert closed_loop_stability(loop).unstable_poles == poles
    assert count_unstable(loop.L, 1, 0, np.zeros(0)) == 0  # what the lines alone show


def limits(plant):
    """All gains between 0.01 and 100 at which the number of unstable poles changes."""
    gains, found = np.geomspace(1e-2, 1e2, 200), []
    counts = [by_roots(plant, g) for g in gains]
    for k in np.flatnonzero(np.diff(counts)):
        low, high = gains[k], gains[k + 1]
        while high / low > 1.0 + 1e-8:
            middle = np.sqrt(low * high)
            low, high = (middle, high) if by_roots(plant, middle) == counts[k] else (low, middle)
        found.append(low)
    return found


@pytest.mark.parametrize("second", [False, True])
def test_one_step_inside_and_outside_limits_that_lie_between_lines_the_answer_is_never_wrong(second):
    decided = every = 0
    cases = [(0.2, 0.4, -6.0), (0.5, 1.2, -6.0), (0.8, 0.4, -30.0)]
    cases += [] if second else [(0.8, 0.05, -30.0)]  # two are told from the rest where a sixth of a gap wide at least
    for place, width, peak in cases:
        plant = mode_at(14.2 + place * GAP, width, peak)
        if second:  # another one 2.5 gaps off
            plant = with_mode(plant, 14.45 + place * GAP, 0.3 * GAP / 14.0, -8.0 * abs(PLANT.response([14.2])[0]))
        P = plant.response(LINES)
        frf = frf_of(LINES, P, 1e-6 * np.abs(P))
        for gain in limits(plant):
            for step in (0.9, 0.97, 0.997, 1.003, 1.03, 1.1):
                found = closed_loop_stability(loop_of(plant, frf, step * gain))
                assert found.outcome == "undecided" or found.unstable_poles == by_roots(plant, step * gain)
                decided, every = decided + (found.outcome != "undecided"), every + 1
    assert second or decided > 0.5 * every  # two so near are left open


def test_two_resonances_within_a_few_lines_are_not_taken_for_none():
    plant = with_mode(mode_at(14.22, 0.05, -30.0), 14.47, 0.002, -8.0 * abs(PLANT.response([14.2])[0]))
    P = plant.response(LINES)
    rough = between_lines(LINES, P, (1e-6 * np.abs(P)) ** 2).roughness
    assert np.any(rough[(LINES[:-1] > 14.0) & (LINES[:-1] < 14.6)] > 0.02 * abs(PLANT.response([14.2])[0]))
    found = answer(plant, 1e-6)
    assert found.unstable_poles == by_roots(plant) == 4
    assert count_unstable(P, 1, 0, np.zeros(0)) != 4
    smooth = PLANT.response(LINES)
    assert not between_lines(LINES, smooth, (0.05 * np.abs(smooth)) ** 2).roughness.any()


@pytest.mark.parametrize("peak", [-30.0, 4.0])
def test_a_growing_mode_between_lines_is_counted_where_unstable_poles_are_declared(peak):
    plant = mode_at(14.25, -0.2, peak)
    assert plant.unstable_poles() == 2
    found = answer(plant, 1e-6)
    assert found.unstable_poles == by_roots(plant) == (2 if peak > 0.0 else 0)


def test_a_long_delay_hides_no_pole_and_makes_none():
    # a second of delay turns the plant by 360 deg over the lines of a window
    late = TransferFunction(PLANT.num, PLANT.den, 1.0).response(LINES)
    assert not hidden_poles(LINES, late, (1e-3 * np.abs(late)) ** 2)
    with_pole = mode_at(14.25, 0.1, 4.0).response(LINES) * late / PLANT.response(LINES)
    (pole,) = hidden_poles(LINES, with_pole, (1e-3 * np.abs(late)) ** 2)
    assert pole.pole_hz.real == pytest.approx(14.25, abs=0.02)


def test_what_polynomials_round_off_at_the_lowest_lines_is_no_pole():
    rng, alarms = np.random.default_rng(3), 0
    for integrators in (2, 3) * 100:
        num = np.ones(1)
        for _ in range(integrators - 1):
            num = np.polymul(num, real(np.exp(rng.uniform(np.log(0.3), np.log(3.0)))))
        den = np.append(np.polymul(real(rng.uniform(8.0, 40.0)), real(rng.uniform(8.0, 40.0))), np.zeros(integrators))
        P = TransferFunction(num, den).response(LINES)
        alarms += bool(hidden_poles(LINES, P, (1e-6 * np.abs(P)) ** 2))
    assert alarms <= 2


def test_poles_are_looked_for_on_the_lines_as_they_were_measured():
    # smoothing takes away what a pole leaves on a few lines
    rng, found = np.random.default_rng(14), [0, 0]
    plant = mode_at(14.25, 0.1, -1.3)
    for _ in range(20):
        P = plant.response(LINES)
        loop = loop_of(plant, frf_of(LINES, P, 0.08 * np.abs(P), rng))
        for k, one in enumerate((replace(loop, scatter=None), replace(loop, raw=None, scatter=None))):
            found[k] += bool(sampling(one, path_of(one)).interpolated.any())
    assert found[0] >= 14 > found[1]


@pytest.mark.parametrize("turn_deg", [60.0, 80.0, 100.0])
@pytest.mark.parametrize("slope", [1.5, 2.0])
def test_a_curve_between_lines_is_followed_where_its_chord_takes_the_other_side(turn_deg, slope):
    # a power of f with a turn of so many degrees an octave, on eight lines and on four thousand
    def spiral(f):
        return 1.5 * f**-slope * np.exp(-1j * np.radians(165.0 + turn_deg * np.log2(f)))

    coarse, dense = np.arange(1.0, 9.0), np.linspace(1.0, 8.0, 4000)
    none = np.zeros(0)
    assert count_unstable(spiral(coarse), 1, 0, none) == 0 != count_unstable(spiral(dense), 1, 0, none) == 2
    loop = loop_of(PLANT, frf_of(coarse, spiral(coarse), 1e-9), smooth=False)
    path = path_of(loop)
    assert count_unstable(path.L, 1, 0, none) == 2
    assert next(obstacles(loop, path, sampling(loop, path), 1e3), None) is None


def test_lines_far_apart_in_ratio_do_not_show_what_lies_between():
    """Half an octave from line to line: two sharp modes destabilise a loop that was called stable."""
    lines, crossing_hz = np.geomspace(3.0, 450.0, 17), 14.1
    num, den = np.ones(1), np.polymul([1.0 / (TWO_PI * 0.636), 1.0], [1.0 / (TWO_PI * 78.5), 1.0])
    for pole_hz, zero_hz, damping in ((25.73, 32.18, 0.0095), (16.41, 21.97, 0.0183)):
        num, den = (
            np.polymul(x, [(TWO_PI * at) ** -2, 2.0 * damping / (TWO_PI * at), 1.0])
            for x, at in ((num, zero_hz), (den, pole_hz))
        )
    P = TransferFunction(num, den)
    gain = float(1.0 / abs(P.response(np.array([crossing_hz]))[0]))
    assert np.any(np.roots(np.polyadd(gain * num, den)).real > 0.0)
    rng = np.random.default_rng(0)
    noise = 1.0 + 0.003 * (rng.standard_normal(lines.size) + 1j * rng.standard_normal(lines.size))
    frf = ls.FRF.from_arrays(lines, P.response(lines) * noise, relative_std=0.0042, rate_hz=1e4)
    margins = ls.check(frf, ls.controller(ls.gain(gain), rate_hz=1e4), ls.Requirements(unstable_poles=0)).margins
    assert margins["frf 1"].stable == "undecided", margins["frf 1"].stability_reason
