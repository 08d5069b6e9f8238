"""One loop drawn from a seed, and whether two answers are the same: for laws of a loop alone and in a list."""

import numpy as np
import pytest
from conversions import TWO_PI

import loopshape as ls

RATE = 1000.0
F = np.geomspace(0.5, 200.0, 160)
S = 1j * TWO_PI * F
LIMITS = {"phase_margin_deg": 40.0, "sensitivity_peak_db": 6.0, "disk_margin": 0.7, "bandwidth_hz": 3.0}


def drawn(seed):
    """A lag with a resonance and delay, measured with noise; a controller; integrators and unstable poles."""
    rng = np.random.default_rng(seed)
    k, order, w = float(rng.uniform(5.0, 40.0)), int(rng.integers(0, 2)), TWO_PI * float(rng.uniform(30.0, 90.0))
    G = k / (S if order else S + 3.0) * w**2 / (S**2 + 0.1 * w * S + w**2) * np.exp(-0.002 * S)
    std = float(rng.uniform(0.002, 0.03))
    noise = rng.standard_normal((2, F.size)) / 2**0.5
    P = ls.FRF.from_arrays(F, G * (1.0 + std * (noise[0] + 1j * noise[1])), relative_std=std, rate_hz=RATE, loop="x")
    C = ls.controller(ls.gain(float(rng.uniform(0.3, 1.5))), ls.lead_lag(5.0, 40.0), rate_hz=RATE, loop="x")
    return P, C, ls.Requirements("x", **LIMITS, integrators=order, unstable_poles=0)


def same(one, other, where=""):
    """Equal to 1e-12, whatever is nested in what."""
    if isinstance(one, dict):
        assert one.keys() == other.keys(), where
        for key, value in one.items():
            same(value, other[key], f"{where}.{key}")
    elif isinstance(one, (list, tuple)):
        assert len(one) == len(other), where
        for k, pair in enumerate(zip(one, other, strict=True)):
            same(*pair, f"{where}[{k}]")
    elif isinstance(one, float):
        assert other == pytest.approx(one, rel=1e-12, abs=1e-300, nan_ok=True), where
    else:
        assert one == other, where
