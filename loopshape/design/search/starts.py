"""Where searches begin, and which of them go on: random starts, a race, and leaps from the best."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from loopshape.core.units import Array
from loopshape.design.problem.problem import Problem
from loopshape.design.search.glance import glanced, scaled_start
from loopshape.design.search.search import LARGEST, Found, begin, search

#: steps that a search is given in the race's three heats, and after a leap; a leap that comes this near goes on
HEATS, LEAP, NEAR = (15, 40, 60), 15, 0.05
#: most steps of the last search, and its trust radius to begin with where the lines are others
MOST, ON = 300, 0.1
#: random starts are drawn anew up to so many times, until this many of them are stable
AGAIN, FEWEST = 12, 4
#: searches of a race end where a step promises less merit than this; a leap that gains less than that did not pay
ROUGH, PAYS, FEWEST_LEAPS = 1e-5, 1e-3, 6


def random_starts(p: Problem, rng: np.random.Generator, draws: int, keep: int) -> list[Found]:
    """The best of random starts and the user's own, each with its gain as large as allowed.

    An unstable plant needs a controller within a few octaves of the right one, and most draws are unstable: then more
    are drawn.
    """
    middle = 0.5 * (p.low + p.high)
    own = np.array([m if v.start is None else np.log(v.start) for v, m in zip(p.variables, middle, strict=True)])
    found = _best(p, [own, *_drawn(p, rng, draws)], keep)
    for _ in range(AGAIN):
        if sum(one.measures.stable for one in found) >= min(FEWEST, keep):
            break
        found = sorted([*found, *_best(p, _drawn(p, rng, draws), keep)], key=lambda one: one.merit)[:keep]
    return found


def _drawn(p: Problem, rng: np.random.Generator, draws: int) -> list[Array]:
    """Random x within the bounds."""
    return [p.low + rng.random(p.low.size) * (p.high - p.low) for _ in range(draws)]


def _best(p: Problem, trials: Sequence[Array], keep: int) -> list[Found]:
    """The best of starts from some x."""
    q = glanced(p)
    seen = sorted((scaled_start(p, q, x) for x in trials), key=lambda sight: sight.merit)[:keep]
    return sorted((begin(p, sight.x) for sight in seen), key=lambda found: found.merit)


def race(
    p: Problem, candidates: Sequence[Found], rng: np.random.Generator, also: Sequence[Found] = ()
) -> tuple[list[Found], int]:
    """The best of several searches, best first, dropping those that lag; with the steps taken in all.

    Between the heats and the last search the best leaps: one block after the other is drawn anew, because the
    local optima that searches end in differ by what a block is used for. Searches from `also`, optima of smaller
    structures, join after the heats: they would win every heat.
    """
    dropped, count = 0, len(candidates)
    running = list(candidates)
    for keep, most in zip((count, max(3, count // 3), 2), HEATS, strict=True):
        dropped += sum(found.steps for found in running[keep:])
        running = sorted((search(p, one, LARGEST, most, ROUGH) for one in running[:keep]), key=lambda one: one.merit)
    joined = (search(p, found, LARGEST, HEATS[-1], ROUGH) for found in also)
    running = sorted([*running, *joined], key=lambda one: one.merit)
    best, steps = leaps(p, running[0], rng, count if count > 1 else 0)
    steps += dropped + sum(found.steps for found in running)
    last = search(p, best, LARGEST, MOST)
    return [last, *(found for found in running if found is not best)], steps + last.steps - best.steps


def polished(p: Problem, end: Found) -> Found:
    """The end of a race on coarse lines, searched on, on all of them."""
    found = end if end.measures.evaluation.p is p else begin(p, end.x, radius=ON, steps=end.steps)
    return search(p, found, LARGEST, MOST)


def leaps(p: Problem, best: Found, rng: np.random.Generator, count: int) -> tuple[Found, int]:
    """The best after at most `count` leaps, each to the best of four draws of one block; with the steps taken.

    They end after two rounds of all blocks, six leaps at least, in which none paid.
    """
    blocks = sorted({v.block for v in p.variables if v.name != "gain"})
    steps, q, idle = 0, glanced(p), 0
    for k in range(count if blocks else 0):
        mine = np.array([v.block == blocks[k % len(blocks)] for v in p.variables])
        draws = [np.where(mine, p.low + rng.random(mine.size) * (p.high - p.low), best.x) for _ in range(4)]
        seen = min((scaled_start(p, q, x, 5) for x in draws), key=lambda sight: sight.merit)
        found = search(p, begin(p, seen.x), LARGEST, LEAP, ROUGH)
        if found.merit < best.merit + NEAR:
            found = search(p, found, LARGEST, HEATS[-1], ROUGH)
        steps += found.steps
        idle = 0 if found.merit < best.merit - PAYS else idle + 1
        if found.merit < best.merit:
            best = found
        if idle >= max(2 * len(blocks), FEWEST_LEAPS):
            break
    return best, steps
