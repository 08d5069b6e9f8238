"""Verdicts in words, the same in tables, reports and failed tests."""

from __future__ import annotations

import textwrap
from collections.abc import Callable, Mapping, Sequence
from math import inf, isfinite
from typing import TYPE_CHECKING, NamedTuple

from loopshape.core.outcomes import ClosedLoop, Outcome
from loopshape.data.result.detuning import STABILITY, Lost

if TYPE_CHECKING:
    from loopshape.data.control.controller import Controller
    from loopshape.data.requirement.requirements import Limit
    from loopshape.data.result.margins import Margins, Reading
    from loopshape.data.result.verdict import Order, RequirementResult, Verdict


class Notation(NamedTuple):
    """How readings are written: numbers, nothing, what stands between two ends and before a limit or a bound, and units
    with the factor to them."""

    figures: Callable[[float], str]
    nothing: str = "-"
    between: str = " .. "
    senses: tuple[str, str] = ("at least", "at most")
    bounds: tuple[str, str] = (">= ", "<= ")
    units: Mapping[str, tuple[str, float]] = {}

    def unit(self, unit: str) -> tuple[str, float]:
        """The unit that a quantity is written in, and the factor to it."""
        return self.units.get(unit, (unit, 1.0))

    def interval(self, ends: tuple[float, float] | None, factor: float = 1.0) -> str:
        """A 95 % interval as people read it."""
        return self.nothing if ends is None else self.between.join(self.figures(factor * end) for end in ends)

    def reading(self, margins: Margins, limit: Limit) -> tuple[str, str]:
        """A reading of margins and its interval, "" where there is none; of a bound on to the best that may be."""
        read, (_, factor) = margins[limit.name], self.unit(limit.unit)
        beyond = limit.name == "detuning_percent" and margins.detuning is not None and margins.detuning.worst.beyond
        sign = "> " if beyond else self.sign(read.value, read.bound)
        known = isfinite(read.value) or (read.value == inf and read.bound is None)
        told = (read.interval is not None or read.bound is not None) and read.span != (-inf, inf)
        ends = self.interval(read.span, factor) if told else ""
        return f"{sign}{self.figures(factor * read.value)}" if known else self.nothing, ends

    def sign(self, value: float, bound: float | None) -> str:
        """What stands before a value that is the worst that may be, with the best as its `bound`."""
        return "" if bound is None else self.bounds[bound < value]


def number(value: float) -> str:
    """Four figures; what is below any margin's rounding is 0."""
    return "0" if abs(value) < 1e-6 else f"{value:.4g}"


#: as a terminal shows it
PRINTED = Notation(number)


def known_limits(verdict: Verdict, among: Sequence[Limit]) -> list[Limit]:
    """The limits of which a verdict has something to show: a number at some operating point, or a requirement."""
    asked = {line.quantity for line in verdict.lines}
    return [x for x in among if x.name in asked or any(_known(m[x.name]) for m in verdict.margins.values())]


def _known(read: Reading) -> bool:
    return isfinite(read.value) or read.bound is not None


def crossings_text(margins: Margins) -> str:
    """All 0 dB crossings in Hz."""
    return ", ".join(f"{f:.3g}" for f in margins.crossings_hz) or "none"


class Row(NamedTuple):
    """A row of a verdict's table in words: of a requirement at its worst operating point, or of the closed loop."""

    quantity: str
    unit: str
    sense: str
    required: str
    worst: str
    interval: str
    slack: str
    recording: str
    at_hz: float | None
    outcome: Outcome
    decides: str = ""

    @property
    def asked(self) -> str:
        """What is required with its sense and unit: "at least 45 deg"."""
        return f"{self.sense} {self.required} {'' if self.unit == '1' else self.unit}".strip()

    @property
    def verdict(self) -> str:
        """The outcome's word, and what would decide it."""
        return self.outcome.word + (f": {self.decides}" if self.decides else "")


def verdict_rows(verdict: Verdict, notation: Notation = PRINTED) -> list[Row]:
    """The table that all renderers show: the closed loop at its worst operating point, then the requirements."""
    rows = [row_of(line, notation) for line in verdict.lines]
    if not verdict.margins:
        return rows
    name = max(verdict.margins, key=lambda name: verdict.margins[name].stable.severity)
    stable, no = verdict.margins[name].stable, notation.nothing
    return [Row("closed loop", no, "", "stable", stable, no, no, name, None, stable.outcome), *rows]


