"""What became of a verdict that was kept: which outcomes changed, which margins, and by how much."""

from __future__ import annotations

from dataclasses import dataclass

from loopshape.core.json_ready import Plain, keys
from loopshape.core.outcomes import Change, ClosedLoop
from loopshape.data.result.verdict import RequirementResult


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
