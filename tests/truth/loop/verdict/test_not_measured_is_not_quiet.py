"""What was not measured is not quiet: holes, poor lines, what lies below the first line, hidden integrators, guesses.

Truths are roots of polynomials and dense grids of the formulas, written out here.
"""

from dataclasses import replace

import numpy as np
import pytest
from bench_nouns import Loop
from conversions import TWO_PI, db

import loopshape as ls
from loopshape.loop.loops import loops_of
from loopshape.loop.margin.margins import margins
from loopshape.loop.matrix.matrix_margins import FIELDS, matrix_margins

MODE = TWO_PI * 32.0


def with_mode(f):
    """An integrator with a crossover at 5 Hz and a mode at 32 Hz of damping 0.003 that makes a plain gain unstable."""
    s = 1j * TWO_PI * f
    return 10.0 * np.pi / s * (1.0 - 0.05 * s * s / (s * s + 0.006 * MODE * s + MODE * MODE))


def only(verdict):
    (found,) = verdict.margins.values()
    return found


def under_gain(P, gain=1.0, rate_hz=4000.0, **required):
    return ls.check(P, ls.controller(ls.gain(gain), rate_hz=rate_hz), ls.Requirements(**required))


def test_the_loop_with_the_mode_is_unstable():
    poles = np.roots([1.0, 0.006 * MODE + 9.5 * np.pi, MODE**2 + 0.06 * np.pi * MODE, 10.0 * np.pi * MODE**2])
    assert (poles.real > 0.0).sum() == 2


@pytest.mark.parametrize("noise", [3e-3, 1e-3, 1e-4, 1e-6])
@pytest.mark.parametrize("hole", [(24.0, 44.0), (30.0, 34.5), (31.0, 33.0)])
def test_a_hole_in_which_a_mode_may_hide_is_never_passed(noise, hole):
    f = np.geomspace(0.2, 1500.0, 500)
    f = f[(f < hole[0]) | (f > hole[1])]
    P = ls.FRF.from_arrays(f, with_mode(f), relative_std=noise, rate_hz=4000.0, open_loop=True)
    verdict = under_gain(P, modulus_margin=0.5, integrators=1, unstable_poles=0)
    assert not verdict.passed
    if only(verdict).stable == "undecided":
        low, high = only(verdict).stability_band_hz
        assert low < 32.0 < high


def test_a_mode_above_a_poor_band_bounds_the_gain_margin_as_it_was_measured():
    """L comes up to -0.15 at 16 Hz, above lines known to 40 % alone that end the valid band at 3.8 Hz with |L| 0.1."""
    f = np.geomspace(0.05, 50.0, 600)
    s, w = 1j * TWO_PI * f, TWO_PI * 16.0
    G = 1.0 / (1.0 + s / (0.38 * TWO_PI)) - 0.003 * w * s / (s * s + 0.02 * w * s + w * w)
    true_db = -20.0 * np.log10(-G.real[np.flatnonzero(np.diff(np.sign(G.imag)))].min())
    assert 15.0 < true_db < 17.0
    poor = (f > 3.8) & (f < 4.3)
    relative = np.where(poor, 0.4, 0.01)
    P = ls.FRF.from_arrays(f, G, relative_std=0.01, rate_hz=4000.0, open_loop=True)
    P = replace(P, covariance=(relative * np.abs(G))[:, None, None] ** 2 + 0j, valid=f <= 3.8)
    asked = {"integrators": 0, "unstable_poles": 0}
    assert not under_gain(P, gain_margin_db=true_db + 1.0, **asked).passed
    assert only(under_gain(P, gain_margin_db=6.0, **asked)).gain_margin_db < true_db + 0.2


