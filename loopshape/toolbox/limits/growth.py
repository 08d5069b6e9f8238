"""A structure that grows: the block that pays most is added to a tuned controller, and all is tuned on together.

A free biquad and a lead-lag are tried across the valid band, each where it does nothing yet. There it costs nothing and
its parameters' slopes tell, by the same linear programme that a step of the search solves, what they gain on the
limits that bind. The most promising places are searched, under limits as tight as the check asked so far, and what
passes is checked anew. So what is grown is never worse than what it grew from.

Blocks are also added at once under a bandwidth that is asked for as a floor. The first 0 dB crossing jumps where |L|
dips below 1, so a search for the largest bandwidth stops below an anti-resonance: every small step into it looks worse.
Asked for as |L| >= 1 up to a frequency beyond, with all limits missed as little as possible, the same search meets no
jump. What meets all is searched on for the largest objective.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import product

import numpy as np

from loopshape.core.units import Array
from loopshape.data.control.block import BlockTemplate, Free
from loopshape.data.requirement.limits_over import Mask
from loopshape.data.requirement.requirements import Requirements
from loopshape.design.problem.problem import Problem
from loopshape.design.problem.rows import Tighten
from loopshape.design.search import Goal, initial_point, search, step_within
from loopshape.design.stage import Stage, Task, closed_in, lowest_bandwidth
from loopshape.design.starts import leaps, random_starts
from loopshape.design.tighten import tighten_limits
from loopshape.loop.loop import Loop

#: places of a new block across the band, its dampings there, and the radius (ln) of the step that its gain is read from
PLACES, DAMPINGS, RADIUS = 40, (0.05, 0.2, 0.7, 1.5), 0.3
#: a block may lie so many times outside the valid band, and below so much of the rate
OUTSIDE, OF_RATE = 4.0, 0.4
#: of the most promising places so many are searched for so many steps, and so many of them to their end
FOLLOWED, FIRST, STAGE_POINTS, MOST, SETTLED = 10, 60, 4, 200, 3


def grow(task: Task, first: Stage, blocks: int, least_gain: float, seed: int, starts: int) -> list[Stage]:
    """The first stage and what grows of it: block by block, or from several at once where that ends better."""
    best = _one_by_one(task, [first], blocks, least_gain, seed, starts)
    at_once = blockwise_growth(task, first, blocks, np.random.default_rng([seed, 3])) if blocks > 1 else None
    if at_once is None:
        return best
    left = blocks - (len(at_once.asked.structure) - len(first.asked.structure))
    other = _one_by_one(task, [first, at_once], left, least_gain, seed, starts)
    return other if other[-1].rank < best[-1].rank and pays(other[-1], first, least_gain) else best


def _one_by_one(task: Task, found: list[Stage], blocks: int, least_gain: float, seed: int, starts: int) -> list[Stage]:
    """Stages and those that grow of the last, a block each."""
    for k in range(blocks):
        larger = grown(task, found[-1], least_gain, np.random.default_rng([seed, 2, k]), starts)
        if larger is None:
            break
        found = [*found, larger]
    return found


def grown(task: Task, stage: Stage, least_gain: float, rng: np.random.Generator, starts: int) -> Stage | None:
    """The stage with the block that pays most; None where none gains `least_gain` of the bandwidth."""
    best = min((_with(task, stage, one, rng, starts) for one in library(task.loops)), key=lambda one: one.rank)
    return best if pays(best, stage, least_gain) else None


def pays(larger: Stage, stage: Stage, least_gain: float) -> bool:
    """Whether a stage is better by outcome, or gains `least_gain` of the bandwidth with each block that it adds."""
    if larger.rank[:3] != stage.rank[:3]:
        return larger.rank[:3] < stage.rank[:3]
    blocks = len(larger.asked.structure) - len(stage.asked.structure)
    return larger.best.objective - stage.best.objective > blocks * np.log1p(least_gain)


def library(loops: Sequence[Loop]) -> tuple[BlockTemplate, ...]:
    """Blocks that may be added: a free biquad, which holds resonators and complex leads, and a lead-lag."""
    low = min(float(loop.frequency_hz[0]) for loop in loops) / OUTSIDE
    high = max(float(loop.frequency_hz[-1]) for loop in loops) * OUTSIDE
    band = Free(low, min(high, OF_RATE * loops[0].controller.rate_hz))
    biquad = {"f1_hz": band, "f2_hz": band, "damping1": Free(0.01, 3.0), "damping2": Free(0.02, 10.0)}
    return BlockTemplate("notch", biquad), BlockTemplate("lead_lag", {"f1_hz": band, "f2_hz": band})


def _with(task: Task, stage: Stage, template: BlockTemplate, rng: np.random.Generator, starts: int) -> Stage:
    """The best stage with one more block."""
    asked = replace(stage.asked, structure=(*stage.asked.structure, template))
    p, check_of = task.problem(stage.copies, asked)
    goal, verifier = Goal(stage.best.tighten), check_of(asked)
    initial = [search(p, initial_point(p, x, goal), goal, FIRST) for x in promising(p, stage.best.result.x, goal)]
    initial = sorted(initial, key=lambda one: goal.merit(one.measures))[:STAGE_POINTS]
    leapt, _ = leaps(p, replace(initial[0], measures=initial_point(p, initial[0].x).measures), rng, starts)
    initial.append(leapt)
    searched = sorted((search(p, one, goal, MOST) for one in initial), key=lambda one: goal.merit(one.measures))
    ends = [tighten_limits(p, one, verifier, stage.best.tighten) for one in searched[:SETTLED]]
    kind, stages = template.kind, []
    for end in sorted(ends, key=lambda one: one.rank)[:2]:
        one = Stage(stage.copies, asked, p, end, task.check(p, end), end.result.steps, kind)
        stages.append(closed_in(task, one))
    return min(stages, key=lambda one: one.rank)


def promising(p: Problem, x: Array, goal: Goal) -> list[Array]:
    """Points of a problem whose last block is new and does nothing there, those first that promise the most gain."""
    gains = []
    for place, damping in product(_places(p), DAMPINGS if p.templates[-1].kind == "notch" else (1.0,)):
        new = [place if v.name.endswith("_hz") else damping for v in p.variables[x.size :]]
        point = np.clip(np.concatenate([x, np.log(new)]), p.low, p.high)
        _, promised = step_within(p, point, initial_point(p, point, goal).measures, RADIUS, goal)
        gains.append((promised, place, damping, point))
    chosen: list[tuple[float, float, float, Array]] = []
    apart = 0.35  # two places of one block and one damping are one where they lie nearer than this (ln)
    for one in sorted(gains, key=lambda gain: -gain[0]):
        if all(one[2] != other[2] or abs(np.log(one[1] / other[1])) > apart for other in chosen):
            chosen.append(one)
    return [one[3] for one in chosen[:FOLLOWED]]


def _places(p: Problem) -> list[float]:
    """Frequencies in Hz across the band in which the last block may lie."""
    band = p.variables[-1] if p.variables[-1].name.endswith("_hz") else p.variables[-4]
    return [float(f) for f in np.geomspace(1.2 * band.low, band.high / 1.2, PLACES)]


#: floors reach to so many times the bandwidth; most biquads at once
_RUNGS, _BLOCKS = (1.3, 1.7, 2.2), 3
#: random draws under a floor, those searched for a few steps, those searched on; and steps of either
_DRAWS, _STARTS, _SEARCHED_ON, _SHORT, _LONG = 600, 24, 4, 60, 300


def blockwise_growth(task: Task, stage: Stage, blocks: int, rng: np.random.Generator) -> Stage | None:
    """The stage with so many free biquads more, up to `_BLOCKS`; None where no floor comes within reach.

    Needs an objective of bandwidth, and limits that are the same at all operating points.
    """
    if not task.requirements.objective.bandwidth or task.requirements.at:
        return None
    biquad, count = library(task.loops)[0], min(blocks, _BLOCKS)
    asked = replace(stage.asked, structure=(*stage.asked.structure, *[biquad] * count))
    p, check_of = task.problem(stage.copies, asked)
    goal, verifier = Goal(stage.best.tighten), check_of(asked)
    tops = [rung * lowest_bandwidth(stage) for rung in _RUNGS]
    initial = [x for top in tops for x in _inside(p.asked(_under_floor(asked, float(p.f[0]), top)), goal.tighten, rng)]
    searched = [search(p, initial_point(p, x, goal), goal, MOST) for x in initial]
    stages = []
    for one in sorted(searched, key=lambda one: goal.merit(one.measures))[:SETTLED]:
        end = tighten_limits(p, one, verifier, stage.best.tighten)
        added = Stage(stage.copies, asked, p, end, task.check(p, end), end.result.steps, f"{count} x {biquad.kind}")
        stages.append(closed_in(task, added))
    return min(stages, key=lambda one: one.rank, default=None)


def _under_floor(asked: Requirements, low_hz: float, top_hz: float) -> Requirements:
    """Requirements with |L| at least 1 up to a frequency."""
    return replace(asked, masks=(*asked.masks, Mask("L", ((0.5 * low_hz, 0.0), (top_hz, 0.0)), "at_least")))


def _inside(p: Problem, tighten: Tighten, rng: np.random.Generator) -> Iterator[Array]:
    """Points that meet all limits of a problem or nearly so, from random starts."""
    q, goal = p.coarse, Goal(tighten, objective=False, soft=None)
    coarse = [search(q, initial_point(q, one.x, goal), goal, _SHORT) for one in random_starts(q, rng, _DRAWS, _STARTS)]
    best = sorted(coarse, key=lambda one: goal.merit(one.measures))[:_SEARCHED_ON]
    near = 0.15  # a floor missed by more than this (ln) is out of reach
    for one in best:
        end = search(p, initial_point(p, search(q, one, goal, _LONG).x, goal), goal, _LONG)
        if goal.merit(end.measures) < near:
            yield end.x
