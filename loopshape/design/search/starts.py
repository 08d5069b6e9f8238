"""Where searches begin, and which of them go on: random starts, a race, and leaps from the best.

At first sight each start has its gain as large as allowed and is read by the kernel of `check`. Thousands of starts are
looked at so and few are followed; these are then measured by rows.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from loopshape.core.kernels.loops import margins as columns
from loopshape.core.kernels.loops.glance import Glanced, glance
from loopshape.core.units import Array
from loopshape.data.requirement.requirements import LIMIT_OF
from loopshape.data.requirement.weight import over
from loopshape.design.problem.evaluation import Evaluation
from loopshape.design.problem.measures import low_weights
from loopshape.design.problem.problem import Problem
from loopshape.design.problem.rows import scaled
from loopshape.design.search.search import LARGEST, PENALTY, Found, begin, search
from loopshape.loop.margin.margins import LOGARITHMS, PLAIN

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


#: at most so many ranges of the gain between passages of -1, the widest ones, are tried for a stable start
_RANGES = 8


@dataclass(frozen=True, eq=False)
class _Sight:
    """What is seen of a start: its merit, infinite where a loop is unstable, and x."""

    merit: float
    x: Array


def glanced(p: Problem) -> Glanced:
    """A problem's plants and limits as the kernel takes them."""
    level, sign, factor = _limits(p)
    last = p.f[p.first[1:] - 1]
    cut = zip(p.each, p.first[:-1], p.first[1:], strict=True)
    masks = [over(one.masks, one.weights, p.f[a:b]) for one, a, b in cut]
    weighed = any(one.masks or one.weights for one in p.each)
    wish = p.requirements.objective
    return Glanced(
        f=p.f,
        P=p.P,
        reach=p.reach,
        first=p.first,
        measured=p.first[:-1] + p.led,
        line=p.line,
        first_below=p.first_below,
        fitted=p.fitted,
        integrators=p.integrators,
        unstable=p.unstable,
        f_above=p.f_above,
        first_above=np.searchsorted(p.f_above, last),
        from_hz=p.requirements.control_high_frequency_from_hz or np.inf,
        masks=np.concatenate(masks, axis=1)[: None if weighed else 0],
        masks_above=np.stack([over(one.masks, one.weights, p.f_above) for one in p.each]),
        level=level,
        sign=sign,
        factor=factor,
        low=low_weights(p) if wish.disturbance else np.zeros(p.f.size),
        bandwidth=float(wish.bandwidth),
        disturbance=float(wish.disturbance),
        weighted_norm=float(wish.weighted_norm),
        penalty=PENALTY,
    )


def _limits(p: Problem) -> tuple[Array, Array, Array]:
    """Levels (points, columns) of the limits in the kernel's units, nan without one; signs and factors of rooms."""
    level = np.full((p.points, columns.COLUMNS), np.nan)
    sign, factor = np.ones(columns.COLUMNS), np.ones(columns.COLUMNS)
    for name, limit in p.limits.items():
        if name == "sensitivity_peak_db":  # the kernel reads its inverse
            level[:, columns.LN_MODULUS] = np.fmax(level[:, columns.LN_MODULUS], -scaled(name, limit))
        elif name in LOGARITHMS:
            k = LOGARITHMS[name]
            level[:, k] = np.fmax(level[:, k], scaled(name, limit))
            sign[k] = 1.0 if LIMIT_OF[name].sense == "at_least" else -1.0
        elif name in PLAIN:
            k = PLAIN[name]
            level[:, k], factor[k] = limit, scaled(name, np.array(2.0)) - scaled(name, np.array(1.0))
            sign[k] = 1.0 if LIMIT_OF[name].sense == "at_least" else -1.0
    return level, sign, factor


def scaled_start(p: Problem, q: Glanced, x: Array, halvings: int = 6) -> _Sight:
    """A start from x, its first free gain (where there is one) about as large as all requirements allow, by halving.

    Where halving meets no stable loop the gain may have to be larger: an unstable plant needs a least gain.
    """
    e = Evaluation(p, x)

    C_above = e.C[p.above]

    def look(shift: float, enough: float = np.inf) -> tuple[float, bool]:
        return glance(q, float(np.exp(shift)), e.C, C_above, e.below, enough)

    k = next((k for k, v in enumerate(p.variables) if v.name == "gain"), None)
    best, shift = look(0.0)[0], 0.0
    if k is None:
        return _Sight(best, x)
    low, high = float(p.low[k] - x[k]), float(p.high[k] - x[k])
    for _ in range(halvings):
        trial = 0.5 * (low + high)
        merit, holds = look(trial, best)
        low, high = (trial, high) if holds else (low, trial)
        if merit < best:
            best, shift = merit, trial
    if np.isinf(best):
        for trial in _between_passages(e, float(p.low[k] - x[k]), float(p.high[k] - x[k])):
            merit, _ = look(trial, best)
            if merit < best:
                best, shift = merit, trial
    return _Sight(best, np.where(np.arange(x.size) == k, x + shift, x))


def _between_passages(e: Evaluation, low: float, high: float) -> Array:
    """Changes of ln gain in the middle of each range in which no L passes -1, the widest ranges first.

    A gain moves every passage of the negative real axis alike, and within such a range the count does not change.
    """
    at = e.axis[e.L.real[e.axis] < 0.0]
    passes = -e.ln_L[np.concatenate([at, e.p.first[:-1]])]  # change at which each lies at -1
    edges = np.unique(np.clip([low, *passes, high], low, high))
    widest = np.argsort(edges[:-1] - edges[1:], kind="stable")[:_RANGES]
    return np.asarray(0.5 * (edges[widest] + edges[widest + 1]))
