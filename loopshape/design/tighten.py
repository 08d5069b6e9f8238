"""From what the tuner reads to what `check` reads: limits tightened by what confidence and finer reading ask for."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from loopshape.core.outcomes import ClosedLoop
from loopshape.core.units import Array
from loopshape.data.control.controller import Controller
from loopshape.data.requirement.requirements import LIMIT_OF
from loopshape.data.result.verdict import Verdict
from loopshape.design.problem.measures import Measures, measure
from loopshape.design.problem.problem import Problem
from loopshape.design.problem.rows import DIP, SURE, Tighten, in_rows, required, slack_of
from loopshape.design.search import Goal, SearchResult, initial_point, search


class Verifier(Protocol):
    """What holds a controller against all requirements and has the last word."""

    def __call__(self, controller: Controller, points: Sequence[int] | None = None) -> Verdict:
        """The verdict at all operating points, or at some."""
        ...


#: limits with less room than this (ln or rad), and bandwidths so near the lowest, are asked about before all others
WATCHED = 0.1
#: limits with less room than this bind; those points alone are asked about so many times between two rounds of all
CLOSE, CLOSER = 0.002, 2
#: rounds of checking and searching on at most; from this one on limits are never loosened again
ROUNDS, FIRM = 8, 3
#: a result is settled where the limits that bind were tightened by no more than this (ln or rad) beyond what was needed
WASTE = 0.003
#: a crossing that the check reads lower by so much (ln) comes from a dip of |L|, which is kept farther from 1 by so
#: much (ln) a round
DIPPED, HIGHER = 0.05, 0.1


@dataclass(frozen=True, eq=False)
class TightenedSolution:
    """A search's end, `check`'s verdict on it, and the tightening under which it was searched."""

    result: SearchResult
    verdict: Verdict
    tighten: Tighten

    @property
    def rank(self) -> tuple[int, float, float]:
        """What makes one better than another, smallest first: outcome, worst miss of a limit, -(objective)."""
        outcome = self.verdict.outcome.severity + (ClosedLoop.UNSTABLE in self.verdict.stabilities)
        return outcome, round(0.0 if outcome == 0 else miss(self.verdict), 4), -self.objective

    @property
    def objective(self) -> float:
        """The objective with the bandwidth that the check reads where that is less, and the norm where it is more."""
        m = self.result.measures
        read, aim = bandwidths(self.verdict), m.evaluation.p.requirements.objective
        known = aim.bandwidth and np.isfinite(read).any()
        less = float(np.log(np.nanmin(read)) - m.ln_bandwidth.min()) if known else 0.0
        more = float(np.log(norm(self.verdict)[0]) + m.smallness.min()) if aim.weighted_norm else 0.0
        return m.objective() + aim.bandwidth * min(less, 0.0) - aim.weighted_norm * max(more, 0.0)

    @property
    def dipped(self) -> np.ndarray:
        """Operating points (points,) whose first 0 dB crossing the check reads well below the tuner: |L| dips to 1."""
        m = self.result.measures
        if not m.evaluation.p.requirements.objective.bandwidth:
            return np.zeros(m.ln_bandwidth.size, dtype=bool)
        return np.asarray(np.log(bandwidths(self.verdict)) < m.ln_bandwidth - DIPPED)


def bandwidths(verdict: Verdict) -> Array:
    """First 0 dB crossings (points,) in Hz; nan where there is none."""
    read = np.array([m.bandwidth_hz for m in verdict.margins.values()])
    return np.where((read > 0.0) & np.isfinite(read), read, np.nan)


def norm(verdict: Verdict) -> tuple[float, tuple[float, float] | None]:
    """Largest norm of the weighted loop over the operating points, and its interval: from their largest low end to
    their largest high end. None where no covariance is known.
    """
    every = list(verdict.margins.values())
    ends = [ends for m in every if (ends := m["weighted_norm"].interval) is not None]
    interval = (max(low for low, _ in ends), max(high for _, high in ends)) if len(ends) == len(every) else None
    return max(m.weighted_norm for m in every), interval


def miss(verdict: Verdict) -> float:
    """Worst miss of a verdict's lines, as rows count it."""
    misses = [
        abs(float(in_rows(line.quantity, line.required, line.slack))) for line in verdict.lines if line.slack < 0.0
    ]
    return max(misses, default=0.0)