def row_of(line: RequirementResult, notation: Notation = PRINTED) -> Row:
    """A requirement's row."""
    from loopshape.data.requirement.requirements import LIMIT_OF  # numpy with it: `--help` does without

    unit, factor = notation.unit(line.unit)

    def figures(value: float) -> str:  # the unit of an error or an input is as large as it likes
        tiny = limit is not None and limit.disturbed and abs(value) < 1e-6
        return f"{value:.4g}" if tiny else notation.figures(factor * value)

    limit, bound = LIMIT_OF.get(line.quantity), line.bound
    span = None if line.span == (-inf, inf) else line.span
    ends = notation._replace(figures=lambda value: figures(value / factor)).interval(span, factor)
    sign = "> " if line.beyond else notation.sign(line.value, bound)
    known = isfinite(line.value) or (line.value == line.value and bound is None)
    unknown = line.outcome.word if line.outcome is Outcome.UNDECIDED else "no bound"
    return Row(
        line.quantity,
        unit,
        "" if limit is None else notation.senses[limit.sense == "at_most"],
        figures(line.required),
        sign + figures(line.value) if known else unknown,
        ends + ("" if bound is None or span is None else " (bound)"),
        figures(line.slack) if known else notation.nothing,
        line.recording,
        line.at_hz,
        line.outcome,
        _decides(line),
    )


def _decides(line: RequirementResult) -> str:
    """How much more measuring would decide an undecided line, or up to which frequency."""
    if line.outcome is Outcome.UNDECIDED and line.bound is not None:
        at_hz, to_hz = line.at_hz or 0.0, line.measure_to_hz
        if line.measure_from_hz is not None:
            return f"bounded by what {line.measure_from_hz:.3g} to {to_hz:.3g} Hz may hide; measure finer there"
        if to_hz is not None and to_hz < at_hz:
            return f"bounded by what lies below the first frequency; measure down to {to_hz:.3g} Hz"
        higher = "higher" if to_hz is None else f"up to {to_hz:.3g} Hz"
        return f"bounded by what lies above the last frequency; measure {higher}"
    if line.longer is None:
        return ""
    return f"{line.longer:.2g} times the data would decide" if line.longer < 100.0 else "on the limit"


def line_text(line: RequirementResult) -> str:
    """A line in one sentence: required, found with its interval and where, slack, and what would decide it."""
    row, unit = row_of(line, PRINTED._replace(bounds=("", ""))), _unit(line.unit)
    bound = "" if line.bound is None else "at least " if line.bound > line.value else "at most "
    found = f"{'more than ' if line.beyond else ''}{bound}{row.worst.removeprefix('> ')}{unit}"
    found, slack = (found, f" (slack {row.slack}{unit})") if row.slack != PRINTED.nothing else (row.worst, "")
    interval = "" if line.span is None else f" (95 %: {PRINTED.interval(line.span)}{unit})"
    at = "" if line.at_hz is None else f" at {line.at_hz:.4g} Hz"
    decides = f": {row.decides}" if row.decides else ""
    return f"required {row.asked}, found {found}{interval}{at} in {line.recording}{slack}{decides}"


def stability_text(margins: Margins) -> str:
    """Stability with its reason, and where it is undecided the band to measure."""
    return margins.stable + _why(margins)


def _why(margins: Margins) -> str:
    reason = f": {margins.stability_reason}" if margins.stability_reason else ""
    band = margins.stability_band_hz if margins.stable is ClosedLoop.UNDECIDED else None
    return reason + ("" if band is None else f"; measure {band_text(*band)}")


def band_text(low_hz: float, high_hz: float) -> str:
    """A band to measure, open at one end perhaps."""
    if low_hz > 0.0 and high_hz < float("inf"):
        return f"{low_hz:.3g} to {high_hz:.3g} Hz"
    return f"below {high_hz:.3g} Hz" if high_hz < float("inf") else f"above {low_hz:.3g} Hz"


def unstable_text(verdict: Verdict, name: str) -> str:
    """An operating point whose loop is not known to be stable, in one sentence."""
    of = f"loop {verdict.loop}" if verdict.loop else "the loop"
    return f"{of} is {verdict.margins[name].stable} at {name}{_why(verdict.margins[name])}"


def detuning_warnings(found: Mapping[str, Margins], controller: Controller) -> tuple[str, ...]:
    """The worst of what operating points lose where their resonances move by up to 2 %, in one sentence; else none."""
    lost = {name: m.detuning.lost for name, m in found.items() if m.detuning is not None and m.detuning.lost}
    if not lost:
        return ()
    worst = min(lost, key=lambda name: found[name].detuning_percent)
    others = f", and at {len(lost) - 1} more" if len(lost) > 1 else ""
    return (f"{lost_text(lost[worst], controller)}, in {worst}{others}: require detuning_percent, and tune for it",)


