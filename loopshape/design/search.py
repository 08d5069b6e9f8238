"""Sequential linear programming in a trust region: the largest objective within all requirements.

At each point the objective's terms and the rooms of all requirements are linearised, a small linear programme gives
the step, and the step counts if the merit -(objective) + penalty (worst violation) falls and no loop becomes
unstable. Max-min problems of this kind end in corners, where such steps converge fast (Fletcher, Practical methods
of optimization, 1987, chapter 14). Other goals leave the objective out and make violations small instead.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from loopshape.core.kernels.loops.small_lp import OPTIMAL, Rooms, Terms, boxed_lp, linearised
from loopshape.core.units import Array
from loopshape.design.problem.measures import Measures, measure
from loopshape.design.problem.problem import Problem
from loopshape.design.problem.rows import Tighten

PENALTY = 20.0
#: a search has converged where a step promises less merit than this, or the radius is smaller than that
SETTLED, SMALLEST = 1e-6, 1e-5
RADIUS_0 = 0.3


@dataclass(frozen=True, eq=False)
class Goal:
    """What a search makes small: -(the objective) where it counts, the worst miss of the `soft` quantities at weight
    one (None: of all), and of all others at a penalty. `tighten` moves limits inward."""

    tighten: Tighten = field(default_factory=dict)
    objective: bool = True
    soft: frozenset[str] | None = frozenset()

    def terms(self, m: Measures) -> list[tuple[float, Array, Array]]:
        """Weight, values (k,) and slopes (k, n) of the objective's terms that count: each is its least value."""
        aim, found = m.evaluation.p.requirements.objective, []
        if self.objective and aim.bandwidth:
            found.append((aim.bandwidth, m.ln_bandwidth, m.bandwidth_slopes))
        if self.objective and aim.disturbance:
            found.append((aim.disturbance, m.rejection, m.rejection_slopes))
        if self.objective and aim.weighted_norm:
            found.append((aim.weighted_norm, m.smallness, m.smallness_slopes))
        return found

    def softs(self, m: Measures) -> np.ndarray:
        """Which rows are of soft quantities."""
        if self.soft is not None and not self.soft:
            return np.zeros(m.room.size, dtype=bool)
        flags = [np.full(r.value.size, self.soft is None or r.what in self.soft) for r in m.rows]
        return np.concatenate([np.zeros(0, dtype=bool), *flags])

    def merit(self, m: Measures) -> float:
        """What is made small; infinite where a loop is unstable."""
        return self.bare_merit(m) if m.stable else np.inf

    def bare_merit(self, m: Measures) -> float:
        """The merit as if every loop were stable."""
        own = -m.objective() if self.objective else 0.0
        if self.soft is not None and not self.soft:
            return own + PENALTY * max(-m.worst, 0.0)
        soft = self.softs(m)
        missed = [float(np.max(-m.room[rows], initial=0.0)) for rows in (soft, ~soft)]
        return own + missed[0] + PENALTY * missed[1]


#: the largest objective within all requirements
LARGEST = Goal()


@dataclass(frozen=True, eq=False)
class SearchResult:
    """Where a search stands: x, its measures, trust radius in ln, steps taken so far, whether it converged."""

    x: Array
    measures: Measures
    radius: float
    steps: int
    converged: bool

    @property
    def merit(self) -> float:
        """-(objective) + penalty (worst violation)."""
        return LARGEST.merit(self.measures)


def initial_point(p: Problem, x: Array, goal: Goal = LARGEST, radius: float = RADIUS_0, steps: int = 0) -> SearchResult:
    """The search result at x before the first step."""
    return SearchResult(x, measure(p, x, goal.tighten), radius, steps, False)


def search(p: Problem, found: SearchResult, goal: Goal, most: int, settled: float = SETTLED) -> SearchResult:
    """Search on from where another search ended, for at most `most` steps, until one promises less than `settled`.

    A step that does not pay may be followed by a second one before it is given up (a watchdog, Chamberlain
    et al. 1982): along curved limits the first step alone looks bad because it cuts the corner.
    """
    x, here, radius = found.x, found.measures, found.radius
    for step in range(most):
        dx, promised = step_within(p, x, here, radius, goal)
        if promised < settled:
            return SearchResult(x, here, radius, found.steps + step, True)
        tried, there, gained = _try(p, x, here, dx, promised, radius, goal)
        if gained > 0.0:
            x, here = tried, there
            if gained > 0.6 * promised:
                radius = min(2.0 * radius, 1.0)
        else:
            radius = 0.4 * min(radius, float(np.abs(dx).max()))
            if radius < SMALLEST:
                return SearchResult(x, here, radius, found.steps + step, True)
    return SearchResult(x, here, radius, found.steps + most, False)


def _try(
    p: Problem, x: Array, here: Measures, dx: Array, promised: float, radius: float, goal: Goal
) -> tuple[Array, Measures, float]:
    """The step, or the step and a second one; with the merit gained, 0 where neither pays."""
    first = measure(p, x + dx, goal.tighten)
    gained = _gain(goal, here, first, 0.1 * promised)
    if gained > 0.1 * promised:
        return x + dx, first, gained
    if first.stable:
        again, _ = step_within(p, x + dx, first, radius, goal)
        second = measure(p, x + dx + again, goal.tighten)
        gained = _gain(goal, here, second, 0.05 * promised)
        if gained > 0.05 * promised:
            return x + dx + again, second, gained
    return x, here, 0.0


def _gain(goal: Goal, here: Measures, there: Measures, least: float) -> float:
    """Merit gained; the count of encirclements, which is dear, is only asked of a gain that would count."""
    gained = goal.merit(here) - goal.bare_merit(there)
    return -np.inf if gained > least and not there.stable else gained


def step_within(p: Problem, x: Array, m: Measures, radius: float, goal: Goal) -> tuple[Array, float]:
    """Step of the linearised problem within the radius and the bounds, and the merit it promises to gain."""
    low, high = np.maximum(p.low - x, -radius), np.minimum(p.high - x, radius)
    made = linear(m, goal, low, high)
    y, _, outcome = boxed_lp(*made)
    if outcome != OPTIMAL:
        return np.zeros(x.size), 0.0
    return y[: x.size], goal.merit(m) - float(made[0] @ y)


def linear(m: Measures, goal: Goal, low: Array, high: Array) -> tuple[Array, Array, Array, Array, Array]:
    """The linearised problem in y = (dx, the objective's terms, soft miss, hard miss), as `boxed_lp` takes it."""
    terms = goal.terms(m)
    term = np.repeat(np.arange(len(terms)), [value.size for _, value, _ in terms])
    values = np.concatenate([np.zeros(0), *(value for _, value, _ in terms)])
    slopes = np.concatenate([np.zeros((0, low.size)), *(slopes for *_, slopes in terms)])
    weights = np.array([weight for weight, *_ in terms], dtype=float)
    rooms = Rooms(m.room, m.room_slopes, goal.softs(m))
    return linearised(Terms(values, slopes, term, weights), rooms, low, high, PENALTY)
