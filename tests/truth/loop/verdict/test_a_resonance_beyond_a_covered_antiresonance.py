"""Noise covers an antiresonance; the resonance beside it, known to 2 %, lies outside the valid band, and is read.

The truth is the closed loop of the formula: |S| on 200,000 frequencies, and stability by how often 1 + L turns about 0.
"""

import numpy as np
import pytest

import loopshape as ls

F, RATE_HZ = np.arange(1.0, 400.0, 0.5), 1000.0
R = ls.Requirements(sensitivity_peak_db=6.0, unstable_poles=0, integrators=1)


def plant(f_hz):
    """Two masses on a spring (integrator, lag, antiresonance at 48 Hz, resonance at 57 Hz) behind a delay."""
    s, w = 2j * np.pi * f_hz, 2.0 * np.pi
    pair = [(s**2 + 2.0 * 0.004 * w * f * s + (w * f) ** 2) / (w * f) ** 2 for f in (47.8, 56.9)]
    return 1.0 / (s * (1.7 * s + 1.05)) * pair[0] / pair[1] * np.exp(-0.002 * s)


def controller(cross_hz):
    gain = (2.0 * np.pi * cross_hz) ** 2 * 1.7
    return ls.controller(ls.gain(gain / 3.0), ls.lead_lag(cross_hz / 3.0, 3.0 * cross_hz), rate_hz=RATE_HZ)


def truth(C):
    f = np.geomspace(1e-3, 499.0, 200_000)
    L = plant(f) * C.response(f)
    turned = np.unwrap(np.angle(1.0 + L))
    stable = abs(turned[-1] - turned[0] - 0.5 * np.pi) < 0.3  # from one integrator's -90 deg to 0
    return 20.0 * np.log10(1.0 / np.abs(1.0 + L).min()), stable


@pytest.mark.parametrize("seed", [0, 1, 2])
@pytest.mark.parametrize("cross_hz", [2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0])
def test_a_verdict_is_that_of_the_formula(cross_hz, seed):
    rng, C = np.random.default_rng(seed), controller(cross_hz)
    std = 3.2e-6
    noise = std / np.sqrt(2.0) * (rng.standard_normal(F.size) + 1j * rng.standard_normal(F.size))
    P = ls.FRF.from_arrays(F, plant(F) + noise, std=np.full(F.size, std), rate_hz=RATE_HZ)
    peak_db, stable = truth(C)
    verdict = ls.check(P, C, R)
    (one,) = verdict.margins.values()
    assert np.median(P.relative_std[(F > 40.0) & (F < 52.0), 0, 0]) > 0.3
    assert stable or verdict.outcome == "failed"
    if stable:
        low, high = one["sensitivity_peak_db"].interval
        assert low - 0.3 < peak_db < high + 0.3
        assert verdict.outcome == ("passed" if high < 6.0 else "failed" if low > 6.0 else "undecided")
