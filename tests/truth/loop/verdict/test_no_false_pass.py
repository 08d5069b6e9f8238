"""Verdicts that an examiner found wrong with confidence, each with a truth from the exact transfer function."""

import re

import control
import numpy as np
import pytest
from bench_nouns import Block, Loop
from conversions import TWO_PI

import loopshape as ls
from loopshape.loop.matrix.matrix_margins import matrix_margins
from loopshape.loop.verdict import check

RATE = 20_000.0


def controller(*blocks, rate_hz=RATE):
    return ls.Controller("x", tuple(Block(kind, values) for kind, values in blocks), rate_hz)


def measured(P, f, relative=1e-6, seed=1):
    """Lines of an exact response P(f) with circular relative errors, whose variance is known."""
    rng = np.random.default_rng(seed)
    exact = P(f)
    error = (rng.standard_normal(f.size) + 1j * rng.standard_normal(f.size)) / np.sqrt(2.0)
    G = (exact * (1.0 + relative * error))[:, None, None]
    variance = (relative * np.abs(exact)) ** 2
    return ls.FRF(f, G, variance[:, None, None] + 0j, np.ones(f.size, bool), ("u",), ("y",), "known", "one", "x", RATE)


def line_of(verdict, quantity):
    return next(line for line in verdict.lines if line.quantity == quantity)


W8 = TWO_PI * 8.0
LEAD = controller(("gain", {"gain": 2.2}), ("lead_lag", {"f1_hz": 8.0, "f2_hz": 150.0}))


def levitated(f):
    s = 1j * TWO_PI * f
    return W8**2 / (s**2 - W8**2) * np.exp(-0.001 * s)


@pytest.mark.parametrize("relative", [1e-6, 0.01])
def test_a_gain_reduction_margin_whose_crossing_lies_at_0_hz_is_seen(relative):
    truth_db = 20.0 * np.log10(2.2)  # |L(0)|: the plant is -1 there, the lead 1
    frf = measured(levitated, np.geomspace(0.5, 200.0, 400), relative)
    wish = ls.Requirements("x", gain_reduction_margin_db=10.0, integrators=0, unstable_poles=1)
    verdict = check([frf], LEAD, wish)
    found = line_of(verdict, "gain_reduction_margin_db")
    assert found.value == pytest.approx(truth_db, abs=0.1)
    low, high = found.interval
    assert low <= truth_db <= high
    assert (found.outcome, verdict.margins["one"].stable) == ("failed", "stable")


W5 = TWO_PI * 5.0
LOW_PASS = controller(("gain", {"gain": 3.0}), ("low_pass_1", {"f_hz": 6.0}), rate_hz=1000.0)


def growing(f):
    s = 1j * TWO_PI * f
    return W5**2 / (s**2 - 0.2 * W5 * s + W5**2) * np.exp(-0.001 * s)


def test_a_growing_mode_that_nobody_declared_does_not_pass():
    frf = measured(growing, np.geomspace(0.3, 100.0, 300), 0.01)
    frf = ls.FRF(frf.frequency_hz, frf.response, frf.covariance, frf.valid, ("u",), ("y",), "known", "one", "x", 1000.0)
    wish = ls.Requirements("x", phase_margin_deg=45.0)
    margins = check([frf], LOW_PASS, wish).margins["one"]
    assert margins.stable == "undecided"
    assert "unstable poles of the plant is not known" in margins.stability_reason
    (at_hz,) = re.findall(r"the phase rises by 180 deg through the resonance at (\S+) Hz", margins.stability_reason)
    assert float(at_hz) == pytest.approx(5.0, abs=0.05)
    declared = check([frf], LOW_PASS, ls.Requirements("x", phase_margin_deg=45.0, integrators=0, unstable_poles=2))
    assert declared.margins["one"].stable == "unstable"


def falling(f):
    """An integrator, a lag at 20 Hz and 1 ms: crosses the negative axis at 75 Hz."""
    s = 1j * TWO_PI * f
    return np.exp(-0.001 * s) / (s * (1.0 + s / (TWO_PI * 20.0)))