def tighten_limits(
    p: Problem, best: SearchResult, verifier: Verifier, tighten: Tighten | None = None
) -> TightenedSolution:
    """The best that passes `verifier`, whose word is final: its readings are finer, and count to the bad end of their
    95 % intervals.

    Each round asks it how much less slack than the tuner it sees, for each quantity at each operating point, tightens
    the limits by that and searches on. What is asked changes little with x, so a few rounds do. `tighten` is that under
    which `best` was found.
    """
    if tighten is None:
        best, tighten = _foreseen(p, best, verifier)
    tried: list[TightenedSolution] = []
    for k in range(ROUNDS):
        tried.append(TightenedSolution(best, verifier(p.controller(best.x)), tighten))
        asked = allowances(p, best.x, tried[-1].verdict)
        if _done(tried[-1], asked, k) or (len(tried) > 1 and np.array_equal(best.x, tried[-2].result.x)):
            break
        tighten = _tightened(p, tighten, asked, tried[-1], firm=k >= FIRM)
        best, tighten = _nearer(p, _searched_on(p, best, tighten), tighten, verifier, firm=k >= FIRM)
    return min(tried, key=lambda one: one.rank)


def _foreseen(p: Problem, best: SearchResult, verifier: Verifier) -> tuple[SearchResult, Tighten]:
    """The search taken on by what `verifier` asks for at the operating points that bind, where these are a minority.

    The others, which have room, are then read once, at the end.
    """
    m = best.measures
    binding = np.flatnonzero((_rooms(p, m) < WATCHED) | (m.ln_bandwidth < m.ln_bandwidth.min() + WATCHED))
    if 2 * binding.size > p.points or not m.stable:
        return best, {}
    verdict = verifier(p.controller(best.x), binding.tolist())
    asked = allowances(p, best.x, verdict, binding)
    tighten = {name: _a_little_more(p, name, needed, needed) for name, needed in asked.items()}
    return _searched_on(p, best, tighten), tighten


def _nearer(
    p: Problem, best: SearchResult, tighten: Tighten, verifier: Verifier, *, firm: bool
) -> tuple[SearchResult, Tighten]:
    """The search continued with what `verifier` asks for at the operating points that bind, where these are a minority.

    What it asks changes with x, and there it counts: so fewer rounds read all points. `firm` as in `_tightened`.
    """
    # what those points ask changes a little from one search to the next: so much of it is given on top
    steady = 0.05
    for _ in range(CLOSER):
        binding = np.flatnonzero(_rooms(p, best.measures) < CLOSE)
        if not 0 < 2 * binding.size <= p.points or not best.measures.stable:
            break
        asked = allowances(p, best.x, verifier(p.controller(best.x), binding.tolist()), binding)
        given = {name: np.broadcast_to(np.asarray(tighten.get(name, 0.0)), p.points) for name in asked}
        if all(np.all(needed <= given[name]) for name, needed in asked.items()):
            break
        there = np.isin(np.arange(p.points), binding)
        rises = {name: np.maximum(needed - given[name], 0.0) for name, needed in asked.items()}
        more = {name: _a_little_more(p, name, asked[name], rise) + steady * asked[name] for name, rise in rises.items()}
        if firm:
            more = {name: np.maximum(given[name], own) for name, own in more.items()}
        tighten = {**tighten, **{name: np.where(there, own, given[name]) for name, own in more.items()}}
        best = _searched_on(p, best, tighten)
    return best, tighten


def _searched_on(p: Problem, best: SearchResult, tighten: Tighten) -> SearchResult:
    """The search taken on from where it ended, under limits tightened otherwise."""
    goal = Goal(tighten)
    return search(p, initial_point(p, best.x, goal, 0.05, best.steps), goal, 60)


def _rooms(p: Problem, m: Measures) -> Array:
    """Least room at each operating point (points,) on its lines: above the last ones tuner and check read alike."""
    room = np.full(p.points, np.inf)
    seen = (m.point >= 0) & (m.at < p.f.size)
    np.minimum.at(room, m.point[seen], m.room[seen])
    return room