@pytest.mark.long
def test_a_distance_known_worse_than_to_half_has_an_interval_as_wide_as_the_errors():
    """|1 + L| is 9e-4 at its least and each line errs by 3e-3: no draw of noise leaves a hundredth of that sure."""

    def loop(f):
        s = 1j * f
        return 1.996 / (s * (1.0 + s) ** 2)

    f = np.geomspace(0.2, 50.0, 300)
    truth = np.abs(1.0 + loop(np.linspace(0.9, 1.1, 20001))).min()
    missed = 0
    for seed in range(40):
        rng = np.random.default_rng(seed)
        noise = 0.003 * np.sqrt(0.5) * (rng.standard_normal(f.size) + 1j * rng.standard_normal(f.size))
        P = ls.FRF.from_arrays(f, loop(f) * (1.0 + noise), relative_std=0.003, rate_hz=4000.0, open_loop=True)
        found = only(under_gain(P, 1.0, modulus_margin=1e-3, integrators=1, unstable_poles=0))
        low, high = found.intervals["modulus_margin"]
        missed += not low <= truth <= high
    assert missed <= 6


def test_the_same_hole_where_l_is_small_decides_nothing():
    f = np.geomspace(0.2, 1500.0, 500)
    f = f[(f < 400.0) | (f > 480.0)]
    s = 1j * TWO_PI * f
    P = ls.FRF.from_arrays(f, 10.0 * np.pi / s, relative_std=3e-3, rate_hz=4000.0, open_loop=True)
    assert under_gain(P, modulus_margin=0.5, integrators=1, unstable_poles=0).passed


@pytest.mark.parametrize("error", [0.11, 0.2, 0.35, 0.5, 0.8])
def test_lines_that_are_known_badly_are_not_taken_for_quiet(error):
    f = np.geomspace(0.2, 1500.0, 500)
    G = with_mode(f)
    std = np.where((f > 24.0) & (f < 44.0), error, 0.003) * np.abs(G)
    P = ls.FRF.from_arrays(f, G, std=std, rate_hz=4000.0, open_loop=True)
    assert not under_gain(P, modulus_margin=0.5, integrators=1, unstable_poles=0).passed


LAG = ls.controller(ls.gain(1.4), ls.pi(0.02), rate_hz=5000.0)


def unstable_at_1_hz(f):
    return 1.0 / (1j * f - 1.0) * np.exp(-2j * np.pi * f * 0.002)


@pytest.mark.parametrize("low_hz", [0.1, 0.3, 0.6, 0.9])
def test_peaks_and_reduction_below_the_first_line_are_read_by_models_of_the_lowest_lines(low_hz):
    g = np.geomspace(1e-3, 200.0, 40_000)
    L = unstable_at_1_hz(g) * LAG.response(g)
    low = g < 1.0
    truth = {
        "sensitivity_peak_db": db(1.0 / np.abs(1.0 + L)).max(),
        "complementary_peak_db": db(np.abs(L / (1.0 + L))).max(),
        "gain_reduction_margin_db": db(-L.real[low][np.argmin(np.abs(L.imag[low]))]),
    }
    f = np.geomspace(low_hz, 200.0, 300)
    P = ls.FRF.from_arrays(f, unstable_at_1_hz(f), relative_std=1e-3, rate_hz=5000.0)
    R = ls.Requirements(
        sensitivity_peak_db=6, gain_reduction_margin_db=6, complementary_peak_db=8, integrators=0, unstable_poles=1
    )
    verdict = ls.check(P, LAG, R)
    assert verdict.outcome == "failed"
    for line in verdict.lines:
        assert line.outcome == "failed"
        assert line.value == pytest.approx(truth[line.quantity], abs=0.05)


