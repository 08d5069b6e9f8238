"""Blocks added at once under a bandwidth that is asked for as a floor, where climbing stops at a dip of |L|.

The first 0 dB crossing jumps where |L| dips below 1, so a search for the largest bandwidth stops below an
anti-resonance: every small step into it looks worse. Asked for as |L| >= 1 up to a frequency beyond, with all limits
missed as little as possible, the same search meets no jump. What meets all is searched on for the largest objective.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from loopshape.core.units import Array
from loopshape.data.requirement.limits_over import Mask
from loopshape.data.requirement.requirements import Requirements
from loopshape.design.growth import MOST, SETTLED, Stage, Task, closed_in, library, lowest_bandwidth
from loopshape.design.problem.problem import Problem
from loopshape.design.problem.rows import Tighten
from loopshape.design.search.search import Goal, begin, search
from loopshape.design.search.starts import random_starts
from loopshape.design.settle import settle

#: floors reach to so many times the bandwidth; most biquads at once
RUNGS, BLOCKS = (1.3, 1.7, 2.2), 3
#: random draws under a floor, those searched for a few steps, those searched on; and steps of either
DRAWS, STARTS, KEPT, FIRST, MORE = 600, 24, 4, 60, 300
#: a floor missed by more than this (ln) is out of reach
NEAR = 0.15


def lifted(task: Task, stage: Stage, blocks: int, rng: np.random.Generator) -> Stage | None:
    """The stage with so many free biquads more, up to `BLOCKS`; None where no floor comes within reach.

    Needs an objective of bandwidth, and limits that are the same at all operating points.
    """
    if not task.requirements.objective.bandwidth or task.requirements.at:
        return None
    biquad, count = library(task.loops)[0], min(blocks, BLOCKS)
    asked = replace(stage.asked, structure=(*stage.asked.structure, *[biquad] * count))
    p, judge_of = task.problem(stage.copies, asked)
    goal, judge = Goal(stage.best.tighten), judge_of(asked)
    tops = [rung * lowest_bandwidth(stage) for rung in RUNGS]
    begun = [x for top in tops for x in met(p.asked(under_floor(asked, float(p.f[0]), top)), goal.tighten, rng)]
    searched = sorted(
        (search(p, begin(p, x, goal), goal, MOST) for x in begun), key=lambda one: goal.merit(one.measures)
    )
    stages = []
    for one in searched[:SETTLED]:
        end = settle(p, one, judge, stage.best.tighten)
        added = Stage(stage.copies, asked, p, end, task.check(p, end), end.found.steps, f"{count} x {biquad.kind}")
        stages.append(closed_in(task, added))
    return min(stages, key=lambda one: one.rank, default=None)


def under_floor(asked: Requirements, low_hz: float, top_hz: float) -> Requirements:
    """Requirements with |L| at least 1 up to a frequency."""
    return replace(asked, masks=(*asked.masks, Mask("L", ((0.5 * low_hz, 0.0), (top_hz, 0.0)), "at_least")))


def met(p: Problem, tighten: Tighten, rng: np.random.Generator) -> Iterator[Array]:
    """Points that meet all limits of a problem or nearly so, from random starts."""
    q, goal = p.coarse, Goal(tighten, objective=False, soft=None)
    rough = [search(q, begin(q, one.x, goal), goal, FIRST) for one in random_starts(q, rng, DRAWS, STARTS)]
    best = sorted(rough, key=lambda one: goal.merit(one.measures))[:KEPT]
    for one in best:
        end = search(p, begin(p, search(q, one, goal, MORE).x, goal), goal, MORE)
        if goal.merit(end.measures) < NEAR:
            yield end.x