def true_margins(P, C, f):
    """Gain margin in dB and peak |S| in dB on a grid so dense that interpolation does not matter."""
    L = P(f) * C.response(f)
    k = np.flatnonzero((L.imag[:-1] < 0.0) & (L.imag[1:] >= 0.0) & (L.real[:-1] < 0.0))
    return -20.0 * np.log10(np.abs(L[k[0]])), 20.0 * np.log10(np.max(1.0 / np.abs(1.0 + L)))


GAIN = controller(("gain", {"gain": 40.0}))


def test_a_gain_margin_beyond_the_last_line_is_a_bound_and_not_an_estimate():
    truth_db, _ = true_margins(falling, GAIN, np.geomspace(0.1, 400.0, 200_000))
    frf = measured(falling, np.geomspace(0.2, 28.0, 300), 1e-3)
    wish = ls.Requirements("x", gain_margin_db=truth_db - 1.0, integrators=1, unstable_poles=0)
    found = line_of(check([frf], GAIN, wish), "gain_margin_db")
    assert found.outcome == "undecided"
    assert found.value < truth_db < found.bound
    assert 28.0 < found.measure_to_hz < 400.0
    longer = measured(falling, np.geomspace(0.2, found.measure_to_hz, 400), 1e-3)
    assert line_of(check([longer], GAIN, wish), "gain_margin_db").outcome == "passed"


def test_a_peak_of_s_that_only_the_unseen_rest_could_reach_is_a_bound():
    f = np.geomspace(0.2, 12.0, 300)
    _, truth_db = true_margins(falling, GAIN, np.geomspace(0.1, 400.0, 200_000))
    frf = measured(falling, f, 1e-3)
    wish = ls.Requirements("x", sensitivity_peak_db=truth_db + 0.5, integrators=1, unstable_poles=0)
    found = line_of(check([frf], GAIN, wish), "sensitivity_peak_db")
    assert found.outcome == "undecided"
    assert found.bound < truth_db < found.value
    strict = ls.Requirements("x", sensitivity_peak_db=0.01, integrators=1, unstable_poles=0)
    assert line_of(check([frf], GAIN, strict), "sensitivity_peak_db").outcome == "failed"


def lag(f):
    return 0.5 / (1.0 + 1j * f / 3.0) * np.exp(-2j * np.pi * f * 0.002)


def test_a_stable_lag_below_1_everywhere_is_stable():
    unit = controller(("gain", {"gain": 1.0}))
    frf = measured(lag, np.geomspace(0.2, 60.0, 300), 0.01)
    margins = check([frf], unit, ls.Requirements("x", integrators=0, unstable_poles=0)).margins["one"]
    assert margins.stable == "stable"


def coupled_by_ac(f):
    """A zero at s = 0, a resonance at 12 Hz: under a gain of 30 with 2 ms of delay it is unstable, under 0.3 stable."""
    s, w = 1j * TWO_PI * f, TWO_PI * 12.0
    return w * s / (s**2 + 0.02 * w * s + w**2) / (1.0 + s / (TWO_PI * 60.0)) * np.exp(-0.002 * s)


def closed_loop_unstable(gain):
    """Right half plane poles of the loop about `coupled_by_ac`, with the delay as a Pade approximation of order 6."""
    num, den = control.pade(0.002, 6)
    w = TWO_PI * 12.0
    plant_den = np.polymul([1.0, 0.02 * w, w**2], [1.0 / (TWO_PI * 60.0), 1.0])
    return int(np.sum(np.roots(np.polyadd(np.polymul(plant_den, den), gain * np.polymul([w, 0.0], num))).real > 0.0))


