"""Pictures of a verdict: what each operating point has, against what is required."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from loopshape.core.outcomes import ClosedLoop, Outcome
from loopshape.core.units import Array
from loopshape.data.requirement.requirements import LIMIT_OF
from loopshape.data.result.margins import Margins
from loopshape.data.result.verdict import RequirementResult, Verdict
from loopshape.loop.points import point_outcome
from loopshape.view.key import Entry
from loopshape.view.labels import bracket, number, symbol
from loopshape.view.style import COLOURS, FULL_WIDTH_IN, LIMIT, axes_or_new, head, new_figure, styled

#: passed a filled circle, undecided a hollow diamond, failed a cross
MARKS: Mapping[str, dict[str, Any]] = {
    "passed": {"marker": "o", "color": COLOURS[0], "markersize": 4.0},
    "undecided": {"marker": "D", "color": COLOURS[1], "markerfacecolor": "white", "markersize": 4.0},
    "failed": {"marker": "x", "color": LIMIT, "markersize": 5.0, "markeredgewidth": 1.5},
}


def mark_entries(outcomes: set[str]) -> list[Entry]:
    """What the notes say of the marks that a picture holds."""
    return [(name, {"linestyle": "none", **look}) for name, look in MARKS.items() if name in outcomes]


def with_stability(outcome: Outcome, margins: Margins | None) -> Outcome:
    """A requirement's outcome at a point; where the loop is unstable or undecided, that."""
    return Outcome.worst([outcome] if margins is None else [outcome, margins.stable.outcome])


_WITHOUT_END: dict[str, Any] = {"marker": "^", "color": "0.3", "markerfacecolor": "white", "linestyle": "none"}


@styled()
def margin(verdict: Verdict, line: RequirementResult, *, ax: Axes | None = None) -> Axes:
    """One quantity of every recording with its 95 % interval against its limit; the forbidden side is tinted.

    Passed is a filled circle, undecided by these data a hollow diamond, failed a cross; an unstable loop's numbers are
    crosses, whatever they say. A margin without end (the loop never comes to the crossing) is a hollow triangle at the
    edge. Intervals that leave the picture end at an arrow.
    """
    ax = axes_or_new(ax, (FULL_WIDTH_IN, 2.0))
    names, limit = list(verdict.margins), LIMIT_OF[line.quantity]
    read = [m[line.quantity] for m in verdict.margins.values()]
    found = np.array([one.value for one in read])
    ends = np.array([one.ends for one in read])
    low, high = _span(found, ends, line.required)
    _points(ax, verdict, line, found, np.clip(ends, low, high))
    edge = np.where(found == np.inf, high, low)
    away = ~np.isfinite(found)
    if away.any():  # an empty line that is not clipped would upset the layout
        ax.plot(np.flatnonzero(away), edge[away], clip_on=False, gid="without end", zorder=4.0, **_WITHOUT_END)
    ax.axhline(line.required, color=LIMIT, linewidth=1.1, gid="required")
    ax.axhspan(*((low, line.required) if limit.sense == "at_least" else (line.required, high)), color=LIMIT, alpha=0.08)
    ax.set_ylim(low, high)
    ax.set_xlim(-0.6, len(names) - 0.4)
    ax.set_xticks(np.arange(len(names)), names, rotation=90.0)
    unit = "" if limit.unit == "1" else f" {limit.unit}"
    required = f"{limit.label}, {limit.sense.replace('_', ' ')} {number(line.required)}{unit}"
    ax.set_title(f"{required}: {line.outcome.word}", loc="left", fontsize=8.0, pad=2.5)
    ax.set_ylabel(bracket(limit.unit).strip() or "[1]")
    return ax


def _points(ax: Axes, verdict: Verdict, line: RequirementResult, found: Array, ends: Array) -> None:
    """Finite values by outcome, with their intervals; unstable loops apart."""
    groups: dict[str, list[int]] = {}
    for k, (name, margins) in enumerate(verdict.margins.items()):
        outcome = with_stability(point_outcome(margins, line.quantity, line.required), margins)
        if np.isfinite(found[k]):
            groups.setdefault("unstable" if name in verdict.unstable else outcome, []).append(k)
            look = MARKS[outcome]
            if ends[k, 1] > ends[k, 0]:
                ax.plot([k, k], ends[k], color=look["color"], linewidth=1.1, gid="interval", zorder=2.5)
    for gid, rows in groups.items():
        worst = "undecided" if gid == "unstable" and _only_undecided(verdict) else gid
        look = MARKS.get(worst, MARKS["failed"])
        ax.plot(rows, found[rows], linestyle="none", zorder=3.0, gid=gid, **look)


def _only_undecided(verdict: Verdict) -> bool:
    return all(verdict.margins[name].stable is ClosedLoop.UNDECIDED for name in verdict.unstable)


def _span(found: Array, ends: Array, required: float) -> tuple[float, float]:
    """Limits about values and requirement, and about intervals as far as these are no wider than what they surround."""
    seen = np.append(found[np.isfinite(found)], required)
    room = 0.15 * (float(np.ptp(seen)) or abs(float(seen[0])) or 1.0)
    low, high = float(seen.min()) - room, float(seen.max()) + room
    finite = ends[np.isfinite(ends).all(axis=1)]
    reach = high - low
    if finite.size:
        low = max(min(low, float(finite.min()) - 0.05 * reach), low - reach)
        high = min(max(high, float(finite.max()) + 0.05 * reach), high + reach)
    return low, high


@styled()
def margins_map(verdict: Verdict) -> Figure:
    """Every required quantity of a verdict over the recordings, one panel each."""
    rows = max(len(verdict.lines), 1)
    figure = new_figure(rows, 1, (FULL_WIDTH_IN, 1.1 + 1.35 * rows), sharex=True)
    for ax, line in zip(figure.axes, verdict.lines, strict=False):
        margin(verdict, line, ax=ax)
    for ax in figure.axes[:-1]:
        ax.tick_params(labelbottom=False)
    entries = mark_entries({"passed", "undecided", "failed"})
    if any(line.get_gid() == "without end" for ax in figure.axes for line in ax.lines):
        entries.append(("without end", _WITHOUT_END))
    handles = [Line2D([], [], **look) for _, look in entries]
    style: dict[str, Any] = {"loc": "outside lower center", "ncols": len(entries), "borderaxespad": 0.2}
    figure.legend(handles, [text for text, _ in entries], **style)
    head(figure, f"Verdict  ·  loop {symbol(verdict.loop)}: {verdict.outcome.word}", *_unstable(verdict))
    return figure


def _unstable(verdict: Verdict) -> list[str]:
    """Recordings whose loop is unstable, and those that are undecided."""
    words = {"unstable": "unstable", "undecided": "stability undecided"}
    named = {word: [n for n in verdict.unstable if verdict.margins[n].stable == word] for word in words}
    return [f"{words[word]}: {', '.join(names)}" for word, names in named.items() if names]
