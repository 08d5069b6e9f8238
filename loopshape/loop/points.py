"""Verdict -> what it says of each operating point, and which is the worst; Loop -> 95 % bands of its responses."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from loopshape.core.errors import WrongUseError
from loopshape.core.outcomes import ClosedLoop, Outcome
from loopshape.core.units import Array, ComplexArray, db, deg
from loopshape.data.requirement.requirements import LIMIT_OF, LIMITS
from loopshape.data.result.margins import Margins
from loopshape.data.result.verdict import RequirementResult, Verdict
from loopshape.loop.loop import Loop

#: quantities that say how close L comes to -1, the most telling first
CLOSENESS = tuple(x.name for x in sorted(LIMITS, key=lambda x: x.closeness) if x.closeness)
#: why a point is the worst where nothing is missed
NEAREST = "nearest to -1"


@dataclass(frozen=True)
class Worst:
    """The operating point to look at first: its place in the list, the frequency, and what makes it the worst."""

    index: int
    at_hz: float
    why: str


def point_outcome(margins: Margins, quantity: str, required: float) -> Outcome:
    """What these data say of one requirement at one operating point."""
    read = margins[quantity]
    if read.value != read.value:
        return Outcome.UNDECIDED
    slacks = [LIMIT_OF[quantity].sign * (end - required) for end in read.span]
    if min(slacks) >= 0.0:
        return Outcome.PASSED
    at_hz = read.at_hz or 0.0
    guessed = read.bound is None and any(low < at_hz < high for low, high in margins.missing_hz)
    perhaps = guessed or max(slacks) >= 0.0
    if quantity == "complementary_bandwidth_hz":  # |T| may fall for the last time in a hole further up
        perhaps |= any(required < high for _, high in margins.missing_hz)
    return Outcome.UNDECIDED if perhaps else Outcome.FAILED


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
    stable = [ClosedLoop.STABLE if m is None else m.stable for m in found]
    least = ClosedLoop.worst(stable)
    shaky = [k for k, one in enumerate(stable) if one is least]
    k = min(shaky, key=lambda k: _least_distance(loops[k], found[k]))
    at_hz = _nearest_hz(loops[k], found[k])
    if least is not ClosedLoop.STABLE:
        return Worst(k, at_hz, "unstable" if least is ClosedLoop.UNSTABLE else "stability undecided")
    missed = _missed(verdict)
    names = [loop.plant.recording or f"frf {k + 1}" for k, loop in enumerate(loops)]
    if missed is None or missed.recording not in names:
        return Worst(k, at_hz, NEAREST)
    k = names.index(missed.recording)
    word = "misses" if missed.outcome is Outcome.FAILED else "undecided:"
    at_hz = missed.at_hz if missed.at_hz is not None else _nearest_hz(loops[k], found[k])
    return Worst(k, at_hz, f"{word} {LIMIT_OF[missed.quantity].label}")


def _missed(verdict: Verdict | None) -> RequirementResult | None:
    lines = [] if verdict is None else [x for x in verdict.lines if x.quantity in CLOSENESS and not x.passed]
    return min(lines, key=lambda x: (-x.outcome.severity, CLOSENESS.index(x.quantity)), default=None)


def _least_distance(loop: Loop, margins: Margins | None) -> float:
    if margins is None:
        return float(np.min(np.abs(1.0 + loop.L)))
    return margins["modulus_margin"].ends[0]


def _nearest_hz(loop: Loop, margins: Margins | None) -> float:
    nearest = float(loop.frequency_hz[np.argmin(np.abs(1.0 + loop.L))])
    at_hz = None if margins is None else margins["modulus_margin"].at_hz
    return nearest if at_hz is None else at_hz


#: places of a circular error that stand for all of them
PLACES = 300
_GOLDEN_TURN = np.pi * (3.0 - np.sqrt(5.0))
_RESPONSES: Mapping[str, Callable[[ComplexArray, ComplexArray], ComplexArray]] = {
    "P": lambda P, C: P + 0.0 * C,
    "C": lambda P, C: 0.0 * P + C,
    "L": lambda P, C: C * P,
    "S": lambda P, C: 1.0 / (1.0 + C * P),
    "T": lambda P, C: C * P / (1.0 + C * P),
    "CS": lambda P, C: C / (1.0 + C * P),
    "PS": lambda P, C: P / (1.0 + C * P),
}


@dataclass(frozen=True, eq=False)
class Band:
    """Ends (nf,) of a response's 95 % band: magnitude in dB, phase in degrees about the response's own.

    An end of the phase reaches 180 where the error may turn the response round: there the phase is not known.
    """

    low_db: Array
    high_db: Array
    low_deg: Array
    high_deg: Array


def band(loop: Loop, name: str) -> Band:
    """95 % band of "P", "C", "L", "S", "T", "CS" or "PS", on the loop's lines.

    The plant's error is circular, of the variance that `loop.plant` states; places spread evenly over it (a golden
    spiral) are carried through to the response, and quantiles taken: no linearisation, no chance, and neighbouring
    lines give smooth ends. Each line holds the truth in 95 %, all lines together do so less often. It knows the FRF's
    noise alone, and is that of a line, not of a peak: the largest of many lines is another reading (`margins`).
    Refuses other names.
    """
    if name not in _RESPONSES:
        raise WrongUseError(
            "a band is that of one of a loop's responses", f"{name!r}", f"one of {', '.join(_RESPONSES)}"
        )
    of, C, P = _RESPONSES[name], loop.C, loop.plant.siso
    drawn = of(P + np.sqrt(loop.plant.variance[:, 0, 0]) * circular_places()[:, None], C)
    low_db, high_db = np.quantile(db(drawn), (0.025, 0.975), axis=0)
    low_deg, high_deg = np.quantile(deg(np.angle(drawn * np.conj(of(P, C)))), (0.025, 0.975), axis=0)
    return Band(low_db, high_db, low_deg, high_deg)


def circular_places(count: int = PLACES) -> ComplexArray:
    """Places (count,) of equal weight under a circular normal error of variance E|d|² = 1."""
    k = np.arange(count)
    return np.asarray(np.sqrt(-np.log1p(-(k + 0.5) / count)) * np.exp(1j * _GOLDEN_TURN * k))