@pytest.mark.parametrize("gain", [0.02, 1.0, 30.0])
def test_a_zero_at_0_hz_can_be_declared(gain):
    frf = measured(coupled_by_ac, np.geomspace(0.5, 800.0, 1200), 1e-3)
    own = controller(("gain", {"gain": gain}))
    margins = check([frf], own, ls.Requirements("x", integrators=-1, unstable_poles=0)).margins["one"]
    assert margins.stable == ("unstable" if closed_loop_unstable(gain) else "stable")


def test_a_bearing_measured_from_above_half_its_corner_is_decided():
    frf = measured(levitated, np.geomspace(5.0, 200.0, 400), 1e-3)
    verdict = check([frf], LEAD, ls.Requirements("x", gain_reduction_margin_db=10.0, integrators=0, unstable_poles=1))
    assert verdict.margins["one"].stable == "stable"
    low, high = line_of(verdict, "gain_reduction_margin_db").interval
    assert low <= 20.0 * np.log10(2.2) <= high


def test_a_triple_integrator_declared_as_such_is_decided():
    def triple(f):
        s = 1j * TWO_PI * f
        return (TWO_PI * 2.0) ** 3 / s**3 * (1.0 + s / (TWO_PI * 0.5)) ** 2 / (1.0 + s / (TWO_PI * 80.0)) ** 2

    f = np.geomspace(0.3, 400.0, 600)
    own = controller(("gain", {"gain": 1.0}))
    wish = ls.Requirements("x", integrators=3, unstable_poles=0)
    margins = check([measured(triple, f, 1e-3)], own, wish).margins["one"]
    lead, lag = np.array([1.0 / (TWO_PI * 0.5), 1.0]), np.array([1.0 / (TWO_PI * 80.0), 1.0])
    den = np.polymul(np.polymul(lag, lag), [1.0, 0.0, 0.0, 0.0])
    poles = np.roots(np.polyadd(den, (TWO_PI * 2.0) ** 3 * np.polymul(lead, lead)))
    assert margins.stable == ("unstable" if np.any(poles.real > 0.0) else "stable")


def mode(s, f_hz, damping):
    w = TWO_PI * f_hz
    return w * w / (s * s + 2.0 * damping * w * s + w * w)


def several_crossings(f):
    s = 1j * TWO_PI * f
    return (40.0 / s / (1.0 + s / (TWO_PI * 60.0)) + 0.08 * mode(s, 31.0, 0.015)) * np.exp(-0.001 * s)


def on_a_grid(f):
    s = 1j * TWO_PI * f
    return (30.0 / s + 0.02 * mode(s, 20.05, 0.01)) * np.exp(-0.001 * s)


def sharper_than_the_lines(f):
    s = 1j * TWO_PI * f
    return (40.0 / s / (1.0 + s / (TWO_PI * 60.0)) + 0.012 * mode(s, 31.0, 0.004)) * np.exp(-0.001 * s)


NARROW = {
    "a mode of damping 0.015 that crosses 0 dB again": (several_crossings, np.geomspace(0.5, 120.0, 500), 31.0),
    "a mode of damping 0.01 on a grid of 0.1 Hz": (on_a_grid, np.arange(0.5, 100.0, 0.1), 20.05),
    "a mode of damping 0.004 between lines": (sharper_than_the_lines, np.geomspace(0.5, 120.0, 500), 31.0),
}


def exact(P, f, f_hz):
    """Margins on a grid so dense about the mode that chords do not matter."""
    dense = np.unique(np.concatenate([np.geomspace(f[0], f[-1], 200_000), np.linspace(0.95, 1.05, 100_000) * f_hz]))
    L = P(dense)
    distance = np.abs(1.0 + L)
    crossed = np.flatnonzero((np.abs(L[:-1]) >= 1.0) != (np.abs(L[1:]) >= 1.0))
    ahead = np.mod(np.angle(L[crossed]) + np.pi, TWO_PI)
    return {
        "sensitivity_peak_db": -20.0 * np.log10(distance.min()),
        "phase_margin_deg": np.degrees(np.minimum(ahead, TWO_PI - ahead).min()),
        "delay_margin_s": np.min(ahead / TWO_PI / dense[crossed]),
        "disk_margin": np.min(2.0 * distance / np.abs(1.0 - L)),
        "complementary_peak_db": 20.0 * np.log10(np.max(np.abs(L) / distance)),
    }