@pytest.mark.parametrize("low_hz", [12.0, 15.0, 30.0])
@pytest.mark.parametrize("factor", [0.9, 1.1])
def test_a_crossover_below_the_first_line_fails_no_bandwidth_and_passes_no_peak(low_hz, factor):
    """Bandwidths and peaks of a grid down to 0.01 Hz; all three bandwidths lie below the lines."""

    def plant(f):
        s = 1j * TWO_PI * f
        return 60.0 / (s * (s / (TWO_PI * 60.0) + 1.0))

    g = np.geomspace(0.01, 60.0, 200_000)
    S = 1.0 / (1.0 + plant(g))
    truth = {
        "bandwidth_hz": g[np.argmax(np.abs(plant(g)) < 1.0)],
        "sensitivity_bandwidth_hz": g[np.argmax(np.abs(S) > 10.0**-0.15)],
        "complementary_bandwidth_hz": g[np.flatnonzero(np.abs(1.0 - S) > 10.0**-0.15)[-1]],
    }
    assert all(8.0 < value < 12.0 for value in truth.values())
    f = np.arange(low_hz, 60.0, 0.5)
    P = ls.FRF.from_arrays(f, plant(f), relative_std=0.01, rate_hz=5000.0, open_loop=True)
    peaks = {"control_peak_db": 40.0, "process_peak_db": 40.0}
    asked = {name: factor * value for name, value in truth.items()} | peaks
    verdict = under_gain(P, rate_hz=5000.0, integrators=1, unstable_poles=0, **asked)
    for line in verdict.lines:
        above = line.quantity in truth and line.required > low_hz  # where the lines show that it is not reached
        assert line.outcome == ("failed" if above else "undecided")
        if above:
            continue
        assert line.measure_to_hz == pytest.approx(0.1 * low_hz)
        low, high = line.span
        assert low <= truth.get(line.quantity, np.inf) <= high


AC_COUPLED = ls.Requirements(phase_margin_deg=45, sensitivity_peak_db=6, integrators=-1, unstable_poles=0)


def ac_coupled():
    f = np.geomspace(0.05, 200.0, 400)
    s = 1j * TWO_PI * f
    return ls.FRF.from_arrays(f, s / (s + np.pi) / (1 + s / (10 * np.pi)), relative_std=1e-4, rate_hz=1000.0)


def test_an_integrator_that_the_plants_zero_hides_fails():
    num = np.polymul([2.0, 4.0 * np.pi], np.polymul([1.0, np.pi], [0.1 / np.pi, 1.0]))
    den = np.polymul([1.0, 0.0], np.polymul([1.0, np.pi], [0.1 / np.pi, 1.0]))
    den = np.polyadd(den, np.polymul([2.0, 4.0 * np.pi], [1.0, 0.0]))
    assert np.abs(np.roots(den)).min() == 0.0  # of CS = num/den
    assert np.polyval(num, 0.0) != 0.0
    verdict = ls.check(ac_coupled(), ls.controller(ls.gain(2.0), ls.pi(1.0), rate_hz=1000.0), AC_COUPLED)
    assert verdict.outcome == "failed"
    assert "at 0 Hz cancels the controller's integrator" in only(verdict).stability_reason
    assert ls.check(ac_coupled(), ls.controller(ls.gain(2.0), rate_hz=1000.0), AC_COUPLED).passed


def test_a_tuning_refuses_an_integrator_that_the_plants_zero_hides():
    with pytest.raises(ls.LoopshapeError, match="0 Hz"):
        ls.tune(ac_coupled(), AC_COUPLED, [ls.gain(), ls.pi((0.2, 5.0))], starts=1)


def test_a_guess_of_integrators_beside_unstable_poles_decides_nothing():
    # a pair of unstable poles at 1 Hz falls as two integrators above; the closed loop is stable
    w, f = TWO_PI, np.linspace(3.0, 500.0, 400)
    s = 1j * TWO_PI * f
    P = ls.FRF.from_arrays(f, w * w / (s * s - 0.2 * w * s + w * w), relative_std=0.01, rate_hz=2000.0)
    C = ls.controller(ls.gain(100.0), ls.lead_lag(3.0, 100.0), rate_hz=2000.0)
    lead = np.polymul([1.0, -0.2 * w, w * w], [1 / (100 * w), 1.0])
    assert (np.roots(np.polyadd(lead, 100 * w * w * np.array([1 / (3 * w), 1.0]))).real < 0.0).all()
    guessed = ls.check(P, C, ls.Requirements(unstable_poles=2))
    assert guessed.outcome == "undecided"
    assert "declare integrators" in guessed.warnings[0]
    declared = ls.check(P, C, ls.Requirements(unstable_poles=2, integrators=0))
    assert declared.outcome != "failed"
    assert "declare integrators" not in only(declared).stability_reason


