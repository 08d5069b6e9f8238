"""A memory of one period: its steady error, its verdict and its delays, against known plants and their formulas."""

import control
import numpy as np
import pytest
from conversions import angular

import loopshape as ls
from loopshape.toolbox.diagrams.diagram_run import states

RATE, N = 1000.0, 200
F = np.arange(0.25, 450.0, 0.5)
PLANT = control.c2d(control.ss(control.tf([24.0], [1.0, 5.0, 0.0])), 1.0 / RATE)
C = ls.controller(ls.gain(30.0), ls.lead_lag(5.0, 60.0), rate_hz=RATE, loop="C")
INNER = ls.Requirements("C", integrators=1)


def measured(plant, name="drive"):
    return ls.FRF.from_control(plant, F, relative_std=0.01, open_loop=True, recording=name)


def formula(D, f_hz, gain=1.0):
    """1 + L at the memory from the plant itself: 1 - Q z^-N (1 - T G z^p)."""
    z = np.exp(1j * angular(np.asarray(f_hz)) / RATE)
    L = np.asarray(PLANT(z)) * C.response(f_hz)
    preview = D.part("preview").delay_samples
    return 1.0 - D.part("memory").what.response(f_hz) * (z**-preview - gain * L / (1.0 + L)), 1.0 / (1.0 + L)


def test_the_error_that_is_left_at_each_harmonic_is_that_of_the_formula():
    D = ls.learning.repetitive(measured(PLANT), C, N / RATE, 50.0, requirements=INNER)
    assert sum(D.part(name).delay_samples for name in ("memory", "preview")) + len(D.part("memory").what.blocks) == N
    k, harmonics = np.arange(120 * N), np.array([1, 3])
    r = sum(np.cos(angular(h * RATE / N) * k / RATE) / h for h in harmonics)
    last = np.fft.rfft(ls.diagrams.simulate(D, {"P": PLANT}, {"r": r})["e"][-N:])[harmonics] / (0.5 * N / harmonics)
    f = harmonics * RATE / N
    z = np.exp(1j * angular(f) / RATE)
    one_more, S = formula(D, f)
    memory = D.part("memory").what.response(f) * z ** -D.part("preview").delay_samples
    np.testing.assert_allclose(last, S * (1.0 - memory) / one_more, rtol=1e-4)
    assert (np.abs(1.0 - memory) < (0.01, 0.07)).all()  # at harmonics nothing is left but what Q takes off


def test_the_verdict_on_the_memory_is_that_of_the_known_loop():
    D = ls.learning.repetitive(measured(PLANT), C, N / RATE, 50.0, requirements=INNER)
    R = ls.Requirements("memory", sensitivity_peak_db=15.0, integrators=-1)
    v = ls.check(D, D.part("memory").what, R)
    dense = 20.0 * np.log10(1.0 / np.abs(formula(D, np.linspace(0.1, 499.0, 200_000))[0]))
    margins = v.margins["drive"]
    assert (v.outcome, margins.stable) == (ls.Outcome.PASSED, "stable")
    assert margins.sensitivity_peak_db == pytest.approx(dense.max(), abs=0.03)
    assert np.abs(np.linalg.eigvals(states(D, {"P": PLANT}).A)).max() < 1.0


def test_a_memory_that_learns_too_much_is_not_called_stable():
    D = ls.learning.repetitive(measured(PLANT), C, N / RATE, 50.0, learning=ls.gain(2.5), requirements=INNER)
    assert np.abs(np.linalg.eigvals(states(D, {"P": PLANT}).A)).max() > 1.0
    v = ls.check(D, D.part("memory").what, ls.Requirements("memory", integrators=0))
    assert v.margins["drive"].stable != "stable"


def test_where_a_preview_undoes_the_closed_loop_one_period_is_enough():
    """T = 1/z: with one sample of preview and Q = 1 nothing is left to learn."""
    integrator = control.tf([1.0], [1.0, -1.0], 1.0 / RATE)
    unity = ls.controller(ls.gain(1.0), rate_hz=RATE, loop="C")
    D = ls.learning.repetitive(measured(integrator), unity, 0.05, ls.gain(1.0), requirements=INNER)
    assert (D.part("memory").delay_samples, D.part("preview").delay_samples) == (49, 1)
    r = np.tile(np.random.default_rng(1).standard_normal(50), 4)
    e = ls.diagrams.simulate(D, {"P": integrator}, {"r": r})["e"]
    np.testing.assert_allclose(e[51:], 0.0, atol=1e-12)
    assert np.abs(e[:50]).max() > 1.0


@pytest.mark.parametrize(
    ("period_s", "q_filter", "words", "way"),
    [
        (1.0 / 60.0, 50.0, "no whole number of samples", "3 periods: 0.05 s"),
        (0.0015, 50.0, "at least two samples", ""),
        (0.2, 5.0, "too many sections", "24.2 Hz or more"),
        (0.2, ls.gain(0.9), "1 at low frequency", "low-pass"),
        (0.2, ls.low_pass(25.0, order=1), "less Q's delay", "as a number"),
        (0.01, 50.0, "longer than the period", "two periods"),
        (0.2, 600.0, "below half the rate", ""),
    ],
)
def test_what_cannot_be_learned_is_refused(period_s, q_filter, words, way):
    with pytest.raises(ls.errors.WrongUseError, match=words) as told:
        ls.learning.repetitive(measured(PLANT), C, period_s, q_filter)
    assert way in str(told.value)


def test_a_preview_lies_within_the_period():
    with pytest.raises(ls.errors.WrongUseError, match="preview"):
        ls.learning.repetitive(measured(PLANT), C, 0.2, 50.0, preview=190)
