"""Sequential linear programming in a trust region: the largest lowest bandwidth within all requirements.

At each point the bandwidths and the rooms of all requirements are linearised, a small linear programme gives
the step, and the step counts if the merit -(lowest ln bandwidth) + penalty (worst violation) falls and no
loop becomes unstable. Max-min problems of this kind end in corners, where such steps converge fast
(Fletcher, Practical methods of optimization, 1987, chapter 14).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import linprog

from loopshape.tune.measures import Measures, measure
from loopshape.tune.problem import Problem
from loopshape.units import Array

PENALTY = 20.0
#: a search has converged where a step promises less merit than this, or the radius is smaller than that
SETTLED, SMALLEST = 1e-6, 1e-5
START_RADIUS = 0.3


@dataclass(frozen=True, eq=False)
class Found:
    """Where a search stands: x, its measures, trust radius in ln, steps taken so far, whether it converged."""

    x: Array
    measures: Measures
    radius: float
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


def search(p: Problem, found: Found, tighten: dict[str, float], most: int) -> Found:
    """Search on from where another search ended, for at most `most` steps.

    A step that does not pay may be followed by a second one before it is given up (a watchdog, Chamberlain
    et al. 1982): along curved limits the first step alone looks bad because it cuts the corner.
    """
    x, here, radius = found.x, found.measures, found.radius
    for step in range(most):
        dx, promised = _step(p, x, here, radius)
        if promised < SETTLED:
            return Found(x, here, radius, found.steps + step, True)
        tried, there, gained = _try(p, x, here, dx, promised, radius, tighten)
        if gained > 0.0:
            x, here = tried, there
            if gained > 0.6 * promised:
                radius = min(2.0 * radius, 1.0)
        else:
            radius = 0.4 * min(radius, float(np.abs(dx).max()))
            if radius < SMALLEST:
                return Found(x, here, radius, found.steps + step, True)
    return Found(x, here, radius, found.steps + most, False)


def _try(
    p: Problem, x: Array, here: Measures, dx: Array, promised: float, radius: float, tighten: dict[str, float]
) -> tuple[Array, Measures, float]:
    """The step, or the step and a second one; with the merit gained, 0 where neither pays."""
    first = measure(p, x + dx, tighten)
    gained = merit(here) - merit(first)
    if gained > 0.1 * promised:
        return x + dx, first, gained
    if first.stable:
        again, _ = _step(p, x + dx, first, radius)
        second = measure(p, x + dx + again, tighten)
        gained = merit(here) - merit(second)
        if gained > 0.05 * promised:
            return x + dx + again, second, gained
    return x, here, 0.0


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


def scaled_start(p: Problem, x: Array, halvings: int = 6) -> Found:
    """A start from x, its gain (where one is free) about as large as all requirements allow, by halving."""
    best = Found(x, measure(p, x, {}), START_RADIUS, 0, False)
    gains = [k for k, v in enumerate(p.variables) if v.name == "gain"]
    if not gains:
        return best
    k = gains[0]
    low, high = float(p.low[k]), float(p.high[k])
    for _ in range(halvings):
        trial = x.copy()
        trial[k] = 0.5 * (low + high)
        m = measure(p, trial, {})
        holds = m.stable and m.worst >= 0.0
        low, high = (trial[k], high) if holds else (low, trial[k])
        if merit(m) < best.merit:
            best = Found(trial, m, START_RADIUS, 0, False)
    return best