@pytest.mark.parametrize("corner_hz", [0.005, 0.02, 0.1])
@pytest.mark.parametrize("declared", [1, 2])
def test_a_corner_below_the_first_line_leaves_a_true_declaration_alone(corner_hz, declared):
    f = np.geomspace(0.2, 400.0, 250)
    s, n = 1j * TWO_PI * f, np.random.default_rng(0).standard_normal((2, 250))
    G = 1.0 / (s * (s + TWO_PI * corner_hz)) * np.exp(-s * 0.002)
    P = ls.FRF.from_arrays(f, G * (1.0 + 0.01 * (n[0] + 1j * n[1]) / 2**0.5), relative_std=0.01, rate_hz=1000.0)
    C = ls.controller(ls.gain(340.0), ls.lead_lag(1.7, 15.0), rate_hz=1000.0)
    assert only(ls.check(P, C, ls.Requirements(integrators=declared, unstable_poles=0))).stable == "stable"


def test_a_fit_that_has_poles_against_the_declaration_is_not_used():
    f = np.arange(11.0, 251.0)
    s = 1j * TWO_PI * f
    zero, pole = (TWO_PI * x for x in (53.9, 76.2))
    G = 100.0 / (s * (s + TWO_PI)) * (s * s / zero**2 + 0.04 * s / zero + 1) / (s * s / pole**2 + 0.04 * s / pole + 1)
    n = np.random.default_rng(0).standard_normal((2, f.size))
    G = G * np.exp(-0.001 * s) * (1.0 + 0.005 * (n[0] + 1j * n[1]) / 2**0.5)
    P = ls.FRF.from_arrays(f, G, relative_std=0.005, rate_hz=1000.0)
    fitted = ls.fit(P, "rational", numerator=2, denominator=4, delay=True, weighting="relative")
    C = ls.controller(ls.gain(0.5), rate_hz=1000.0)
    R = ls.Requirements(phase_margin_deg=40, unstable_poles=0)
    alone, beside = ls.check(P, C, R), ls.check(P, C, R, fits=(fitted,))
    assert (alone.outcome, beside.outcome) == ("undecided", "undecided")  # it crosses at 0.93 Hz, far below the lines
    assert np.isnan(only(beside).phase_margin_deg)
    assert [line.outcome for line in beside.lines] == ["undecided"]


def test_one_loop_and_the_same_as_a_matrix_have_the_same_interval():
    f = np.geomspace(0.2, 100.0, 300)
    s, n = 1j * TWO_PI * f, np.random.default_rng(3).standard_normal((2, 300))
    G = 30.0 / s / (1.0 + s / 60.0) * np.exp(-0.004 * s) * (1.0 + 0.02 * (n[0] + 1j * n[1]) / 2**0.5)
    P = ls.FRF.from_arrays(f, G, relative_std=0.02, rate_hz=1000.0)
    C = ls.controller(ls.gain(1.0), rate_hz=1000.0)
    (loop,), _ = loops_of([P], C, ls.Requirements(P.loop, integrators=1, unstable_poles=0))
    one, matrix = margins(loop), matrix_margins(Loop(P, (C,), 1, unstable_poles=0))
    shared = [name for name in FIELDS if name in one.intervals]
    assert len(shared) >= 4
    for name in shared:
        width = np.ptp(one.intervals[name])  # chords and parabolas between lines differ by less than this
        np.testing.assert_allclose(matrix.intervals[name], one.intervals[name], rtol=0.0, atol=0.01 * width)
