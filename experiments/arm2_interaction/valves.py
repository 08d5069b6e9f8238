"""What averaged valves let through, and the linear plant that a recording's own commands make of the arm.

Filling and exhaust differ, inside the dead zone nothing flows, and all in-valves hang on one throttle: pulses start
together, so valves that are open at once share its flow. All of it is of degree one in u: no amplitude is small enough
to make it linear. The gains that a recording sees are those of the best linear fit of flow on u (Bussgang 1952).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from loopshape.core.kernels.compiled import compiled
from loopshape.core.units import Array, ComplexArray, angular
from loopshape.data.signal.recording import Recording
from loopshape.data.signal.run import Run

ATMOSPHERE_BAR, PWM_S, PWM_TICKS, DEAD_ZONE = 1.01325, 0.02, 20, 0.01


@dataclass(frozen=True, eq=False)
class Valves:
    """Rates (m,) in bar/s per unit duty with one valve open; drops from the supply in bar, and flows they would drive.

    `shared` is whether all in-valves hang on one throttle, as the arm's do, or each has its own.
    """

    fill: Array
    exhaust: Array
    drop: Array
    flow: Array
    dead_zone: float = DEAD_ZONE
    shared: bool = True

    def __call__(self, u: Array) -> Array:
        """Rates (n, m) in bar/s for commands (n, m) in V."""
        out = np.empty_like(u)
        for k in range(len(u)):
            rates(u[k], self.fill, self.exhaust, self.drop, self.flow, self.dead_zone, self.shared, out[k])
        return out


def valves(fill: Array, exhaust: Array, p_bar: Sequence[float], supply_bar: float = 1.0, **rules: float) -> Valves:
    """Valves of muscles at these pressures; source: (3.16-3.34), D.11-D.23 of van den Brink, DCT 2007.002."""
    p = np.asarray(p_bar, dtype=float)
    drop = supply_bar - p
    return Valves(fill, exhaust, drop, np.sqrt((supply_bar + p + 2.0 * ATMOSPHERE_BAR) * drop), **rules)  # type: ignore[arg-type]


@compiled
def rates(
    u: Array, fill: Array, exhaust: Array, drop: Array, flow: Array, dead_zone: float, shared: bool, out: Array
) -> None:
    """Fill `out` (m,) with mean rates over a PWM period; open in-valves share the flow that the widest drop drives."""
    m = u.size
    begun = 0.0
    for k in range(m):
        size = min(abs(u[k]), 1.0) if abs(u[k]) > dead_zone else 0.0
        out[k] = -exhaust[k] * size if u[k] < 0.0 else (0.0 if shared else fill[k] * size)
    while shared:
        ends, total, widest = 2.0, 0.0, 0.0
        for k in range(m):
            if u[k] > dead_zone and min(u[k], 1.0) > begun:
                ends, total, widest = min(ends, min(u[k], 1.0)), total + drop[k], max(widest, flow[k])
        if ends > 1.0:
            break
        for k in range(m):
            if u[k] > dead_zone and min(u[k], 1.0) > begun:
                out[k] += fill[k] * (ends - begun) * widest / flow[k] * drop[k] / total
        begun = ends


def best_gains(law: Valves, u: Array) -> Array:
    """The linear gains (m, m) from u to the rates that fit best about the mean, from commands (n, m)."""
    rate = law(u)
    return np.asarray(np.linalg.lstsq(u - u.mean(axis=0), rate - rate.mean(axis=0), rcond=None)[0].T)


def mean_delays_s(u: Array) -> Array:
    """Delay (m,) of each valve: a pulse acts half its length after its period's start."""
    size = np.minimum(np.abs(u), 1.0)
    return np.asarray(0.5 * PWM_S * (size**3).mean(axis=0) / (size**2).mean(axis=0))


@dataclass(frozen=True, eq=False)
class Plant:
    """dx/dt = A x + E rates, y = C x, u = T z: what is linear of an arm."""

    dynamics: Array
    entry: Array
    outputs: Array
    decoupling: Array

    def response(self, frequency_hz: Array, gains: Array, delay_s: Array | float = 0.0) -> ComplexArray:
        """Response (nf, ny, nz) with these gains (m, m) from u to rates, each valve delayed by `delay_s` (m,)."""
        s = 1j * angular(frequency_hz)[:, None, None]
        late = np.exp(-s * np.broadcast_to(delay_s, (gains.shape[0],))[None, :, None])
        drive = self.entry @ (late * (gains @ self.decoupling))
        return np.asarray(self.outputs @ np.linalg.solve(s * np.eye(len(self.dynamics)) - self.dynamics, drive))


def replayed(
    run: Run, recordings: Sequence[Recording], excited: Sequence[str], plant: Plant, law: Valves, f: Array, u: str
) -> ComplexArray:
    """The matrix (nf, k, k) over the loops `excited` that these recordings should give by their own commands.

    Each recording's gains make a plant of all loops; closed by the run's controllers it answers to that recording's
    instruments, and P = S_P S_I^-1 is put together as the estimate is. `u` names the valves: "ab", "abcd".
    """
    names = [loop.name for loop in run.loops]
    places = [names.index(name) for name in excited]
    K = np.stack([loop.controller.response(f) for loop in run.loops if loop.controller is not None], axis=1)
    S_P, S_I, count = 0.0, 0.0, dict.fromkeys(excited, 0)
    for r in recordings:
        commands = np.stack([r.column(f"u_{m}_v")[::PWM_TICKS] for m in u], axis=1)
        P = plant.response(f, best_gains(law, commands), mean_delays_s(commands))
        inverse = np.linalg.inv(np.eye(len(names)) + K[:, :, None] * P)
        moved = [names.index(name) for name in r.info.excited]
        mask = np.isin(np.arange(len(names)), moved)[None, None, :]
        S_I = S_I + inverse * mask
        S_P = S_P + P @ inverse * mask
        for name in r.info.excited:
            count[name] += 1
    each = np.array([count[name] for name in excited], dtype=float)
    S_I, S_P = (x[:, places][:, :, places] / each for x in (S_I, S_P))
    return np.asarray(S_P @ np.linalg.inv(S_I))


def with_closed(P: ComplexArray, run: Run, kept: Sequence[str], f: Array) -> ComplexArray:
    """Over the loops `kept` (nf, k, k) of a plant (nf, n, n) over all, the others closed by the run's controllers."""
    names = [loop.name for loop in run.loops]
    a = [names.index(name) for name in kept]
    b = [k for k in range(len(names)) if k not in a]
    K = np.stack([run.loop(names[k]).controller.response(f) for k in b], axis=1)[:, :, None] if b else None  # type: ignore[union-attr]
    if K is None:
        return P[:, a][:, :, a]
    inner = np.linalg.solve(np.eye(len(b)) + K * P[:, b][:, :, b], K * P[:, b][:, :, a])
    return np.asarray(P[:, a][:, :, a] - P[:, a][:, :, b] @ inner)
