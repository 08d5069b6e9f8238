"""What became of a verdict that was kept: which outcomes changed, which margins, and by how much."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from loopshape.core.json_ready import Plain, keys
from loopshape.core.outcomes import ClosedLoop, Graded
from loopshape.data.result.baseline import Case
from loopshape.data.result.verdict import RequirementResult
from loopshape.data.result.verdict_words import PRINTED, row_of


class Change(Graded):
    """What became of something since a baseline."""

    BETTER = "better"
    UNCHANGED = "unchanged"
    WORSE = "worse"


@dataclass(frozen=True)
class LineChange(Plain):
    """A requirement whose outcome or limit is not that of the baseline; None where one of them does not ask for it."""

    ALSO = keys("worse")

    loop: str
    quantity: str
    before: RequirementResult | None
    now: RequirementResult | None

    @property
    def worse(self) -> bool:
        """Whether the outcome is worse than before; a requirement that came or went is reported without verdict."""
        return self.step > 0

    @property
    def step(self) -> int:
        """How many steps the outcome is worse than before."""
        if self.before is None or self.now is None:
            return 0
        return self.now.outcome.severity - self.before.outcome.severity

    @property
    def words(self) -> tuple[str, str, str, str]:
        """Outcome and limit before, and now."""
        before, now = (
            ("not required", "-") if one is None else (one.outcome.word, row_of(one).asked)
            for one in (self.before, self.now)
        )
        return (*before, *now)

    @property
    def sentence(self) -> str:
        """What it was and is, with both limits."""
        was, required, now, required_now = self.words
        return f"{was} ({required}) to {now} ({required_now})"


@dataclass(frozen=True)
class StabilityChange(Plain):
    """An operating point whose closed loop is judged otherwise than in the baseline, and the reason now."""

    ALSO = keys("worse")

    loop: str
    recording: str
    before: ClosedLoop
    now: ClosedLoop
    reason: str

    @property
    def worse(self) -> bool:
        """Whether less is known to be stable than before."""
        return self.step > 0

    @property
    def step(self) -> int:
        """How many steps the outcome is worse than before."""
        return self.now.severity - self.before.severity


@dataclass(frozen=True)
class MarginChange(Plain):
    """One margin at one operating point: before, now, and whether the change is more than chance.

    `interval` holds the change with 95 %, jointly with all other changes of the comparison; None where the change has
    no error (`common`: the same data, or no intervals) or is infinite. `outcome` is "better", "worse" or "unchanged".
    """

    ALSO = keys("change")

    loop: str
    recording: str
    quantity: str
    unit: str
    before: float
    now: float
    interval: tuple[float, float] | None
    common: bool
    outcome: Change

    @property
    def change(self) -> float:
        """now - before, in the quantity's unit; 0 where both are the same infinity."""
        return 0.0 if self.now == self.before else self.now - self.before

    def sentence(self, points: int = 1) -> str:
        """The change in one sentence; `points` is at how many operating points it is so."""
        unit = "" if self.unit == "1" else f" {self.unit}"
        interval = "" if self.interval is None else f" ({PRINTED.interval(self.interval)}{unit})"
        others = f" and {points - 1} more" if points > 1 else ""
        return (
            f"{self.quantity} of loop {self.loop} is {self.outcome} by {abs(self.change):.4g}{unit}{interval}:"
            f" {self.before:.4g} to {self.now:.4g}{unit} in {self.recording}{others}"
        )


