"""Loops under a plain gain with noise on their lines and modes between them; for the tests of the certificate."""

import numpy as np
from bench_nouns import Block, Loop, TransferFunction
from conversions import TWO_PI

import loopshape as ls
from loopshape.identify.smooth.smoothing import smoothed

RATE = 1e5
LINES = 0.1 * np.arange(1, 601)


def product(*polynomials):
    out = np.ones(1)
    for polynomial in polynomials:
        out = np.polymul(out, polynomial)
    return out


def pair(f_hz, damping):
    w = TWO_PI * f_hz
    return np.array([1.0 / w**2, 2.0 * damping / w, 1.0])


def real(f_hz, sign=1.0):
    return np.array([1.0 / (TWO_PI * f_hz), sign])


#: integrators with leads and lags that cross 0 dB near 5 Hz at a gain of 1, and are stable there
PLANTS = {
    "one integrator": TransferFunction([30.0], product([1.0, 0.0], real(15.0), real(40.0))),
    "two integrators": TransferFunction(150.0 * real(0.8), product([1.0, 0.0, 0.0], real(20.0), real(40.0))),
    "three integrators": TransferFunction(
        350.0 * product(real(0.5), real(0.7)), product([1.0, 0.0, 0.0, 0.0], real(30.0), real(40.0))
    ),
    "unstable pole": TransferFunction([6.0], product(real(1.0, -1.0), real(20.0), real(40.0))),
}


def with_mode(plant, f_hz, damping, peak):
    """The plant and beside it a mode whose peak is the real number `peak`: a negative one reaches for -1."""
    mode, slope = pair(f_hz, damping), np.array([2.0 * damping / (TWO_PI * f_hz), 0.0])
    num = np.polyadd(np.polymul(plant.num, mode), peak * np.polymul(slope, plant.den))
    return TransferFunction(num, np.polymul(plant.den, mode))


def by_roots(plant, gain=1.0):
    """Closed-loop poles in the right half plane."""
    return int(np.sum(np.roots(np.polyadd(plant.den, gain * plant.num)).real > 0.0))


def limit_gain(plant, low=1.0, high=1e3):
    """The gain at which a loop that is stable at `low` becomes unstable."""
    assert by_roots(plant, low) == 0 < by_roots(plant, high)
    while high / low > 1.0 + 1e-9:
        middle = np.sqrt(low * high)
        low, high = (low, middle) if by_roots(plant, middle) else (middle, high)
    return low


def errors(rng, size):
    """Circular errors with E|d|² = 1."""
    return (rng.standard_normal(size) + 1j * rng.standard_normal(size)) / np.sqrt(2.0)


def frf_of(f, P, std, rng=None):
    """Lines with a standard deviation sqrt E|d|² (nf,), noisy where there is a generator."""
    variance = np.broadcast_to(np.asarray(std, dtype=float) ** 2, f.shape)
    noisy = P if rng is None else P + np.sqrt(variance) * errors(rng, f.size)
    return ls.FRF(
        f, noisy[:, None, None], variance[:, None, None] + 0j, np.ones(f.size, dtype=bool), ("z_v",), ("y_rad",),
        "drawn", rate_hz=RATE,
    )  # fmt: skip


def unseen_damping(loop, residue):
    """Damping below which a resonance between lines, of a residue (nf - 1,) they do not show, could encircle -1.

    Its peak |C r|/w must be |1 + L| at least; where w is more than half a gap the lines meet its peak.
    """
    f, g, C = loop.frequency_hz, np.abs(1.0 + loop.L), np.abs(loop.C)
    width = np.maximum(C[1:], C[:-1]) * np.where(np.isfinite(residue), residue, 0.0) / np.minimum(g[1:], g[:-1])
    return np.max(np.minimum(width, 0.5 * np.diff(f)) / (0.5 * (f[1:] + f[:-1])))


def loop_of(plant, frf, gain=1.0, *, blocks=(), smooth=True):
    """The loop as a check makes it: smoothed over its lines, with these beside it."""
    controller = ls.Controller("axis", (Block("gain", {"gain": float(gain)}), *blocks), RATE)
    made, scatter = smoothed(frf) if smooth else (frf, None)
    raw = frf if smooth else None
    return Loop(made, controller, plant.integrators(), plant.unstable_poles(), raw=raw, scatter=scatter)