@pytest.mark.long
@pytest.mark.parametrize("name", NARROW)
def test_intervals_know_the_gap_between_two_lines(name):
    P, f, f_hz = NARROW[name]
    unit, wish = controller(("gain", {"gain": 1.0})), ls.Requirements("x", integrators=1, unstable_poles=0)
    truth = exact(P, f, f_hz)
    found = [check([measured(P, f, 0.01, seed)], unit, wish).margins["one"] for seed in range(16)]
    inside = {q: np.mean([m.intervals[q][0] <= x <= m.intervals[q][1] for m in found]) for q, x in truth.items()}
    assert min(inside.values()) >= 0.75  # 16 draws of 0.95: less in 1 of 1,000 cases
    assert np.mean(list(inside.values())) >= 0.9
    assert np.median([m.sensitivity_peak_db for m in found]) == pytest.approx(truth["sensitivity_peak_db"], abs=0.05)
    narrow = np.median([np.ptp(m.intervals["sensitivity_peak_db"]) for m in found])
    assert narrow < 0.5  # and they are no wider than 1 % noise makes them


SHAPES = np.array([[1.8, -2.6, 0.4], [-0.6, -0.5, -0.2], [-2.0, -0.2, -0.9]])  # of three modes at three outputs
MODES = ((18.3, 0.006, 0.10), (31.0, 0.004, 0.10), (47.0, 0.008, 0.15))


def flexible(f):
    s = 1j * TWO_PI * f
    P = (np.eye(3) + 0.2) * (30.0 / s / (1.0 + s / (TWO_PI * 80.0)))[:, None, None]
    for (f_hz, damping, size), shape in zip(MODES, SHAPES, strict=True):
        P = P + (6.0 * size * damping * mode(s, f_hz, damping))[:, None, None] * np.outer(shape, shape)
    return P * np.exp(-0.001 * s)[:, None, None]


def smallest(f):
    """Least singular value of I + L: one over the largest of S."""
    return np.linalg.svd(np.eye(3) + flexible(f), compute_uv=False)[:, -1]


@pytest.mark.long
def test_three_loops_with_narrow_modes_are_read_between_the_lines():
    f = np.geomspace(0.5, 120.0, 400)
    dense = np.unique(np.concatenate([f, *(np.linspace(0.96, 1.04, 4000) * f_hz for f_hz, _, _ in MODES)]))
    truth_db = -20.0 * np.log10(smallest(dense).min())
    assert -20.0 * np.log10(smallest(f).min()) < truth_db - 0.3  # the lines alone do not show it
    controllers = tuple(ls.Controller(name, (Block("gain", {"gain": 1.0}),), RATE) for name in "abc")
    exact_P = flexible(f)
    for seed in range(3):
        rng = np.random.default_rng(seed)
        std = 3e-3 * np.sqrt(np.mean(np.abs(exact_P) ** 2, axis=(1, 2)))
        error = rng.standard_normal((*exact_P.shape, 2)) @ np.array([1.0, 1j]) * np.sqrt(0.5)
        covariance = np.zeros((f.size, 9, 9), dtype=complex)
        covariance[:, range(9), range(9)] = (std**2)[:, None]
        names = ("u1_V", "u2_V", "u3_V"), ("y1_m", "y2_m", "y3_m")
        known = np.ones(f.size, dtype=bool)
        G = exact_P + std[:, None, None] * error
        frf = ls.FRF(f, G, covariance, known, *names, "known", "one", "a+b+c", RATE)
        found = matrix_margins(Loop(frf, controllers, 3, 0))
        low, high = found.intervals["sensitivity_peak_db"]
        assert low - 0.02 <= truth_db <= high + 0.02
        assert high - low < 0.5