@dataclass(frozen=True)
class Comparison(Plain):
    """What became of a baseline: outcomes first, then margins, then what came or went.

    `margins` holds every margin that both know, at every operating point that both have. `gone` and `new` are loops and
    operating points that only the baseline, or only the present check, has. `notes` say what differs underneath
    (controller, data) and what could not be compared.
    """

    IN_JSON = keys("outcome", "lines", "stabilities", "margins", "gone", "new", "notes")

    lines: tuple[LineChange, ...]
    stabilities: tuple[StabilityChange, ...]
    margins: tuple[MarginChange, ...]
    gone: tuple[str, ...] = ()
    new: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()

    @property
    def outcome(self) -> Change:
        """Worse where anything is (an operating point that is gone is no longer verified), else better or unchanged."""
        steps = [*(x.step for x in self.lines), *(x.step for x in self.stabilities)]
        if self.gone or self.of(Change.WORSE) or max(steps, default=0) > 0:
            return Change.WORSE
        return Change.BETTER if self.of(Change.BETTER) or min(steps, default=0) < 0 else Change.UNCHANGED

    def of(self, outcome: Change) -> tuple[MarginChange, ...]:
        """The margins of one outcome."""
        return tuple(change for change in self.margins if change.outcome == outcome)

    def largest(self) -> tuple[tuple[MarginChange, int], ...]:
        """The largest change of each loop, quantity and direction, and at how many operating points it is so.

        Those for the worse come first; changes within their intervals are left out.
        """
        kept: dict[tuple[Change, str, str], list[MarginChange]] = {}
        for change in (*self.of(Change.WORSE), *self.of(Change.BETTER)):
            kept.setdefault((change.outcome, change.loop, change.quantity), []).append(change)
        return tuple((max(group, key=lambda c: abs(c.change)), len(group)) for group in kept.values())

    @property
    def counts(self) -> str:
        """The outcome and how many margins are worse, better and unchanged."""
        worse, better = (len(self.of(one)) for one in (Change.WORSE, Change.BETTER))
        same = len(self.margins) - worse - better
        return f"{self.outcome} ({worse} margins worse, {better} better, {same} unchanged)"

    @property
    def remarks(self) -> list[str]:
        """What came or went, and what differs underneath."""
        return [*(f"gone: {name}" for name in self.gone), *(f"new: {name}" for name in self.new), *self.notes]

    @property
    def beside(self) -> list[str]:
        """What is no case: what differs underneath, and what is new."""
        return [*self.notes, *(f"new: {name}" for name in self.new)]

    def tables(self, title: str) -> Iterator[tuple[str, list[str], list[list[Any]]]]:
        """Outcomes that changed, then margins that did."""
        lines = [[x.quantity, x.loop, *x.words] for x in self.lines]
        lines += [[f"stability in {s.recording}", s.loop, s.before, "-", s.now, s.reason] for s in self.stabilities]
        if lines:
            yield f"{title}: outcomes", ["requirement", "loop", "before", "required", "now", "required now"], lines
        if moved := self.largest():
            columns = ["margin", "loop", "unit", "before", "now", "change", "its 95 % interval", "at", "points"]
            intervals = ["exact" if x.interval is None else PRINTED.interval(x.interval) for x, _ in moved]
            rows = [
                [x.quantity, x.loop, x.unit, x.before, x.now, x.change, interval, x.recording, points, x.outcome]
                for (x, points), interval in zip(moved, intervals, strict=True)
            ]
            yield f"{title}: margins", [*columns, "outcome"], rows

    def text(self, title: str) -> str:
        """In lines: outcomes that changed, margins that did, what came or went, what differs underneath."""
        lines = [f"{x.quantity} of loop {x.loop}: {x.sentence}" for x in self.lines]
        lines += [f"loop {s.loop} in {s.recording}: {s.before} to {s.now}: {s.reason}" for s in self.stabilities]
        lines += [change.sentence(points) for change, points in self.largest()]
        return "\n".join([f"{title}: {self.counts}", *(f"  {line}" for line in (*lines, *self.remarks))])

    def cases(self) -> Iterator[Case]:
        """All that was compared: outcomes, stability, operating points that are gone, margins."""
        for line in self.lines:
            yield Case(f"baseline.{line.loop}", f"outcome of {line.quantity}", line.sentence, line.worse)
        for s in self.stabilities:
            text = f"{s.before} to {s.now}: {s.reason}"
            yield Case(f"baseline.{s.loop}", f"stability in {s.recording}", text, s.worse)
        for name in self.gone:
            yield Case("baseline", f"{name} is there", "the baseline has it, this check does not", True)
        for x in self.margins:
            worse = x.outcome is Change.WORSE
            yield Case(f"baseline.{x.loop}", f"{x.quantity} in {x.recording}", x.sentence(), worse)
