"""A structure contains others: what is left of it where a block does nothing. Their optima are starts of its own."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from loopshape.core.units import Array
from loopshape.data.control.block import BlockTemplate, Free
from loopshape.design.problem.problem import Problem
from loopshape.design.search.search import Found, begin
from loopshape.design.search.starts import polished, race, random_starts
from loopshape.design.settle import Judge, Settled, settle
from loopshape.design.structure import variables_of

#: parameters of a block that make it 1 where they are equal
PAIRS: dict[str, tuple[tuple[str, str], ...]] = {
    "lead_lag": (("f1_hz", "f2_hz"),),
    "notch": (("f1_hz", "f2_hz"), ("damping1", "damping2")),
}
#: of a structure and all that it contains at most so many are searched, the largest first
STRUCTURES = 8
#: ends nearer to each other than this (ln of every parameter) are one; on coarse lines the merit is known this closely
SAME, CLOSE = 1e-2, 0.01


@dataclass(frozen=True, eq=False)
class Raced:
    """A problem, the ends of its searches on coarse lines, best first, the steps they took, and the same of each
    structure with one block less, by the number of that block."""

    p: Problem
    ends: list[Found]
    steps: int
    less: tuple[tuple[int, Raced], ...] = ()


def raced(p: Problem, candidates: Sequence[Found], seed: int, draws: int, starts: int) -> Raced:
    """A race from candidates and from the optima of all structures that this one contains.

    The contained ones are searched from their own random starts, as they would be alone. Of the candidates the first
    half runs where a smaller structure's optimum runs too. One start alone has no company.
    """
    done: list[Raced] = []
    for one in reversed(contained(p) if starts > 1 else []):  # what is contained comes first
        done.append(_race(one, random_starts(one.coarse, np.random.default_rng(seed), draws, starts), seed, done))
    last = _race(p, candidates, seed, done)
    return replace(last, steps=last.steps + sum(one.steps for one in done))


def _race(p: Problem, candidates: Sequence[Found], seed: int, done: Sequence[Raced]) -> Raced:
    """A race of candidates and of what the structures with one block less ended at."""
    found = ((k, [one for one in done if same(one.p.templates, less.templates)]) for k, less in without_one(p))
    less = tuple((k, known[0]) for k, known in found if known)
    also = [begin(p.coarse, embedded(p, k, one.ends[0].x)) for k, one in less]
    mine = candidates[: (len(candidates) + 1) // 2] if less else candidates
    ends, steps = race(p.coarse, mine, np.random.default_rng([seed, 1]), also)
    return Raced(p, [*ends, *also], steps, less)


def settled(r: Raced, judge: Judge) -> tuple[Settled, int]:
    """The best of what a race's ends settle at, and the steps taken; best first, while one may still be better.

    What a smaller structure settles at is tried too where that may be better, or where no end passes.
    """
    best, steps = None, 0
    seen: list[Array] = []
    for end in r.ends:
        if best is not None and (
            not np.isfinite(end.merit) or _hopeless(end.merit - CLOSE, best) or _near(end.x, seen)
        ):
            continue
        found = polished(r.p, end)
        steps += found.steps - end.steps
        if best is not None and (not np.isfinite(found.merit) or _hopeless(found.merit, best) or _near(found.x, seen)):
            continue
        seen += [end.x, found.x]
        again = settle(r.p, found, judge)
        steps += again.found.steps - found.steps
        best = again if best is None else min([best, again], key=lambda one: one.rank)
    assert best is not None, "a race has an end"
    for k, less in r.less:
        if _hopeless(less.ends[0].merit - CLOSE, best):
            continue
        smaller, more = settled(less, judge)
        found = begin(r.p, embedded(r.p, k, smaller.found.x))
        again = Settled(found, judge(r.p.controller(found.x)), smaller.tighten)
        steps, best = steps + more, min([best, again], key=lambda one: one.rank)
    return best, steps


def _hopeless(merit: float, best: Settled) -> bool:
    """Whether what has a merit in a search cannot end better than a best that passes."""
    return best.verdict.passed and merit > best.rank[-1]


def _near(x: Array, seen: Sequence[Array]) -> bool:
    return any(float(np.abs(x - other).max()) < SAME for other in seen)


def contained(p: Problem) -> list[Problem]:
    """Problems of the structures that a problem's contains, each once, the largest first."""
    found: list[Problem] = []
    level = [p]
    while level and len(found) < STRUCTURES:
        below: list[Problem] = []
        for one in (smaller for larger in level for _, smaller in without_one(larger)):
            if not any(same(one.templates, other.templates) for other in below):
                below.append(one)
        found, level = [*found, *below], below
    return found[: STRUCTURES - 1]


def without_one(p: Problem) -> list[tuple[int, Problem]]:
    """Each block that may do nothing, and the problem without it; of two equal blocks one."""
    found: list[tuple[int, Problem]] = []
    for k, template in enumerate(p.templates):
        rest = p.templates[:k] + p.templates[k + 1 :]
        if neutral(template) is None or any(same(one.templates, rest) for _, one in found):
            continue
        asked = replace(p.requirements, structure=rest)
        if variables := variables_of(asked):
            found.append((k, replace(p, requirements=asked, templates=rest, variables=variables)))
    return found


def same(one: Sequence[BlockTemplate], two: Sequence[BlockTemplate]) -> bool:
    """Whether two structures have the same blocks with the same bounds, in the same order."""
    return [(t.kind, t.parameters, t.tie) for t in one] == [(t.kind, t.parameters, t.tie) for t in two]


def neutral(template: BlockTemplate) -> Mapping[str, float] | None:
    """Values of a block's free parameters with which it is 1 at every frequency; None where its bounds forbid it."""
    values: dict[str, float] = {}
    for one, two in PAIRS.get(template.kind, ()):
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
