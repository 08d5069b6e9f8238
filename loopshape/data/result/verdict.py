"""What a check finds: each requirement's worst line, the verdict, and what would settle an undecided one."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from enum import StrEnum
from html import escape
from shlex import quote
from typing import TYPE_CHECKING, Any

from loopshape.core.json_ready import Plain, keys
from loopshape.core.outcomes import ClosedLoop, Outcome
from loopshape.data.result.margins import Margins, Reading

if TYPE_CHECKING:
    import pandas as pd

    from loopshape.data.control.controller import Controller
    from loopshape.data.control.scheduled import Scheduled


class SettledBy(StrEnum):
    """What settles an undecided operating point: a measurement, a word in the requirements, or neither."""

    MEASUREMENT = "measurement"
    DECLARATION = "declaration"
    NOTHING = "nothing"


@dataclass(frozen=True)
class Order(Plain):
    """What would settle an undecided operating point; where that is a measurement its band, spacing and length.

    `low_hz` to `high_hz` is the band, `resolution_hz` the distance of its lines, `seconds` the length at the signal to
    noise ratio per Hz of `recording`; None where `by` is no measurement. Frequencies of one recording may need several.
    """

    ALSO = keys("command")

    recording: str
    by: SettledBy
    low_hz: float | None = None
    high_hz: float | None = None
    resolution_hz: float | None = None
    seconds: float | None = None

    @property
    def command(self) -> str | None:
        """The measurement as a command, for the run in place of RUN; None where measuring does not settle it."""
        return self.command_for("RUN") if self.by is SettledBy.MEASUREMENT else None

    def command_for(self, run: str) -> str:
        """The same for a run's folder."""
        numbers = zip(
            ("--from-hz", "--to-hz", "--resolution-hz", "--seconds"),
            (self.low_hz, self.high_hz, self.resolution_hz, self.seconds),
            strict=True,
        )
        asked = " ".join(f"{name} {value:.6g}" for name, value in numbers)
        of = f" --recording {quote(self.recording)}" if self.recording else ""
        return f"loopshape plan {quote(run)}{of} --lines all {asked}"


@dataclass(frozen=True)
class RequirementResult(Plain):
    """A requirement at its worst operating point: required, value with its 95 % interval, slack, and the outcome.

    `slack` is the room between what is required and the interval's end on the bad side (positive: room left).
    `outcome` is "passed" where the whole interval holds, "failed" where none of it does, "undecided" between;
    then `longer` says by which factor more measuring would decide it, if the estimate stays (inf: no length would).
    A line whose number is a bound says in `bound` how good it may be, and where it is undecided in `measure_to_hz` up
    to which frequency to measure, as |L| falls on over the highest lines (None: not known), or below `at_hz` down to
    which; of what lines that are missing may hide in `measure_from_hz` from where.
    `beyond` tells that `value` is a bound, the largest that was searched.
    """

    ALSO = keys("passed")

    quantity: str
    unit: str
    required: float
    value: float
    slack: float
    outcome: Outcome
    recording: str
    at_hz: float | None
    interval: tuple[float, float] | None = None
    longer: float | None = None
    bound: float | None = None
    measure_to_hz: float | None = None
    beyond: bool = False
    measure_from_hz: float | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "outcome", Outcome(self.outcome))

    @property
    def span(self) -> tuple[float, float] | None:
        """Ends between which the value lies in 95 %: its interval, of a bound on to the best that may be."""
        none = self.interval is None and self.bound is None
        return None if none else Reading(self.value, self.interval, self.at_hz, self.bound).span

    @property
    def passed(self) -> bool:
        """Whether the requirement holds, as far as these data are sure."""
        return self.outcome is Outcome.PASSED


