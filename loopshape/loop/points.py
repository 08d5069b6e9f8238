"""Verdict -> what it says of each operating point, and which of them is the worst."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from loopshape.data.control.loop import Loop
from loopshape.data.requirement.requirements import LIMIT_OF, LIMITS, Margins
from loopshape.data.result.verdict import Line, Verdict
from loopshape.data.result.verdict_words import STABLE_RANK

#: quantities that say how close L comes to -1, the most telling first
CLOSENESS = tuple(x.name for x in sorted(LIMITS, key=lambda x: x.closeness) if x.closeness)
#: why a point is the worst where nothing is missed
NEAREST = "nearest to -1"
#: what counts as worse first
SEVERITY = {"failed": 0, "undecided": 1, "passed": 2}


@dataclass(frozen=True)
class Worst:
    """The operating point to look at first: its place in the list, the frequency, and what makes it the worst."""

    index: int
    at_hz: float
    why: str


def point_outcome(margins: Margins, quantity: str, required: float) -> str:
    """What these data say of one requirement at one operating point: "passed", "failed" or "undecided"."""
    value = getattr(margins, quantity)
    if value != value:
        return "undecided"
    low, high = margins.intervals.get(quantity, (value, value))
    at_least = LIMIT_OF[quantity].sense == "at_least"
    if quantity in margins.bounds:
        best = margins.bounds[quantity]
        low, high = (low, max(high, best)) if at_least else (min(low, best), high)
    surely, perhaps = (low >= required, high >= required) if at_least else (high <= required, low <= required)
    at_hz = margins.at_hz.get(quantity, 0.0)
    perhaps = perhaps or any(low < at_hz < high for low, high in margins.missing_hz)
    return "passed" if surely else "undecided" if perhaps else "failed"


def margins_of(loop: Loop, k: int, verdict: Verdict | None) -> Margins | None:
    """The margins that a verdict holds of the k-th loop, None without."""
    return None if verdict is None else verdict.margins.get(loop.plant.recording or f"frf {k + 1}")


def worst_of(loops: Sequence[Loop], verdict: Verdict | None = None) -> Worst:
    """The worst of some loops (one at least) as far as room about -1 goes.

    First one that is unstable, or whose stability is undecided; then the one at which the verdict's worst line about
    that room failed or is undecided; else the one with the least modulus margin, at the low end of its interval.
    Without a verdict the least |1 + L| over the lines.
    """
    found = [margins_of(loop, k, verdict) for k, loop in enumerate(loops)]
    ranks = [2 if m is None else STABLE_RANK[m.stable] for m in found]
    shaky = [k for k, rank in enumerate(ranks) if rank == min(ranks)]
    k = min(shaky, key=lambda k: _least_distance(loops[k], found[k]))
    at_hz = _nearest_hz(loops[k], found[k])
    if min(ranks) < 2:
        return Worst(k, at_hz, "unstable" if min(ranks) == 0 else "stability undecided")
    missed = _missed(verdict)
    names = [loop.plant.recording or f"frf {k + 1}" for k, loop in enumerate(loops)]
    if missed is None or missed.recording not in names:
        return Worst(k, at_hz, NEAREST)
    k = names.index(missed.recording)
    word = "misses" if missed.outcome == "failed" else "undecided:"
    at_hz = missed.at_hz if missed.at_hz is not None else _nearest_hz(loops[k], found[k])
    return Worst(k, at_hz, f"{word} {LIMIT_OF[missed.quantity].label}")


def _missed(verdict: Verdict | None) -> Line | None:
    lines = [] if verdict is None else [x for x in verdict.lines if x.quantity in CLOSENESS and x.outcome != "passed"]
    return min(lines, key=lambda x: (SEVERITY[x.outcome], CLOSENESS.index(x.quantity)), default=None)


def _least_distance(loop: Loop, margins: Margins | None) -> float:
    if margins is None:
        return float(np.min(np.abs(1.0 + loop.L)))
    return margins.intervals.get("modulus_margin", (margins.modulus_margin,))[0]


def _nearest_hz(loop: Loop, margins: Margins | None) -> float:
    nearest = float(loop.frequency_hz[np.argmin(np.abs(1.0 + loop.L))])
    return nearest if margins is None else margins.at_hz.get("modulus_margin", nearest)