def lost_text(lost: Lost, controller: Controller) -> str:
    """What a shift of the plant's frequencies costs, by which resonance and which block of the controller."""
    if lost.resonance_hz is None:
        head = f"with the plant's frequencies {lost.shift_percent:+.3g} % off"
    else:
        block = controller.blocks[lost.block - 1]
        numbers = ", ".join(f"{name} {value:.4g}" for name, value in block.parameters.items())
        head = (
            f"the loop depends on where the resonance at {lost.resonance_hz:.4g} Hz lies, by block {lost.block}"
            f" ({lost.block_kind}: {numbers}): with the plant's frequencies {lost.shift_percent:+.3g} % off"
        )
    if lost.quantity == STABILITY:
        return f"{head} it is unstable"
    unit = _unit(lost.unit)
    values = f"from {lost.nominal:.4g} to {lost.left:.4g}{unit} ({lost.required:.4g}{unit} asked)"
    return f"{head} {lost.quantity} goes {values}"


def headline(verdicts: Sequence[Verdict]) -> str:
    """The outcome of all loops in one sentence: what holds, else the first of the worst and how many more there are."""
    outcome = Outcome.worst(one.outcome for one in verdicts)
    if outcome is Outcome.PASSED:
        many = sum(len(verdict.lines) for verdict in verdicts)
        points = len({name for verdict in verdicts for name in verdict.margins})
        held = f"all requirements hold ({many})" if many else "no requirement given"
        return f"{held} and the closed loop is stable at every operating point ({points})"
    short = [(word, words) for verdict in verdicts for word, words in _shortcomings(verdict)]
    short.sort(key=lambda one: one[0] != outcome.word)
    others = f"; {len(short) - 1} more not met or undecided" if len(short) > 1 else ""
    return short[0][1] + others


def page_text(verdicts: Sequence[Verdict], more: str = "", run: str = "RUN") -> str:
    """The verdict in one sentence, and of each loop its requirements with values and intervals, in 80 columns.

    Under them stands what would settle an undecided loop, a command on one row, for the folder `run`.
    """
    word = Outcome.worst(one.outcome for one in verdicts).word
    first = f"verdict: {word}{more}: {headline(verdicts)}"
    orders = dict.fromkeys(order_text(order, run) for verdict in verdicts for order in verdict.orders)
    after = ["", *orders] if orders else []
    return "\n".join([folded(first), *(f"\n{_requirements(verdict)}" for verdict in verdicts), *after])


def order_text(order: Order, run: str = "RUN") -> str:
    """What would settle an undecided operating point, on one row."""
    if order.command is not None:
        return f"to settle it: {order.command_for(run)}"
    word = "declare it in the requirements" if order.by == "declaration" else "no measurement of the plant"
    return f"to settle it{f' in {order.recording}' if order.recording else ''}: {word}"


def folded(line: str) -> str:
    """A line folded at 80 columns; what follows its first row is indented."""
    rest = " " * (2 + len(line) - len(line.lstrip()))
    columns = 80  # width of what is printed first
    rows = textwrap.wrap(line, columns, subsequent_indent=rest, break_long_words=False, break_on_hyphens=False)
    return "\n".join(rows)


def _requirements(verdict: Verdict) -> str:
    heads = ("requirement", "required", "worst case", "95 % interval", "verdict")
    rows = [(x.quantity, x.required, x.worst, x.interval, x.outcome.word) for x in verdict_rows(verdict)]
    widths = [max(map(len, column)) for column in zip(heads, *rows, strict=True)]
    lines = ["  ".join(map(str.ljust, row, widths)).rstrip() for row in (heads, *rows)]
    return "\n".join([f"{f'Loop {verdict.loop}'.rstrip()}: {verdict.outcome.word}", *lines])


def _shortcomings(verdict: Verdict) -> list[tuple[str, str]]:
    """What does not hold of one loop: its word, and a sentence."""
    unstable = [(verdict.margins[x].stable.outcome.word, unstable_text(verdict, x)) for x in verdict.unstable]
    of = f"loop {verdict.loop}" if verdict.loop else "the loop"
    lines = [(x.outcome.word, f"{x.quantity} of {of}: {line_text(x)}") for x in verdict.lines if not x.passed]
    return unstable + lines


def _unit(unit: str) -> str:
    return "" if unit == "1" else f" {unit}"
