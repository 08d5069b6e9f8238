"""Where searches begin, and which of them go on: random starts, a race, and leaps from the best.

At first sight each start has its gain as large as allowed and is read by the kernel of `check`. Thousands of starts are
looked at so and few are followed; these are then measured by rows. A structure contains others, what is left of it
where a block does nothing: their optima are starts of its own.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from loopshape.core.kernels.loops import margins as columns
from loopshape.core.kernels.loops.quick_evaluate import QuickReadings, quick_evaluate
from loopshape.core.units import Array
from loopshape.data.control.block import BlockTemplate, Free
from loopshape.data.requirement.requirements import LIMIT_OF, Scale
from loopshape.data.requirement.weight import over
from loopshape.design.problem.evaluation import Evaluation
from loopshape.design.problem.measures import low_weights
from loopshape.design.problem.problem import Problem
from loopshape.design.problem.rows import LEAST, scaled
from loopshape.design.search import LARGEST, PENALTY, SearchResult, initial_point, search
from loopshape.design.structure import variables_of
from loopshape.design.tighten import TightenedSolution, Verifier, tighten_limits
from loopshape.loop.margin.margins import COLUMN_OF

#: steps that a search is given in the race's three heats, and after a leap; a leap that comes this near goes on
HEATS, LEAP, NEAR = (15, 40, 60), 15, 0.05
#: most steps of the last search, and its trust radius to begin with where the lines are others
MOST, ON = 300, 0.1
#: random starts are drawn anew up to so many times, until this many of them are stable
AGAIN, FEWEST = 12, 4
#: searches of a race end where a step promises less merit than this; a leap that gains less than that did not pay
ROUGH, PAYS, FEWEST_LEAPS = 1e-5, 1e-3, 6


def random_starts(p: Problem, rng: np.random.Generator, draws: int, keep: int) -> list[SearchResult]:
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


def _best(p: Problem, trials: Sequence[Array], keep: int) -> list[SearchResult]:
    """The best of starts from some x."""
    q = glanced(p)
    seen = sorted((scaled_start(p, q, x) for x in trials), key=lambda sight: sight.merit)[:keep]
    return sorted((initial_point(p, sight.x) for sight in seen), key=lambda found: found.merit)


def race(
    p: Problem, candidates: Sequence[SearchResult], rng: np.random.Generator, also: Sequence[SearchResult] = ()
) -> tuple[list[SearchResult], int]:
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


def polished(p: Problem, end: SearchResult) -> SearchResult:
    """The end of a race on coarse lines, searched on, on all of them."""
    found = end if end.measures.evaluation.p is p else initial_point(p, end.x, radius=ON, steps=end.steps)
    return search(p, found, LARGEST, MOST)


def leaps(p: Problem, best: SearchResult, rng: np.random.Generator, count: int) -> tuple[SearchResult, int]:
    """The best after at most `count` leaps, each to the best of four draws of one block; with the steps taken.

    They end after two rounds of all blocks, six leaps at least, in which none paid.
    """
    blocks = sorted({v.block for v in p.variables if v.name != "gain"})
    steps, q, idle = 0, glanced(p), 0
    for k in range(count if blocks else 0):
        mine = np.array([v.block == blocks[k % len(blocks)] for v in p.variables])
        draws = [np.where(mine, p.low + rng.random(mine.size) * (p.high - p.low), best.x) for _ in range(4)]
        seen = min((scaled_start(p, q, x, 5) for x in draws), key=lambda sight: sight.merit)
        found = search(p, initial_point(p, seen.x), LARGEST, LEAP, ROUGH)
        if found.merit < best.merit + NEAR:
            found = search(p, found, LARGEST, HEATS[-1], ROUGH)
        steps += found.steps
        idle = 0 if found.merit < best.merit - PAYS else idle + 1
        if found.merit < best.merit:
            best = found
        if idle >= max(2 * len(blocks), FEWEST_LEAPS):
            break
    return best, steps


@dataclass(frozen=True, eq=False)
class _QuickResult:
    """What is seen of a start: its merit, infinite where a loop is unstable, and x."""

    merit: float
    x: Array


def glanced(p: Problem) -> QuickReadings:
    """A problem's plants and limits as the kernel takes them."""
    level, sign, factor = _limits(p)
    last = p.f[p.first[1:] - 1]
    cut = zip(p.each, p.first[:-1], p.first[1:], strict=True)
    masks = [over(one.masks, one.weights, p.f[a:b]) for one, a, b in cut]
    weighed = any(one.masks or one.weights for one in p.each)
    wish = p.requirements.objective
    return QuickReadings(
        f=p.f,
        P=p.P,
        radius=p.radius,
        first=p.first,
        measured=p.first[:-1] + p.below,
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
    for name in p.limits.keys() & COLUMN_OF:
        k, row, limit = COLUMN_OF[name], LIMIT_OF[name], p.limits[name]
        level[:, k] = np.fmax(level[:, k], row.on_column(np.maximum(limit, LEAST) if row.scale is Scale.LN else limit))
        sign[k] = row.column_sign
        if row.scale is Scale.PLAIN:
            factor[k] = scaled(name, np.array(2.0)) - scaled(name, np.array(1.0))
    return level, sign, factor


def scaled_start(p: Problem, q: QuickReadings, x: Array, halvings: int = 6) -> _QuickResult:
    """A start from x, its first free gain (where there is one) about as large as all requirements allow, by halving.

    Where halving meets no stable loop the gain may have to be larger: an unstable plant needs a least gain.
    """
    e = Evaluation(p, x)

    C_above = e.C[p.above]

    def look(shift: float, enough: float = np.inf) -> tuple[float, bool]:
        return quick_evaluate(q, float(np.exp(shift)), e.C, C_above, e.below, enough)

    k = next((k for k, v in enumerate(p.variables) if v.name == "gain"), None)
    best, shift = look(0.0)[0], 0.0
    if k is None:
        return _QuickResult(best, x)
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
    return _QuickResult(best, np.where(np.arange(x.size) == k, x + shift, x))


def _between_passages(e: Evaluation, low: float, high: float) -> Array:
    """Changes of ln gain in the middle of each range in which no L passes -1, the widest ranges first.

    A gain moves every passage of the negative real axis alike, and within such a range the count does not change.
    """
    at = e.axis[e.L.real[e.axis] < 0.0]
    passes = -e.ln_L[np.concatenate([at, e.p.first[:-1]])]  # change at which each lies at -1
    edges = np.unique(np.clip([low, *passes, high], low, high))
    # at most so many ranges of the gain between passages of -1, the widest ones, are tried for a stable start
    ranges = 8
    widest = np.argsort(edges[:-1] - edges[1:], kind="stable")[:ranges]
    return np.asarray(0.5 * (edges[widest] + edges[widest + 1]))


#: parameters of a block that make it 1 where they are equal
_PAIRS: dict[str, tuple[tuple[str, str], ...]] = {
    "lead_lag": (("f1_hz", "f2_hz"),),
    "notch": (("f1_hz", "f2_hz"), ("damping1", "damping2")),
}
#: of a structure and all that it contains at most so many are searched, the largest first
_STRUCTURES = 8
#: ends nearer to each other than this (ln of every parameter) are one; on coarse lines the merit is known this closely
_SAME, _CLOSE = 1e-2, 0.01


@dataclass(frozen=True, eq=False)
class Tournament:
    """A problem, the ends of its searches on coarse lines, best first, the steps they took, and the same of each
    structure with one block less, by the number of that block."""

    p: Problem
    ends: list[SearchResult]
    steps: int
    less: tuple[tuple[int, Tournament], ...] = ()


def tournament(p: Problem, candidates: Sequence[SearchResult], seed: int, draws: int, starts: int) -> Tournament:
    """A race from candidates and from the optima of all structures that this one contains.

    The contained ones are searched from their own random starts, as they would be alone. Of the candidates the first
    half runs where a smaller structure's optimum runs too. One start alone has no company.
    """
    done: list[Tournament] = []
    for one in reversed(substructures(p) if starts > 1 else []):  # what is contained comes first
        done.append(_race(one, random_starts(one.coarse, np.random.default_rng(seed), draws, starts), seed, done))
    last = _race(p, candidates, seed, done)
    return replace(last, steps=last.steps + sum(one.steps for one in done))


def _race(p: Problem, candidates: Sequence[SearchResult], seed: int, done: Sequence[Tournament]) -> Tournament:
    """A race of candidates and of what the structures with one block less ended at."""
    found = ((k, [one for one in done if _same(one.p.templates, less.templates)]) for k, less in without_one(p))
    less = tuple((k, known[0]) for k, known in found if known)
    also = [initial_point(p.coarse, embedded(p, k, one.ends[0].x)) for k, one in less]
    mine = candidates[: (len(candidates) + 1) // 2] if less else candidates
    ends, steps = race(p.coarse, mine, np.random.default_rng([seed, 1]), also)
    return Tournament(p, [*ends, *also], steps, less)


def settled(r: Tournament, verifier: Verifier) -> tuple[TightenedSolution, int]:
    """The best of what a race's ends settle at, and the steps taken; best first, while one may still be better.

    What a smaller structure settles at is tried too where that may be better, or where no end passes.
    """
    best, steps = None, 0
    seen: list[Array] = []
    for end in r.ends:
        if best is not None and (
            not np.isfinite(end.merit) or _hopeless(end.merit - _CLOSE, best) or _near(end.x, seen)
        ):
            continue
        found = polished(r.p, end)
        steps += found.steps - end.steps
        if best is not None and (not np.isfinite(found.merit) or _hopeless(found.merit, best) or _near(found.x, seen)):
            continue
        seen += [end.x, found.x]
        again = tighten_limits(r.p, found, verifier)
        steps += again.result.steps - found.steps
        best = again if best is None else min([best, again], key=lambda one: one.rank)
    assert best is not None, "a race has an end"
    for k, less in r.less:
        if _hopeless(less.ends[0].merit - _CLOSE, best):
            continue
        smaller, more = settled(less, verifier)
        found = initial_point(r.p, embedded(r.p, k, smaller.result.x))
        again = TightenedSolution(found, verifier(r.p.controller(found.x)), smaller.tighten)
        steps, best = steps + more, min([best, again], key=lambda one: one.rank)
    return best, steps


def _hopeless(merit: float, best: TightenedSolution) -> bool:
    """Whether what has a merit in a search cannot end better than a best that passes."""
    return best.verdict.passed and merit > best.rank[-1]


def _near(x: Array, seen: Sequence[Array]) -> bool:
    return any(float(np.abs(x - other).max()) < _SAME for other in seen)


def substructures(p: Problem) -> list[Problem]:
    """Problems of the structures that a problem's contains, each once, the largest first."""
    found: list[Problem] = []
    level = [p]
    while level and len(found) < _STRUCTURES:
        below: list[Problem] = []
        for one in (smaller for larger in level for _, smaller in without_one(larger)):
            if not any(_same(one.templates, other.templates) for other in below):
                below.append(one)
        found, level = [*found, *below], below
    return found[: _STRUCTURES - 1]


def without_one(p: Problem) -> list[tuple[int, Problem]]:
    """Each block that may do nothing, and the problem without it; of two equal blocks one."""
    found: list[tuple[int, Problem]] = []
    for k, template in enumerate(p.templates):
        rest = p.templates[:k] + p.templates[k + 1 :]
        if neutral(template) is None or any(_same(one.templates, rest) for _, one in found):
            continue
        asked = replace(p.requirements, structure=rest)
        if variables := variables_of(asked):
            found.append((k, replace(p, requirements=asked, templates=rest, variables=variables)))
    return found


def _same(one: Sequence[BlockTemplate], two: Sequence[BlockTemplate]) -> bool:
    """Whether two structures have the same blocks with the same bounds, in the same order."""
    return [(t.kind, t.parameters, t.tie) for t in one] == [(t.kind, t.parameters, t.tie) for t in two]


def neutral(template: BlockTemplate) -> Mapping[str, float] | None:
    """Values of a block's free parameters with which it is 1 at every frequency; None where its bounds forbid it."""
    values: dict[str, float] = {}
    for one, two in _PAIRS.get(template.kind, ()):
        ends = [_range(template, name) for name in (one, two)]
        low, high = max(low for low, _ in ends), min(high for _, high in ends)
        if low > high or any(template.tie.get(a, b) != b for a, b in ((one, two), (two, one))):
            return None  # nothing in common, or tied to a parameter of another meaning
        common = float(np.sqrt(low * high))
        values |= {name: common for name in (one, two) if isinstance(template.parameters.get(name), Free)}
    return values or None


def _range(template: BlockTemplate, name: str) -> tuple[float, float]:
    """Least and largest value of a parameter, or of what it is tied to."""
    value = template.parameters[template.tie.get(name, name)]
    return (value.low, value.high) if isinstance(value, Free) else (value, value)


def embedded(p: Problem, k: int, x: Array) -> Array:
    """x of a problem from that of its structure without block k, which does nothing there."""
    nothing, rest = neutral(p.templates[k]) or {}, iter(x)
    return np.array([np.log(nothing[v.name]) if v.block == k else next(rest) for v in p.variables])
