"""Linear loops whose discrete plant is known, run exactly as difference equations; for the estimators' tests.

Signals and signs as drawn in `loop.loop`: n enters at the controller's input or at the plant's input, v is
noise on the sensor. Everything may be (records, n): the last axis is time.
"""

import numpy as np
from bench_nouns import Block, LoopSetup, RecordingInfo
from conversions import TWO_PI
from scipy.signal import freqz, lfilter

import loopshape as ls
from loopshape.identify.frequency_response import estimate_frf

RATE = 100.0
# a resonance at 8 Hz that rings for 0.1 s, a slow pole, a delay of one sample: short against every segment used
A = np.poly([0.9 * np.exp(0.5j), 0.9 * np.exp(-0.5j), 0.8]).real
B = np.array([0.0, 0.05, 0.02])
CONTROLLER = ls.Controller("axis", (Block("gain", {"gain": 0.5}), Block("low_pass_1", {"f_hz": 5.0})), RATE)
LOOP = LoopSetup("axis", "r_rad", "n_rad", "z_v", "y_rad", CONTROLLER)


def plant(f_hz):
    """Response of the discrete plant, (nf,)."""
    return freqz(B, A, worN=TWO_PI * np.asarray(f_hz) / RATE)[1]


def _add(p, q):
    size = max(p.size, q.size)
    return np.pad(p, (0, size - p.size)) + np.pad(q, (0, size - q.size))


def run_loop(place, n, v):
    """z and y of the loop with n at `place` and sensor noise v; `control` drives the plant with the loop open."""
    if place == "control":
        return n + 0.0 * v, lfilter(B, A, n) + v
    D = F = np.ones(1)
    for b0, b1, b2, a1, a2 in CONTROLLER.biquads():
        D, F = np.convolve(D, [b0, b1, b2]), np.convolve(F, [1.0, a1, a2])
    ones, loop, difference = np.convolve(A, F), np.convolve(B, D), _add(np.convolve(A, F), np.convolve(B, D))
    into_controller = (0.0 if place == "plant_input" else n) - v
    z = lfilter(np.convolve(D, A), difference, into_controller)
    y = lfilter(loop, difference, into_controller) + v
    if place == "plant_input":
        z = z - lfilter(loop, difference, n)
        y = y + lfilter(np.convolve(B, F), difference, n)
    assert np.abs(np.roots(difference)).max() < 1.0
    assert ones.size == difference.size
    return z, y


def record(place, kind, n, z, y, period_s=None, from_s=None):
    """A recording of one run of the loop."""
    info = RecordingInfo(
        "r1.parquet", kind, place, excites="axis", closed_loop=place != "control",
        period_s=period_s, periodic_from_s=from_s,
    )  # fmt: skip
    moved, still = n, np.zeros(n.size)
    columns = {"z_v": z, "y_rad": y}
    if place != "control":
        columns |= {
            "r_rad": moved if place == "reference" else still,
            "n_rad": still if place == "reference" else moved,
        }
    return ls.Recording(info, RATE, columns)


def estimates(place, kind, n, v, settings=None, **period):
    """FRFs of many runs: n (n,) or (records, n), v (records, n)."""
    n = np.broadcast_to(n, v.shape)
    z, y = run_loop(place, n, v)
    return [estimate_frf(record(place, kind, *x, **period), LOOP, settings) for x in zip(n, z, y, strict=True)]


def common_lines(frfs, f_low_hz, f_high_hz):
    """Lines (nf,), responses and variances (records, nf) on the lines that all share within a band."""
    f = frfs[0].frequency_hz
    for frf in frfs[1:]:
        f = np.intersect1d(f, frf.frequency_hz)
    f = f[(f >= f_low_hz) & (f <= f_high_hz)]
    on = [frf.select(np.isin(frf.frequency_hz, f)) for frf in frfs]
    return f, np.array([x.siso for x in on]), np.array([x.variance[:, 0, 0] for x in on])
