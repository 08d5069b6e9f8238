"""Verdict, baseline -> Comparison: what got worse, by how much, and whether that is more than chance."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import hypot, inf, isfinite, isnan
from statistics import NormalDist

from loopshape.core.outcomes import ClosedLoop
from loopshape.data.control.scheduled import Scheduled
from loopshape.data.requirement.requirements import LIMIT_OF, Limit
from loopshape.data.result.margins import Margins
from loopshape.data.result.verdict import RequirementResult, Verdict
from loopshape.toolbox.validation.kept.changes import Change, Comparison, LineChange, MarginChange, StabilityChange


def compare(before: Sequence[Verdict], now: Sequence[Verdict]) -> Comparison:
    """What became of a baseline, loop by loop and operating point by operating point.

    A verdict on several loops is compared in its parts: that on each, and that on all together.

    Where both verdicts come from the same data, their errors are common: whatever changed is the controller's (or the
    program's), and no interval hides it. Else the change's interval is had from both margins' own by recovering their
    variances (Zou and Donner, Statistics in Medicine 27, 2008): lower and upper parts added in quadrature, so that an
    interval may be lopsided; all are widened (Bonferroni) so that by chance alone any margin at all is called changed
    in one comparison out of 20. A margin without an interval is taken as exact, and that is noted.

    Where a loop is unstable, or is judged otherwise than before, only that is reported: its margins mean no room.
    On the same data the change of the estimate is certain, that of the true margin a little less: the errors cancel
    fully only where both margins are read at the same frequency.
    """
    mine, theirs = _parts(now), _parts(before)
    both = [loop for loop in mine if loop in theirs]
    lines = [x for loop in both for x in _lines(loop, theirs[loop], mine[loop])]
    stabilities = [
        StabilityChange(loop, name, was.stable, m.stable, m.stability_reason)
        for loop in both
        for name, m in mine[loop].margins.items()
        if (was := theirs[loop].margins.get(name)) is not None and was.stable != m.stable
    ]
    pairs = [pair for loop in both for pair in _pairs(theirs[loop], mine[loop])]
    margins = _compared(pairs)
    moved = {change.loop for change in margins if change.outcome is not Change.UNCHANGED}
    notes = [note for loop in both for note in _underneath(theirs[loop], mine[loop], loop in moved)]
    return Comparison(
        tuple(sorted(lines, key=lambda x: not x.worse)),
        tuple(sorted(stabilities, key=lambda x: not x.worse)),
        tuple(margins),
        tuple(_only(theirs, mine)),
        tuple(_only(mine, theirs)),
        (*notes, *_bare(pairs)),
    )


def _parts(verdicts: Sequence[Verdict]) -> dict[str, Verdict]:
    return {part.loop: part for verdict in verdicts for part in verdict.parts}


def bridge(before: Sequence[Verdict], now: Sequence[Verdict]) -> tuple[str, ...]:
    """Loops whose controllers and data have both changed, so that a change alone does not tell which of them did it.

    The way across is a check of the baseline's controllers on the present data: compared with the baseline it is the
    plant's part, compared with the present check the controllers'.
    """
    theirs = {one.loop: one for one in before}
    return tuple(
        one.loop
        for one in now
        if (was := theirs.get(one.loop)) is not None
        and not same_controllers(was, one)
        and any(was.data.get(name) not in (None, mark) for name, mark in one.data.items())
    )


def same_controllers(one: Verdict, other: Verdict) -> bool:
    """Whether the controllers of two verdicts run the same: all their fields are equal."""
    pairs = zip(one.controllers, other.controllers, strict=False)
    return len(one.controllers) == len(other.controllers) and all(_same(*pair) for pair in pairs)


def _same(one: object, other: object) -> bool:
    if isinstance(one, Scheduled) and isinstance(other, Scheduled):
        return (one.rate_hz, one.to_table()) == (other.rate_hz, other.to_table())
    return type(one) is type(other) and vars(one) == vars(other)


def _lines(loop: str, before: Verdict, now: Verdict) -> list[LineChange]:
    was, found = ({line.quantity: line for line in v.lines} for v in (before, now))
    changes = [LineChange(loop, q, was.get(q), found.get(q)) for q in dict.fromkeys((*was, *found))]
    return [c for c in changes if _sentence_of(c.before) != _sentence_of(c.now)]


def _sentence_of(line: RequirementResult | None) -> tuple[str, float] | None:
    return None if line is None else (line.outcome, line.required)


class _Pair:
    """One margin, then and now, with the reach of both intervals to either side of the change."""

    def __init__(self, loop: str, recording: str, limit: Limit, was: Margins, found: Margins, common: bool) -> None:
        self.loop, self.recording, self.limit = loop, recording, limit
        self.before, self.now = was[limit.name].value, found[limit.name].value
        self.was, self.found = was[limit.name].interval, found[limit.name].interval
        self.common = common
        below_was, above_was = _half_widths(self.before, self.was)
        below_now, above_now = _half_widths(self.now, self.found)
        none = common or not (isfinite(self.before) and isfinite(self.now))
        self.below, self.above = (0.0, 0.0) if none else (hypot(below_now, above_was), hypot(above_now, below_was))

    @property
    def known(self) -> bool:
        """Whether both were found at all (a limit on |CS| that was not required is -inf, an old file's gap NaN)."""
        values = (self.before, self.now)
        return not (any(map(isnan, values)) or -inf in values)


def _half_widths(value: float, interval: tuple[float, float] | None) -> tuple[float, float]:
    return (0.0, 0.0) if interval is None else (max(value - interval[0], 0.0), max(interval[1] - value, 0.0))


def _pairs(before: Verdict, now: Verdict) -> list[_Pair]:
    return [
        _Pair(now.loop, name, limit, was, found, before.data.get(name) == now.data.get(name))
        for name, found in now.margins.items()
        # margins mean room where the loop is stable: between a loop that is and one that is not nothing is compared
        if (was := before.margins.get(name)) is not None and was.stable is found.stable is not ClosedLoop.UNSTABLE
        for limit in LIMIT_OF.values()
    ]


def _compared(pairs: Sequence[_Pair]) -> list[MarginChange]:
    known = [pair for pair in pairs if pair.known]
    uncertain = sum(pair.below > 0.0 or pair.above > 0.0 for pair in known)
    chance = 0.05  # that any margin is called changed although none has
    one = NormalDist().inv_cdf(1.0 - 0.5 * chance)
    widen = NormalDist().inv_cdf(1.0 - 0.5 * chance / max(uncertain, 1)) / one
    return [_compare(pair, widen) for pair in known]


def _compare(pair: _Pair, widen: float) -> MarginChange:
    limit = pair.limit
    low = high = change = 0.0 if pair.now == pair.before else pair.now - pair.before
    if not isfinite(change) and not pair.common:
        low, high = _apart(pair)
    elif pair.below > 0.0 or pair.above > 0.0:
        low, high = change - widen * pair.below, change + widen * pair.above
    interval = (low, high) if low < high and isfinite(change) else None
    floor = 1.0 if limit.unit in ("dB", "deg") else 0.0
    finite = [abs(x) for x in (pair.before, pair.now) if isfinite(x)]
    # changes without an error of their own count from here on: what four figures do not show is none
    outcome = _outcome(low, high, 1e-4 * max([*finite, floor]), limit.sign)
    numbers = pair.before, pair.now, interval, pair.common
    return MarginChange(pair.loop, pair.recording, limit.name, limit.unit, *numbers, outcome)


def _apart(pair: _Pair) -> tuple[float, float]:
    """Bounds of a change from or to no limit at all: certain only where the two intervals lie apart."""
    (low, high), (was_low, was_high) = (x or (v, v) for x, v in ((pair.found, pair.now), (pair.was, pair.before)))
    return (inf, inf) if low > was_high else (-inf, -inf) if high < was_low else (-inf, inf)


def _outcome(low: float, high: float, tiny: float, sign: float) -> Change:
    if not (low > tiny or high < -tiny):
        return Change.UNCHANGED
    return Change.BETTER if (low > tiny) == (sign > 0.0) else Change.WORSE


def _only(these: Mapping[str, Verdict], others: Mapping[str, Verdict]) -> list[str]:
    """Loops, and operating points of loops that both have, which the others do not have."""
    found = []
    for loop, one in these.items():
        if loop not in others:
            found.append(f"loop {loop}")
        else:
            found += [f"{name} of loop {loop}" for name in one.data if name not in others[loop].data]
    return found


def _underneath(before: Verdict, now: Verdict, moved: bool) -> list[str]:
    """What differs below the margins: the controller, the data, or something else where both are the same."""
    shared = [name for name in now.data if name in before.data]
    if not shared:
        return []
    others = sum(before.data[name] != now.data[name] for name in shared)
    same = same_controllers(before, now)
    data = "the same data" if others == 0 else "other data"
    if 0 < others < len(shared):
        data += f" at {others} of {len(shared)} operating points"
    neither = "; the program, its fits or the requirements have changed" if moved and same and others == 0 else ""
    word = "controllers" if now.together else "controller"
    which = f"the same {word}" if same else f"other {word}" if now.together else f"another {word}"
    return [f"loop {now.loop}: {which}, {data}{neither}"]


def _bare(pairs: Sequence[_Pair]) -> list[str]:
    """A note on margins of different data that changed and lack an interval on one side at least."""
    bare = [p for p in pairs if p.known and not p.common and isfinite(p.now - p.before) and None in (p.was, p.found)]
    changed = sum(pair.now != pair.before for pair in bare)
    word = "margin lacks an interval and is" if changed == 1 else "margins lack an interval and are"
    return [f"{changed} {word} compared as exact"] if changed else []
