"""Sequential linear programming in a trust region: the largest lowest bandwidth within all requirements.

At each point the bandwidths and the rooms of all requirements are linearised, a small linear programme gives
the step, and the step counts if the merit -(lowest ln bandwidth) + penalty (worst violation) falls and no
loop becomes unstable. Max-min problems of this kind end in corners, where such steps converge fast
(Fletcher, Practical methods of optimization, 1987, chapter 14).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.optimize import linprog

from loopshape.tune.measures import Measures, measure
from loopshape.tune.problem import Problem
from loopshape.units import Array

PENALTY = 20.0


@dataclass(frozen=True, eq=False)
class Found:
    """Where a search ended: x, its measures, steps taken, and whether it converged."""

    x: Array
    measures: Measures
    steps: int
    converged: bool

    @property
    def merit(self) -> float:
        """What the search makes small."""
        return merit(self.measures)


def merit(m: Measures) -> float:
    """-(lowest ln bandwidth) + penalty on the worst violation; infinite where a loop is unstable."""
    if not m.stable:
        return np.inf
    return float(-m.ln_bandwidth.min() + PENALTY * max(0.0, -m.worst))


def search(p: Problem, x: Array, tighten: Mapping[str, float], most: int = 150) -> Found:
    """Search from x; ends where no step of the model promises more, or after `most` steps."""
    limits = dict(tighten)
    here = measure(p, x, limits)
    radius = 0.3
    for step in range(most):
        dx, promised = _step(p, x, here, radius)
        if promised < 1e-7 * max(1.0, PENALTY):
            return Found(x, here, step, True)
        there = measure(p, x + dx, limits)
        gained = merit(here) - merit(there)
        if gained > 0.1 * promised:
            x, here = x + dx, there
            if gained > 0.6 * promised:
                radius = min(2.0 * radius, 1.0)
        else:
            radius = min(radius, float(np.abs(dx).max())) * 0.4
            if radius < 1e-6:
                return Found(x, here, step, True)
    return Found(x, here, most, False)


def _step(p: Problem, x: Array, m: Measures, radius: float) -> tuple[Array, float]:
    """Step of the linearised problem within the radius and the bounds, and the merit it promises to gain."""
    n = x.size
    points = m.ln_bandwidth.size
    cost = np.zeros(n + 2)
    cost[n], cost[n + 1] = -1.0, PENALTY
    bandwidth = np.hstack([-m.bandwidth_slopes, np.ones((points, 1)), np.zeros((points, 1))])
    room = np.hstack([-m.room_slopes, np.zeros((m.room.size, 1)), -np.ones((m.room.size, 1))])
    bounds = [(max(-radius, lo), min(radius, hi)) for lo, hi in zip(p.low - x, p.high - x, strict=True)]
    solved = linprog(
        cost,
        A_ub=np.vstack([bandwidth, room]),
        b_ub=np.concatenate([m.ln_bandwidth, m.room]),
        bounds=[*bounds, (None, None), (0.0, None)],
        method="highs",
    )
    if solved.status != 0 or solved.x is None or solved.fun is None:
        return np.zeros(n), 0.0
    promised = merit(m) - float(solved.fun)
    return np.asarray(solved.x[:n]), promised


def scaled_start(p: Problem, x: Array, tighten: Mapping[str, float]) -> Array:
    """x with the gain (where one is free) as large as all requirements allow, by halving."""
    gains = [k for k, v in enumerate(p.variables) if v.name == "gain"]
    if not gains:
        return x
    k = gains[0]
    low, high = float(p.low[k]), float(p.high[k])

    def holds(value: float) -> bool:
        trial = x.copy()
        trial[k] = value
        m = measure(p, trial, dict(tighten))
        return m.stable and m.worst >= 0.0

    grid = np.linspace(high, low, 25)
    best = next((g for g in grid if holds(g)), low)
    x = x.copy()
    x[k] = best
    return x