@dataclass(frozen=True, eq=False)
class Verdict(Plain):
    """A check's outcome for one loop, or for several at once: the worst line of each requirement over all points.

    `margins` holds every operating point's margins by recording; `passed` needs every line to pass and
    every operating point to be stable. A loop whose stability the data cannot decide does not pass.
    `outcome` is "passed", "failed" (a line or a loop surely misses) or "undecided".

    Of several loops `margins` are those of all together, and `each` holds a verdict a loop, with the
    others closed; the outcome needs them too. An undecided verdict on single loops says in `orders` what would settle
    it.

    `controllers` are those of all loops that were closed, and `data` by recording a mark of the FRF: equal marks mean
    the same lines and responses, so that two verdicts have their errors in common.
    """

    IN_JSON = keys("loop", "passed", "outcome", "lines", "margins", "unstable", "warnings", "orders", "each")

    loop: str
    lines: tuple[RequirementResult, ...]
    margins: Mapping[str, Margins]
    warnings: tuple[str, ...] = ()
    each: tuple[Verdict, ...] = ()
    orders: tuple[Order, ...] = ()
    controllers: tuple[Controller | Scheduled, ...] = ()
    data: Mapping[str, str] = field(default_factory=dict)

    @property
    def parts(self) -> tuple[Verdict, ...]:
        """This verdict, or of several loops that of each and then that of all together, by itself."""
        return (*self.each, replace(self, each=())) if self.each else (self,)

    @property
    def together(self) -> dict[str, Margins]:
        """Margins of several loops at once by recording; empty for a single loop."""
        return {name: m for name, m in self.margins.items() if m.loops}

    @property
    def stabilities(self) -> tuple[ClosedLoop, ...]:
        """The closed loop at each operating point."""
        return tuple(m.stable for m in self.margins.values())

    @property
    def unstable(self) -> tuple[str, ...]:
        """Recordings whose loop is unstable or undecided."""
        return tuple(name for name, m in self.margins.items() if m.stable is not ClosedLoop.STABLE)

    @property
    def outcome(self) -> Outcome:
        """What these data say of the controller."""
        found = [*(m.stable.outcome for m in self.margins.values()), *(one.outcome for one in self.each)]
        return Outcome.worst([*found, *(line.outcome for line in self.lines)])

    def __repr__(self) -> str:
        """One line: the outcome, and each requirement that does not hold."""
        missed = [f"{one.loop} {one.outcome}" for one in self.each if not one.passed]
        missed += [f"{line.quantity} {line.outcome}" for line in self.lines if not line.passed]
        missed += [f"{self.margins[name].stable} at {name}" for name in self.unstable]
        of, why = f" {self.loop}" if self.loop else "", f" ({', '.join(missed)})" if missed else ""
        return f"Verdict{of}: {self.outcome}{why}"

    def __str__(self) -> str:
        """The verdict in one sentence and a table of the requirements in 80 columns, as `loopshape check` prints it."""
        from loopshape.data.result.verdict_words import folded, page_text

        parts = [part for part in self.parts if part.margins or part.lines]
        return "\n".join([page_text(parts), *(folded(f"warning: {warning}") for warning in self.warnings)])

    def table(self) -> pd.DataFrame:
        """A row a requirement at its worst operating point: limit, worst case, 95 % interval, slack, where, outcome."""
        import pandas as pd

        names = {"quantity": "requirement", "unit": "unit", "required": "required", "value": "worst case", "low": "low",
                 "high": "high", "slack": "slack", "at_hz": "at [Hz]", "recording": "operating point",
                 "outcome": "outcome"}  # fmt: skip
        lines = [(part.loop, line, line.span or (None, None)) for part in self.parts for line in part.lines]
        rows = [vars(line) | {"loop": loop, "low": low, "high": high} for loop, line, (low, high) in lines]
        return pd.DataFrame(rows, columns=["loop"] * bool(self.each) + list(names)).rename(columns=names)

    def _repr_html_(self) -> str:
        """The table in a notebook, under the outcome."""
        return f"<p>{escape(repr(self))}</p>{self.table().to_html(index=False, float_format='{:.4g}'.format)}"

    def to_dict(self) -> dict[str, Any]:
        """The verdict as plain values for JSON; what was not found is None. A single loop has no `each`."""
        made = super().to_dict()
        return made if self.each else {key: value for key, value in made.items() if key != "each"}

    @property
    def passed(self) -> bool:
        """Whether these data verify the controller."""
        return self.outcome is Outcome.PASSED
