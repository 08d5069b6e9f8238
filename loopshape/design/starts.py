"""Where searches begin, and which of them go on: random starts, a race, and leaps from the best."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from loopshape.core.units import Array
from loopshape.design.evaluation import Evaluation
from loopshape.design.problem import Problem
from loopshape.design.search import LARGEST, Found, begin, search

#: steps that a search is given in the race's three heats, and after a leap; a leap that comes this near goes on
HEATS, LEAP, NEAR = (15, 40, 60), 15, 0.05
#: most steps of the last search
MOST = 300
#: random starts are drawn anew up to so many times, until this many of them are stable
AGAIN, FEWEST = 12, 4
#: at most so many ranges of the gain between passages of -1, the widest ones, are tried for a stable start
RANGES = 8


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
    return sorted((scaled_start(p, x) for x in trials), key=lambda found: found.merit)[:keep]


def scaled_start(p: Problem, x: Array, halvings: int = 6) -> Found:
    """A start from x, its first free gain (where there is one) about as large as all requirements allow, by halving.

    Where halving meets no stable loop the gain may have to be larger: an unstable plant needs a least gain.
    """
    best = begin(p, x)
    k = next((k for k, v in enumerate(p.variables) if v.name == "gain"), None)
    if k is None:
        return best
    low, high = float(p.low[k]), float(p.high[k])
    for _ in range(halvings):
        trial = x.copy()
        trial[k] = 0.5 * (low + high)
        found = begin(p, trial)
        holds = found.measures.worst >= 0.0 and found.measures.stable
        low, high = (trial[k], high) if holds else (low, trial[k])
        if LARGEST.bare_merit(found.measures) < best.merit and found.measures.stable:
            best = found
    return best if best.measures.stable else min([best, *_between_passages(p, x, k)], key=lambda one: one.merit)


def _between_passages(p: Problem, x: Array, k: int) -> list[Found]:
    """Stable starts from x with its gain, variable k, in the middle of each range in which no L passes -1.

    A gain moves every passage of the negative real axis alike, and within such a range the count does not change.
    """
    e = Evaluation(p, x)
    at = e.axis[e.L.real[e.axis] < 0.0]
    passes = x[k] - e.ln_L[np.concatenate([at, p.first[:-1]])]  # ln of the gain at which each lies at -1
    edges = np.unique(np.clip([p.low[k], *passes, p.high[k]], p.low[k], p.high[k]))
    widest = np.argsort(edges[:-1] - edges[1:], kind="stable")[:RANGES]
    trials = [np.where(np.arange(x.size) == k, 0.5 * (edges[i] + edges[i + 1]), x) for i in widest]
    return [begin(p, trial) for trial in trials if Evaluation(p, trial).stable]


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
        running = sorted((search(p, found, LARGEST, most) for found in running[:keep]), key=lambda found: found.merit)
    running = sorted([*running, *(search(p, found, LARGEST, HEATS[-1]) for found in also)], key=lambda one: one.merit)
    best, steps = leaps(p, running[0], rng, count if count > 1 else 0)
    steps += dropped + sum(found.steps for found in running)
    last = search(p, best, LARGEST, MOST)
    return [last, *(found for found in running if found is not best)], steps + last.steps - best.steps


def leaps(p: Problem, best: Found, rng: np.random.Generator, count: int) -> tuple[Found, int]:
    """The best after leaps, each to the best of four draws of one block; with the steps taken."""
    blocks = sorted({v.block for v in p.variables if v.name != "gain"})
    steps = 0
    for k in range(count if blocks else 0):
        mine = np.array([v.block == blocks[k % len(blocks)] for v in p.variables])
        draws = [np.where(mine, p.low + rng.random(mine.size) * (p.high - p.low), best.x) for _ in range(4)]
        found = min((scaled_start(p, x, 5) for x in draws), key=lambda found: found.merit)
        found = search(p, found, LARGEST, LEAP)
        if found.merit < best.merit + NEAR:
            found = search(p, found, LARGEST, HEATS[-1])
        steps += found.steps
        if found.merit < best.merit:
            best = found
    return best, steps
