"""Verdicts as a Markdown summary, as a build server shows it beside a run."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence

from loopshape.core.outcomes import ClosedLoop, Outcome
from loopshape.data.requirement.requirements import LIMIT_OF, Limit
from loopshape.data.result.baseline import Comparison
from loopshape.data.result.margins import Margins
from loopshape.data.result.verdict import Verdict
from loopshape.data.result.verdict_words import PRINTED, known_limits, number, row_of, stability_text, unstable_text

#: what Markdown or GitHub's reader would take for more than a letter
_MARKS = re.compile(r"[\\`*\[\]|~$<>]|(?<![A-Za-z0-9])_|_(?![A-Za-z0-9])|^(?:#+|[+-]|\d+[.)])(?= )")


def markdown(verdicts: Sequence[Verdict], comparisons: Mapping[str, Comparison] | None = None) -> str:
    """The verdict, each loop's requirements, changes from a baseline by their titles, and all margins, for GitHub.

    The same verdicts give the same text; names are escaped and change no table.
    """
    whole = Outcome.worst(verdict.outcome for verdict in verdicts)
    parts = [f"## loopshape check: {_loud(whole)}", *(_counts(verdict) for verdict in verdicts)]
    for verdict in verdicts:
        parts += _requirements(verdict)
    for title, comparison in (comparisons or {}).items():
        parts += _comparison(title, comparison)
    parts += [_margins(verdict) for verdict in verdicts]
    return "\n\n".join(parts) + "\n"


def _loud(outcome: Outcome) -> str:
    return f"**{outcome.word}**" if outcome is Outcome.FAILED else outcome.word


def _counts(verdict: Verdict) -> str:
    outcomes = [line.outcome for line in verdict.lines]
    said = [f"{outcomes.count(Outcome.FAILED)} missed", f"{outcomes.count(Outcome.UNDECIDED)} undecided"]
    points = len(verdict.margins)
    stable = points - len(verdict.unstable)
    return (
        f"Loop {_escaped(verdict.loop)}: {_loud(verdict.outcome)}. Of {len(outcomes)} requirements {', '.join(said)};"
        f" stable at {stable} of {points} operating point{'s' * (points > 1)}."
    )


def _requirements(verdict: Verdict) -> list[str]:
    columns = ["requirement", "required", "worst case", "95 % interval", "slack", "unit", "at", "Hz", "verdict"]
    rows = [
        [x.quantity, x.asked, x.worst, x.interval, x.slack, x.unit, x.recording, x.at_hz, x.verdict]
        for x in map(row_of, verdict.lines)
    ]
    parts = [f"### Loop {_escaped(verdict.loop)}", _table(columns, rows)]
    notes = [*(unstable_text(verdict, name) for name in verdict.unstable), *verdict.warnings]
    return parts + (["\n".join(f"- {_escaped(note)}" for note in notes)] if notes else [])


def _comparison(title: str, comparison: Comparison) -> list[str]:
    parts = [_table(columns, rows) for _, columns, rows in comparison.tables(title)]
    notes = "\n".join(f"- {_escaped(note)}" for note in comparison.remarks)
    return [f"### {_escaped(title)}: {comparison.counts}", *parts, notes]


def _margins(verdict: Verdict) -> str:
    shown = known_limits(verdict, list(LIMIT_OF.values()))
    columns = ["operating point", "closed loop", *(f"{limit.short} [{limit.unit}]" for limit in shown)]
    rows = [
        [name, m.stable if m.stable is ClosedLoop.STABLE else stability_text(m), *(_reading(m, x) for x in shown)]
        for name, m in verdict.margins.items()
    ]
    head = f"<details><summary>Margins of loop {_html(verdict.loop)} at each operating point</summary>"
    return f"{head}\n\n{_table(columns, rows)}\n\n</details>"


def _reading(margins: Margins, limit: Limit) -> str:
    value, ends = PRINTED.reading(margins, limit)
    return f"{value} ({ends})" if ends else value


def _table(columns: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    cells = [
        [number(cell) if isinstance(cell, float) else "-" if cell is None else str(cell) for cell in x] for x in rows
    ]
    lines = [[*map(_escaped, row)] for row in (columns, *cells)]
    lines.insert(1, ["---"] * len(columns))
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
