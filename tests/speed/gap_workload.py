"""The diagnosis of a user's own machine for benchmarks: an axis whose friction its model lacks, 60 s at 500 Hz."""

from __future__ import annotations

import time
from typing import Any

import numba
import numpy as np

import loopshape as ls
from loopshape.data.signal.recording import Recording, RecordingInfo
from loopshape.toolbox.gap.diagnose.diagnose import diagnose
from loopshape.toolbox.gap.own.composed import Composed
from loopshape.toolbox.gap.own.plant import OwnMachine

RATE_HZ, SECONDS, INERTIA, DAMPING, FRICTION = 500.0, 20, 0.02, 0.01, 0.02


@numba.njit(error_model="numpy")
def bare(x0, u, inertia, damping, friction, h, out):  # type: ignore[no-untyped-def]
    """The axis alone, Runge-Kutta of order 4 by hand, from each x0 (windows, 2)."""
    for w in range(len(x0)):
        q, v = x0[w]
        for n in range(out.shape[1]):
            out[w, n, 0], out[w, n, 1] = q, v
            a1 = (u[n] - damping * v - friction * np.tanh(v / 0.05)) / inertia
            v2 = v + 0.5 * h * a1
            a2 = (u[n] - damping * v2 - friction * np.tanh(v2 / 0.05)) / inertia
            v3 = v + 0.5 * h * a2
            a3 = (u[n] - damping * v3 - friction * np.tanh(v3 / 0.05)) / inertia
            v4 = v + h * a3
            a4 = (u[n] - damping * v4 - friction * np.tanh(v4 / 0.05)) / inertia
            q += h / 6.0 * (v + 2.0 * (v2 + v3) + v4)
            v += h / 6.0 * (a1 + 2.0 * (a2 + a3) + a4)


def run() -> ls.Run:
    """Three recordings, one held out."""
    out, rng = [], np.random.default_rng(0)
    for k in range(3):
        u = np.repeat(rng.normal(0.0, 0.1, round(SECONDS * RATE_HZ / 10)), 10)
        moved = np.empty((1, u.size, 2))
        bare(np.zeros((1, 2)), u, INERTIA, DAMPING, FRICTION, 1.0 / RATE_HZ, moved)
        y = moved[0, :, 0] + 1e-5 * rng.standard_normal(u.size)
        info = RecordingInfo(f"r{k}.parquet", "noise", "control", role="validation" if k == 2 else "estimation")
        out.append(Recording(info, RATE_HZ, {"torque_nm": u, "angle_rad": y}))
    return ls.Run(RATE_HZ, (), tuple(out))


def seconds() -> tuple[float, float]:
    """Seconds of one core of a diagnosis, and of its simulations, as many ticks, by the axis alone."""
    own, ticks = run(), [0]
    numbers = {"inertia": INERTIA, "damping": DAMPING}
    plant = OwnMachine(ls.gap.axis(numbers, "torque_nm", "angle_rad", window_s=0.4))
    plant.residuals(plant.prepare(own.recordings[0], own, None), {})  # compiles
    kept: Any = Composed.run

    def counting(self: Composed) -> Any:
        inner = kept.func(self)

        def go(*arguments: Any) -> None:
            ticks[0] += arguments[-1].shape[0] * arguments[-1].shape[1]
            inner(*arguments)

        return go

    Composed.run = property(counting)  # type: ignore[assignment,method-assign]
    try:
        begun = time.process_time()
        diagnose(plant, own, "axis", threads=1, table=False)
        whole = time.process_time() - begun
    finally:
        Composed.run = kept  # type: ignore[method-assign]
    x0, u, out = np.zeros((100, 2)), own.recordings[0].column("torque_nm"), np.empty((100, 220, 2))
    bare(x0, u, INERTIA, DAMPING, FRICTION, 1.0 / RATE_HZ, out)
    begun = time.process_time()
    for _ in range(20):
        bare(x0, u, INERTIA, DAMPING, FRICTION, 1.0 / RATE_HZ, out)
    return whole, (time.process_time() - begun) / (20 * 100 * 220) * ticks[0]
