"""When requirements cannot be met together: what keeps them apart, how nearly they are met, and which one to relax.

The worst miss of all requirements is made as small as it gets. There a convex combination of the slopes of the rows
that miss most vanishes, but for what the parameters' bounds hold (a Fritz John point of min max; Fletcher, Practical
methods of optimization, 1987, chapter 14): no small change of the parameters helps. That is a proof nearby only; a
feasible controller far away, or of another structure, is not ruled out.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from loopshape.core.json_ready import Plain, keys
from loopshape.core.units import Array
from loopshape.data.control.controller import controller_bandwidth_hz
from loopshape.data.requirement.requirements import LIMIT_OF, Requirements
from loopshape.design.problem.measures import Measures
from loopshape.design.problem.problem import Problem, bounds_reached
from loopshape.design.problem.rows import Tighten, in_rows, required, slack_of
from loopshape.design.search import Goal, SearchResult, initial_point, search
from loopshape.design.tighten import TightenedSolution, Verifier, least_rooms, tighten_limits

#: searches for the least miss begin at this many of the race's ends, and take this many steps at most
ENDS, STEPS = 3, 150
#: what is missed by less than this (ln or rad) is met
MET = 1e-5


@dataclass(frozen=True)
class ConstraintMultiplier:
    """A requirement at an operating point that the least miss is held by; `share` is its multiplier, summing to one.

    `slack` is what is left of it there, in its unit, below zero, counted to the bad end of the 95 % interval.
    """

    quantity: str
    unit: str
    recording: str
    at_hz: float
    slack: float
    share: float


@dataclass(frozen=True)
class Relaxation:
    """One requirement relaxed, all others kept: its best reachable value, and what comes of asking for that instead.

    `reachable` is nan where no value of this one alone was found to make the rest possible. `verified` tells that a
    tuning with `reachable` in place of `required` passed its check; `bandwidth_hz` is what it reached.
    """

    quantity: str
    unit: str
    required: float
    reachable: float
    verified: bool
    bandwidth_hz: float

    @property
    def by(self) -> float:
        """How far the requirement has to give, in its unit."""
        return abs(self.reachable - self.required)


@dataclass(frozen=True)
class Shortfall(Plain):
    """Why the requirements were not met: the least worst miss, what holds it there, and what to relax.

    `miss` is the least worst miss found (ln of a ratio, or rad). `helps` is how much any change of the free parameters
    by a factor of up to 1.01 can take off it, to first order: much less than `miss` certifies that no small change
    helps. `bounds` are parameters at a bound, which may hold it too. Without a stable start all is empty.
    """

    ALSO = keys("certified")

    stable: bool
    miss: float
    helps: float
    pulls: tuple[ConstraintMultiplier, ...]
    bounds: tuple[str, ...]
    relaxations: tuple[Relaxation, ...]

    @property
    def least(self) -> Relaxation | None:
        """The least relaxation that was verified, by dB, degrees and ratios as rows count them."""
        verified = [one for one in self.relaxations if one.verified]
        return min(verified, key=lambda one: float(in_rows(one.quantity, one.required, one.by)), default=None)

    @property
    def certified(self) -> bool:
        """Whether no small change of the parameters makes the worst miss noticeably smaller."""
        return self.stable and self.helps < 0.01 * self.miss


def shortfall(
    p: Problem, settled: TightenedSolution, ends: Sequence[SearchResult], check_of: Callable[[Requirements], Verifier]
) -> tuple[TightenedSolution, Shortfall | None]:
    """The controller that misses least, and why the requirements were not met.

    None where they can be met after all, and where it is only stability, or what holes between lines may hide, that
    these data do not decide.
    """
    least = _least_miss(p, [settled.result, *ends[:ENDS]], Goal(settled.tighten, objective=False, soft=None))
    if least is None:
        return settled, Shortfall(False, float("nan"), float("nan"), (), (), ())
    goal = Goal(settled.tighten)
    if least.measures.worst >= -MET:
        again = tighten_limits(
            p, search(p, replace(least, radius=0.1), goal, 100), check_of(p.requirements), settled.tighten
        )
        if again.verdict.passed:
            return again, None
        if not any(line.slack < 0.0 and line.measure_from_hz is None for line in again.verdict.lines):
            return min([settled, again], key=lambda one: one.rank), None
    verified = TightenedSolution(least, check_of(p.requirements)(p.controller(least.x)), settled.tighten)
    pulls, helps = _certificate(p, least, settled.tighten)
    asked = dict.fromkeys(pull.quantity for pull in pulls if pull.quantity in LIMIT_OF)
    starts = [least, *ends[:ENDS]]
    relaxed = [_relaxation(p, name, starts, settled.tighten, check_of) for name in asked]
    bounds = bounds_reached(p, least.x)
    found = Shortfall(True, max(-least.measures.worst, 0.0), helps, pulls, bounds, tuple(relaxed))
    return min([settled, verified], key=lambda one: one.rank), found


def _least_miss(p: Problem, starts: Sequence[SearchResult], goal: Goal) -> SearchResult | None:
    """The end of searches where `goal` is smallest, None where no start is stable."""
    initial = [initial_point(p, found.x, goal, steps=found.steps) for found in starts]
    ends = [search(p, found, goal, STEPS) for found in initial if found.measures.stable]
    return min(ends, key=lambda found: goal.merit(found.measures), default=None)


def _certificate(p: Problem, least: SearchResult, tighten: Tighten) -> tuple[tuple[ConstraintMultiplier, ...], float]:
    """Rows that hold the worst miss where it is, with multipliers, and what a change of 1 % could take off it.

    The shortest convex combination of the rows' slopes, bounds of the parameters taken off: by duality the
    linearised worst miss falls by no more than its 1-norm for every 1 in the largest |dx|.
    """
    from scipy.optimize import nnls

    m = least.measures
    close = 2e-3  # rows whose room is this near to the least take part in the certificate (ln or rad)
    rows = np.flatnonzero(m.room <= m.worst + close)
    slopes = m.room_slopes[rows]
    walls = [-np.eye(p.low.size)[least.x - p.low < 1e-6], np.eye(p.low.size)[p.high - least.x < 1e-6]]
    columns = np.vstack([slopes, *(-wall for wall in walls)]).T
    sums = np.concatenate([np.ones(rows.size), np.zeros(columns.shape[1] - rows.size)])
    weight = 1e3 * max(float(np.abs(slopes).max(initial=0.0)), 1.0)
    shares, _ = nnls(np.vstack([columns, weight * sums]), np.append(np.zeros(p.low.size), weight))
    shares /= max(float(shares[: rows.size].sum()), 1e-300)
    left = float(np.abs(columns @ shares).sum())
    return tuple(_pulls(p, m, rows, shares[: rows.size], tighten)), 0.01 * left


def _pulls(p: Problem, m: Measures, rows: np.ndarray, shares: Array, tighten: Tighten) -> list[ConstraintMultiplier]:
    """One for each quantity and operating point, largest share first; neighbouring lines are put together."""
    found: dict[tuple[str, int], ConstraintMultiplier] = {}
    for k, share in sorted(zip(rows.tolist(), shares.tolist(), strict=True), key=lambda pair: -pair[1]):
        what, point = m.what[k], int(m.point[k])
        recording, at_hz = p.place(int(m.at[k]), point)
        if (before := found.get((what, point))) is not None:
            found[(what, point)] = replace(before, share=before.share + share)
            continue
        if share <= 1e-6:
            continue
        unit, slack = "1", float(m.room[k])
        if what in LIMIT_OF and what != "controller_bandwidth_hz":
            unit, limit = LIMIT_OF[what].unit, required(p, what, tighten)[point]
            slack = float(slack_of(what, limit, slack))
        found[(what, point)] = ConstraintMultiplier(what, unit, recording, at_hz, slack, share)
    return sorted(found.values(), key=lambda pull: -pull.share)


def _relaxation(
    p: Problem,
    name: str,
    starts: Sequence[SearchResult],
    tighten: Tighten,
    check_of: Callable[[Requirements], Verifier],
) -> Relaxation:
    """How far one requirement has to give for the others to hold, and whether a tuning with that passes."""
    limit, now = LIMIT_OF[name], _now(p, name)
    goal = Goal(tighten, objective=False, soft=frozenset([name]))
    least = _least_miss(p, starts, goal)
    reachable, verified, bandwidth_hz = float("nan"), False, float("nan")
    if least is not None and float(least.measures.room[~goal.softs(least.measures)].min(initial=0.0)) > -MET:
        by = _needed(p, name, least, tighten)
        tries = 3  # a relaxation is tried this often, each time a little larger
        for _ in range(tries):
            asked = now + (by if limit.sense == "at_most" else -by)
            if asked <= 0.0 < now:
                break
            tried = _tuned(p, p.requirements.moved({name: asked - now}), least, tighten, check_of)
            reachable, verified = asked, tried.verdict.passed
            bandwidth_hz = min(m.bandwidth_hz for m in tried.verdict.margins.values())
            slack = min((line.slack for line in tried.verdict.lines if line.quantity == name), default=0.0)
            if verified:  # what that controller leaves of this one need not be given away
                by = max(by - slack * (1.0 - 1e-9), 0.0)
                reachable = now + (by if limit.sense == "at_most" else -by)
                break
            if not np.isfinite(slack):  # nothing bounds it, whatever it gives
                break
            by = max(1.05 * by, by - 1.1 * min(slack, 0.0))
    return Relaxation(name, limit.unit, now, reachable, verified, float(bandwidth_hz))


def _now(p: Problem, name: str) -> float:
    """A limit as it is required, the strictest where it depends on the operating point."""
    return float(p.limits[name].max() if LIMIT_OF[name].sense == "at_least" else p.limits[name].min())


def _needed(p: Problem, name: str, least: SearchResult, tighten: Tighten) -> float:
    """What is missed of a quantity, in its unit, and a little more."""
    now = _now(p, name)
    if name == "controller_bandwidth_hz":
        return max(controller_bandwidth_hz(p.controller(least.x)) - now, 0.0) + 1e-3 * now
    room = least_rooms(p, least.measures)[name]
    missed = -float(np.min(slack_of(name, required(p, name, tighten), room)))
    return max(missed, 0.0) * 1.001 + 1e-5 * max(abs(now), 1e-3)


def _tuned(
    p: Problem, asked: Requirements, least: SearchResult, tighten: Tighten, check_of: Callable[[Requirements], Verifier]
) -> TightenedSolution:
    """A tuning of relaxed requirements that begins where they are just met."""
    relaxed, goal = p.asked(asked), Goal(tighten)
    found = search(relaxed, initial_point(relaxed, least.x, goal, 0.02), goal, 60)
    return tighten_limits(relaxed, found, check_of(asked), tighten)
