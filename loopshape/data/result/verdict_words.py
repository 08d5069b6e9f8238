"""Verdicts in words, the same in tables, reports and failed tests."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

from loopshape.data.result.detuning import STABILITY, Lost, Reach

if TYPE_CHECKING:
    from loopshape.data.control.controller import Controller
    from loopshape.data.requirement.requirements import Margins
    from loopshape.data.result.baseline import LineChange, MarginChange
    from loopshape.data.result.verdict import Order, RequirementResult, Verdict

#: how an outcome is printed
WORDS = {"passed": "pass", "failed": "FAIL", "undecided": "undecided"}
#: stability from bad to good
STABLE_RANK = {"unstable": 0, "undecided": 1, "stable": 2}
#: width of what is printed first
COLUMNS = 80
_HEADINGS = ("requirement", "required", "worst case", "95 % interval", "verdict")
_SENSE = {"at_least": "at least", "at_most": "at most"}


def outcome_of(verdicts: Sequence[Verdict]) -> str:
    """The outcome of all loops: "failed" where one fails, else "undecided" where one is, else "passed"."""
    found = {verdict.outcome for verdict in verdicts}
    return next((word for word in ("failed", "undecided") if word in found), "passed")


def number(value: float) -> str:
    """Four figures; what is below any margin's rounding is 0."""
    return "0" if abs(value) < 1e-6 else f"{value:.4g}"


def number_of(line: RequirementResult, value: float) -> str:
    """The same for a number of a line: an error's unit is as large as it likes."""
    return f"{value:.4g}" if line.quantity == "error_rms" else number(value)


def interval_text(interval: tuple[float, float] | None) -> str:
    """A 95 % interval as people read it, a dash where there is none."""
    return "-" if interval is None else f"{interval[0]:.4g} .. {interval[1]:.4g}"


def interval_or_bound_text(line: RequirementResult) -> str:
    """The 95 % interval of a line; of a bound from its end on the bad side to the best that may be."""
    return interval_text(line.span) + ("" if line.bound is None else " (bound)")


def longer_text(line: RequirementResult) -> str:
    """How much more measuring would decide an undecided line, or up to which frequency."""
    if line.outcome == "undecided" and line.bound is not None:
        to_hz = "higher" if line.measure_to_hz is None else f"up to {line.measure_to_hz:.3g} Hz"
        return f": bounded by what lies above the last frequency; measure {to_hz}"
    if line.longer is None:
        return ""
    return f": {line.longer:.2g} times the data would decide" if line.longer < 100.0 else ": on the limit"


def wished_text(line: RequirementResult) -> str:
    """What was asked for: "at least 45 deg"."""
    from loopshape.data.requirement.requirements import LIMIT_OF  # numpy with it: `--help` does without

    sense = _SENSE[LIMIT_OF[line.quantity].sense] if line.quantity in LIMIT_OF else ""
    return f"{sense} {line.required:g}{_unit(line.unit)}".strip()


def found_text(line: RequirementResult) -> str:
    """What was found, with its interval, at which frequency and operating point."""
    interval = "" if line.span is None else f" (95 %: {interval_text(line.span)}{_unit(line.unit)})"
    at = "" if line.at_hz is None else f" at {line.at_hz:.4g} Hz"
    more = "more than " if line.beyond else ""
    return f"{more}{bounded_number(line)}{_unit(line.unit)}{interval}{at} in {line.recording}"


def bounded_number(line: RequirementResult) -> str:
    """The number found, as a bound where it is one: "at least 10.8" or "at most 7.9"."""
    if line.bound is None:
        return number_of(line, line.value)
    return f"{'at least' if line.bound > line.value else 'at most'} {number(line.value)}"


def line_text(line: RequirementResult) -> str:
    """A line in one sentence: required, found with its interval, slack, and for an undecided one what would decide."""
    slack = f"(slack {number_of(line, line.slack)}{_unit(line.unit)})"
    return f"required {wished_text(line)}, found {found_text(line)} {slack}{longer_text(line)}"


def stability_text(margins: Margins) -> str:
    """Stability with its reason, and where it is undecided the band to measure."""
    return margins.stable + _why(margins)


def _why(margins: Margins) -> str:
    reason = f": {margins.stability_reason}" if margins.stability_reason else ""
    band = margins.stability_band_hz
    to_measure = "" if band is None or margins.stable != "undecided" else f"; measure {_band(*band)}"
    return f"{reason}{to_measure}"


def _band(low_hz: float, high_hz: float) -> str:
    if low_hz > 0.0 and high_hz < float("inf"):
        return f"{low_hz:.3g} to {high_hz:.3g} Hz"
    return f"below {high_hz:.3g} Hz" if high_hz < float("inf") else f"above {low_hz:.3g} Hz"


def unstable_text(verdict: Verdict, name: str) -> str:
    """An operating point whose loop is not known to be stable, in one sentence."""
    margins = verdict.margins[name]
    return f"{_loop(verdict)} is {margins.stable} at {name}{_why(margins)}"


def detuning_warnings(found: Mapping[str, Margins], controller: Controller) -> tuple[str, ...]:
    """The worst of what operating points lose where their resonances move by up to 2 %, in one sentence; else none."""
    lost = {name: m.detuning.lost for name, m in found.items() if m.detuning is not None and m.detuning.lost}
    if not lost:
        return ()
    worst = min(lost, key=lambda name: found[name].detuning_percent)
    others = f", and at {len(lost) - 1} other operating points" if len(lost) > 1 else ""
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


def reach_text(reach: Reach) -> str:
    """How far frequencies may move one way, and what breaks there: "1.2 % (phase_margin_deg)", "> 20 %"."""
    return f"> {reach.percent:.4g} %" if reach.beyond else f"{reach.percent:.3g} % ({reach.breaks})"


