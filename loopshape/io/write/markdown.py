"""Verdicts as a Markdown summary, as a build server shows it beside a run."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

from loopshape.data.requirement.requirements import LIMITS, Margins
from loopshape.data.result.baseline import Comparison, MarginChange
from loopshape.data.result.verdict import RequirementResult, Verdict
from loopshape.data.result.verdict_words import (
    WORDS,
    interval_or_bound_text,
    interval_text,
    line_change_words,
    longer_text,
    number,
    number_of,
    outcome_of,
    stability_text,
    unstable_text,
    wished_text,
)
from loopshape.io.files import make_folder, write_text_whole

#: what Markdown or GitHub's reader would take for more than a letter
_MARKS = re.compile(r"[\\`*\[\]|~$<>]|(?<![A-Za-z0-9])_|_(?![A-Za-z0-9])|^(?:#+|[+-]|\d+[.)])(?= )")


def write_markdown(
    path: Path, verdicts: Sequence[Verdict], comparisons: Mapping[str, Comparison] | None = None
) -> None:
    """Write a summary whole: the verdict, each loop's requirements, changes from a baseline, and all margins.

    `comparisons` by their titles. The same verdicts give the same bytes; names are escaped and change no table.
    """
    make_folder(path.parent)
    write_text_whole(path, markdown(verdicts, comparisons))


def markdown(verdicts: Sequence[Verdict], comparisons: Mapping[str, Comparison] | None = None) -> str:
    """The summary's text, GitHub-flavoured."""
    parts = [f"## loopshape check: {_loud(outcome_of(verdicts))}", *(_counts(verdict) for verdict in verdicts)]
    for verdict in verdicts:
        parts += _requirements(verdict)
    for title, comparison in (comparisons or {}).items():
        parts += _comparison(title, comparison)
    parts += [_margins(verdict) for verdict in verdicts]
    return "\n\n".join(parts) + "\n"


def _loud(outcome: str) -> str:
    return f"**{WORDS[outcome]}**" if outcome == "failed" else WORDS[outcome]


def _counts(verdict: Verdict) -> str:
    outcomes = [line.outcome for line in verdict.lines]
    said = [f"{outcomes.count(word)} {name}" for word, name in (("failed", "missed"), ("undecided", "undecided"))]
    points = len(verdict.margins)
    stable = points - len(verdict.unstable)
    return (
        f"Loop {_escaped(verdict.loop)}: {_loud(verdict.outcome)}. Of {len(outcomes)} requirements {', '.join(said)};"
        f" stable at {stable} of {points} operating point{'s' * (points > 1)}."
    )


def _requirements(verdict: Verdict) -> list[str]:
    columns = ["requirement", "required", "worst case", "95 % interval", "slack", "unit", "at", "Hz", "verdict"]
    parts = [f"### Loop {_escaped(verdict.loop)}", _table(columns, [_row(line) for line in verdict.lines])]
    notes = [*(unstable_text(verdict, name) for name in verdict.unstable), *verdict.warnings]
    return parts + (["\n".join(f"- {_escaped(note)}" for note in notes)] if notes else [])


def _row(line: RequirementResult) -> list[str]:
    found = f"> {number(line.value)}" if line.beyond else number_of(line, line.value)
    numbers = [found, interval_or_bound_text(line), number_of(line, line.slack), line.unit, line.recording]
    at = "-" if line.at_hz is None else f"{line.at_hz:.4g}"
    return [line.quantity, wished_text(line), *numbers, at, WORDS[line.outcome] + longer_text(line)]


def _comparison(title: str, comparison: Comparison) -> list[str]:
    parts = [f"### {_escaped(title)}: {comparison.counts}"]
    lines = [[x.quantity, x.loop, *line_change_words(x)] for x in comparison.lines]
    lines += [[f"stability in {s.recording}", s.loop, s.before, "-", s.now, s.reason] for s in comparison.stabilities]
    if lines:
        parts.append(_table(["requirement", "loop", "before", "required", "now", "required now"], lines))
    if moved := comparison.largest():
        columns = ["margin", "loop", "before", "now", "change", "its 95 % interval", "unit", "at", "points", "outcome"]
        parts.append(_table(columns, [_moved(change, points) for change, points in moved]))
    notes = [f"gone: {name}" for name in comparison.gone] + [f"new: {name}" for name in comparison.new]
    return [*parts, "\n".join(f"- {_escaped(note)}" for note in [*notes, *comparison.notes])]


def _moved(change: MarginChange, points: int) -> list[str]:
    numbers = [f"{change.before:.4g}", f"{change.now:.4g}", f"{change.change:+.4g}"]
    interval = "exact" if change.interval is None else interval_text(change.interval)
    return [
        change.quantity, change.loop, *numbers, interval, change.unit, change.recording, str(points), change.outcome,
    ]  # fmt: skip


def _margins(verdict: Verdict) -> str:
    shown = [limit for limit in LIMITS if any(_is_known(getattr(m, limit.name)) for m in verdict.margins.values())]
    columns = ["operating point", "closed loop", *(f"{limit.label.split(' (')[0]} [{limit.unit}]" for limit in shown)]
    rows = [
        [name, stability_text(m) if m.stable != "stable" else "stable", *(_margin(m, limit.name) for limit in shown)]
        for name, m in verdict.margins.items()
    ]
    head = f"<details><summary>Margins of loop {_html(verdict.loop)} at each operating point</summary>"
    return f"{head}\n\n{_table(columns, rows)}\n\n</details>"


def _margin(margins: Margins, name: str) -> str:
    interval = margins.intervals.get(name)
    value = getattr(margins, name)
    shown = f"{value:.4g}" if _is_known(value) else "-"
    return shown if interval is None else f"{shown} ({interval_text(interval)})"


def _is_known(value: float) -> bool:
    return value == value and value != float("-inf")


def _table(columns: Iterable[str], rows: Iterable[Sequence[str]]) -> str:
    heads = [_escaped(name) for name in columns]
    lines = [heads, ["---"] * len(heads), *([_escaped(cell) for cell in row] for row in rows)]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def _escaped(text: str) -> str:
    """Text as it stands: one line, no mark-up, no HTML."""
    plain = " ".join(text.split())
    return _MARKS.sub(_literal, plain.replace("&", "&amp;"))


def _literal(mark: re.Match[str]) -> str:
    found = mark.group()
    return f"{found[:-1]}\\{found[-1]}"


def _html(text: str) -> str:
    return " ".join(text.split()).replace("&", "&amp;").replace("<", "&lt;").replace(">", "&gt;")