def _a_little_more(p: Problem, name: str, needed: Array, rise: Array) -> Array:
    """What is needed of a tightening, and a fifth of what it rose by."""
    return np.asarray(needed + 0.2 * rise + 1e-6 * np.maximum(np.abs(p.limits[name]), 1e-3))


def allowances(p: Problem, x: Array, verdict: Verdict, points: np.ndarray | None = None) -> dict[str, Array]:
    """How much less slack than the tuner `check` sees, by quantity, at each operating point (points,), in its unit.

    To the bad end of the interval; zero where the tuner was too careful, where either sees no crossing, and where the
    verdict, of some `points`, says nothing.
    """
    read = slacks(p, measure(p, x, {}))
    out = {}
    for name, mine in read.items():
        sign = LIMIT_OF[name].sign
        ends = [m[name].ends for m in verdict.margins.values()]
        bad = np.full(p.points, np.nan)
        bad[slice(None) if points is None else points] = [low if sign > 0.0 else high for low, high in ends]
        with np.errstate(invalid="ignore"):
            gap = mine - sign * (bad - p.limits[name])
        out[name] = np.where(np.isfinite(gap), np.maximum(gap, 0.0), 0.0)
    return out


def slacks(p: Problem, m: Measures) -> dict[str, Array]:
    """Least slack of each quantity at each operating point (points,), in its unit; +inf where no row speaks of it.

    `m` is measured without tightening.
    """
    with np.errstate(over="ignore"):
        return {name: slack_of(name, required(p, name, {}), room) for name, room in least_rooms(p, m).items()}


def least_rooms(p: Problem, m: Measures) -> dict[str, Array]:
    """Least room of each quantity that `check` reads at each operating point (points,), +inf where there is no row."""
    out: dict[str, Array] = {}
    for r in m.rows:
        if r.what not in (SURE, DIP, "controller_bandwidth_hz"):
            np.minimum.at(out.setdefault(r.what, np.full(p.points, np.inf)), r.point, r.value)
    return out


def _done(now: TightenedSolution, asked: Mapping[str, Array], k: int) -> bool:
    """Whether it passes and little was wasted, or cannot pass although the tightening is about right."""
    m, waste = now.result.measures, 0.0
    p = m.evaluation.p
    for name, room in least_rooms(p, m).items():
        off = np.abs(in_rows(name, required(p, name, {}), np.asarray(now.tighten.get(name, 0.0)) - asked[name]))
        waste = max(waste, float(off[room < 2.0 * WASTE].max(initial=0.0)))
    if now.verdict.passed:
        return waste < WASTE and not now.dipped.any()
    return k >= 2 and m.worst < -1e-3 and waste < WASTE


def _tightened(
    p: Problem, before: Tighten, asked: Mapping[str, Array], now: TightenedSolution, *, firm: bool
) -> dict[str, float | Array]:
    """The next tightening: what was asked, and a fifth of what it rose by; `firm` never less than before."""
    out: dict[str, float | Array] = {}
    verdict = now.verdict
    for name, needed in asked.items():
        given = np.broadcast_to(np.asarray(before.get(name, 0.0), dtype=float), p.points)
        rise = np.maximum(needed - given, 0.0)
        next_one = _a_little_more(p, name, needed, rise)
        out[name] = np.maximum(given, next_one + 0.3 * rise) if firm else next_one
    lines = {line.quantity: line.slack for line in verdict.lines}
    name, aim = "controller_bandwidth_hz", p.requirements.controller_bandwidth_hz
    if aim is not None:  # of C alone, without an interval, and between lines read a little otherwise
        missed = -lines[name] / aim if lines[name] < 0.0 else 0.0
        out[name] = float(np.max(before.get(name, 0.0))) + (2.0 * missed + 1e-5 if missed else 0.0)
    unsure = np.array([m.stable is not ClosedLoop.STABLE for m in verdict.margins.values()])
    sure, dip = (np.broadcast_to(np.asarray(before.get(name, 0.0), dtype=float), p.points) for name in (SURE, DIP))
    surer = 0.15  # where stability is not decided, L is kept farther from -1 by this much (ln) a round
    return out | {SURE: sure + surer * unsure, DIP: dip + HIGHER * now.dipped}