def verdict_text(verdict: Verdict) -> str:
    """A verdict in lines: the outcome, each requirement, each loop that is not known to be stable, the warnings."""
    lines = [f"  {WORDS[x.outcome]}: {x.quantity}: {line_text(x)}" for x in verdict.lines]
    lines += [f"  {_stable_word(verdict, name)}: {unstable_text(verdict, name)}" for name in verdict.unstable]
    lines += [f"  warning: {warning}" for warning in verdict.warnings]
    return "\n".join([f"loop {verdict.loop}: {WORDS[verdict.outcome]}", *lines])


def headline(verdicts: Sequence[Verdict]) -> str:
    """The outcome of all loops in one sentence: what holds, else the first of the worst and how many more there are."""
    outcome = outcome_of(verdicts)
    if outcome == "passed":
        many = sum(len(verdict.lines) for verdict in verdicts)
        points = len({name for verdict in verdicts for name in verdict.margins})
        held = f"all requirements hold ({many})" if many else "no requirement given"
        return f"{held} and the closed loop is stable at every operating point ({points})"
    short = [(word, words) for verdict in verdicts for word, words in _shortcomings(verdict)]
    short.sort(key=lambda one: one[0] != WORDS[outcome])
    others = f"; {len(short) - 1} more not met or undecided" if len(short) > 1 else ""
    return short[0][1] + others


def page_text(verdicts: Sequence[Verdict], more: str = "", run: str = "RUN") -> str:
    """The verdict in one sentence, and of each loop its requirements with values and intervals, in 80 columns.

    Under them stands what would settle an undecided loop, a command on one row, for the folder `run`.
    """
    first = f"verdict: {WORDS[outcome_of(verdicts)]}{more}: {headline(verdicts)}"
    orders = dict.fromkeys(order_text(order, run) for verdict in verdicts for order in verdict.orders)
    after = ["", *orders] if orders else []
    return "\n".join([folded(first), *(f"\n{_requirements(verdict)}" for verdict in verdicts), *after])


def order_text(order: Order, run: str = "RUN") -> str:
    """What would settle an undecided operating point, on one row."""
    if order.command is not None:
        return f"to settle it: {order.command_for(run)}"
    word = "what the requirements declare" if order.by == "declaration" else "no measurement of the plant"
    return f"to settle it in {order.recording}: {word}"


def folded(line: str) -> str:
    """A line folded at 80 columns; what follows its first row is indented."""
    rest = " " * (2 + len(line) - len(line.lstrip()))
    rows = textwrap.wrap(line, COLUMNS, subsequent_indent=rest, break_long_words=False, break_on_hyphens=False)
    return "\n".join(rows)


def _requirements(verdict: Verdict) -> str:
    stable, _, word = stability_of(verdict)
    rows = [("closed loop", "stable", stable, "-", word)] if verdict.margins else []
    rows += [
        (x.quantity, number_of(x, x.required), worst_text(x), interval_or_bound_text(x), WORDS[x.outcome])
        for x in verdict.lines
    ]
    widths = [max(map(len, column)) for column in zip(_HEADINGS, *rows, strict=True)]
    lines = ["  ".join(map(str.ljust, row, widths)).rstrip() for row in (_HEADINGS, *rows)]
    return "\n".join([f"{f'Loop {verdict.loop}'.rstrip()}: {WORDS[verdict.outcome]}", *lines])


def worst_text(line: RequirementResult) -> str:
    """The number found, and whether it is the largest that was searched."""
    return f"> {line.value:g}" if line.beyond else number_of(line, line.value)


def stability_of(verdict: Verdict) -> tuple[str, str, str]:
    """The closed loop at its worst operating point, where that is, and the outcome: a row of its own in each table."""
    if not verdict.margins:
        return "-", "-", "-"
    name = min(verdict.margins, key=lambda name: STABLE_RANK[verdict.margins[name].stable])
    stable = verdict.margins[name].stable
    return stable, name, WORDS[{"stable": "passed", "unstable": "failed"}.get(stable, "undecided")]


def _shortcomings(verdict: Verdict) -> list[tuple[str, str]]:
    """What does not hold of one loop: its word, and a sentence."""
    unstable = [(_stable_word(verdict, name), unstable_text(verdict, name)) for name in verdict.unstable]
    lines = [x for x in verdict.lines if not x.passed]
    return unstable + [(WORDS[x.outcome], f"{x.quantity} of {_loop(verdict)}: {line_text(x)}") for x in lines]


def _loop(verdict: Verdict) -> str:
    return f"loop {verdict.loop}" if verdict.loop else "the loop"


def _stable_word(verdict: Verdict, name: str) -> str:
    return WORDS["failed" if verdict.margins[name].stable == "unstable" else "undecided"]


def change_text(change: MarginChange, points: int = 1) -> str:
    """A margin's change in one sentence; `points` is at how many operating points it is so."""
    unit = _unit(change.unit)
    interval = "" if change.interval is None else f" ({interval_text(change.interval)}{unit})"
    others = f" and {points - 1} more" if points > 1 else ""
    return (
        f"{change.quantity} of loop {change.loop} is {change.outcome} by {abs(change.change):.4g}{unit}{interval}:"
        f" {change.before:.4g} to {change.now:.4g}{unit} in {change.recording}{others}"
    )


def line_change_words(change: LineChange) -> tuple[str, str, str, str]:
    """Outcome and limit before, and now."""
    before = (
        ("not required", "-") if change.before is None else (WORDS[change.before.outcome], wished_text(change.before))
    )
    now = ("not required", "-") if change.now is None else (WORDS[change.now.outcome], wished_text(change.now))
    return (*before, *now)


def _unit(unit: str) -> str:
    return "" if unit == "1" else f" {unit}"
