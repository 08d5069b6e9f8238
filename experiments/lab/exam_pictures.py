"""Pictures of an exam: what was taken for what, whether probabilities hold, how far gaps shrink."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from loopshape.view.style import COLOURS, FULL_WIDTH_IN, LIMIT, QUIET, axes_or_new, figure_of, head, new_figure, styled

if TYPE_CHECKING:
    from examiner.score import Calibration, Marked

_LAST = ("none", "unknown", "pair", "wrong pair", "failed")
RIGHT, WRONG = COLOURS[0], COLOURS[1]


@styled()
def confusion_map(confusion: Mapping[str, Mapping[str, int]], *, ax: Axes | None = None) -> Axes:
    """Counts of answers: truth downwards, verdict to the right; right ones blue on the diagonal, wrong ones red.

    Darker is a larger share of the truth's cases. Only names that occur have a row and a column.
    """
    names = _names(confusion)
    ax = axes_or_new(ax, (FULL_WIDTH_IN, 1.6 + 0.235 * len(names)))
    rows = [n for n in names if n in confusion]
    ax.set_xlim(0.0, max(len(names), 1))
    ax.set_ylim(max(len(rows), 1), 0.0)
    for y, truth in enumerate(rows):
        total = sum(confusion[truth].values())
        for verdict, count in confusion[truth].items():
            _cell(ax, names.index(verdict), y, count, count / total, verdict == truth)
    ax.set_xticks(np.arange(len(names)) + 0.5, [_words(n) for n in names], rotation=90.0, fontsize=7.0)
    ax.set_yticks(np.arange(len(rows)) + 0.5, [_words(n) for n in rows], fontsize=7.0)
    ax.set_xlabel("verdict")
    ax.set_ylabel("truth")
    ax.tick_params(length=0.0)
    ax.grid(visible=False)
    ax.set_xticks(range(len(names) + 1), minor=True)
    ax.set_yticks(range(len(rows) + 1), minor=True)
    ax.tick_params(which="minor", length=0.0)
    ax.grid(visible=True, which="minor", color="0.9", linewidth=0.5)
    return ax


def _names(confusion: Mapping[str, Mapping[str, int]]) -> list[str]:
    """Effects in order of the alphabet, then what is no single effect."""
    found = set(confusion) | {verdict for row in confusion.values() for verdict in row}
    return sorted(found - set(_LAST)) + [n for n in _LAST if n in found]


def _words(name: str) -> str:
    return name.replace("_", " ")


def _cell(ax: Axes, x: int, y: int, count: int, part: float, right: bool) -> None:
    face = RIGHT if right else WRONG
    strength = 0.25 + 0.75 * part
    ax.add_patch(Rectangle((x, y), 1.0, 1.0, facecolor=face, alpha=strength, gid="right" if right else "wrong"))
    colour = "white" if strength > 0.6 else "black"
    ax.text(x + 0.5, y + 0.52, str(count), ha="center", va="center", fontsize=7.0, color=colour, fontweight="bold")


@styled()
def reliability(calibration: Calibration, *, ax: Axes | None = None) -> Axes:
    """Share of right answers over their confidence, each with its 95 % interval; calibrated answers lie on the line."""
    ax = axes_or_new(ax, (4.5, 3.6))
    ax.plot([0.0, 1.0], [0.0, 1.0], color=QUIET, linestyle="--", linewidth=0.8, label="calibrated")
    if calibration.bins:
        x = np.array([b.confidence for b in calibration.bins])
        y = np.array([b.right.value for b in calibration.bins])
        ends = np.array([b.right.interval for b in calibration.bins]).T
        reach = np.abs(ends - y)
        ax.errorbar(
            x, y, reach, fmt="o", color=RIGHT, markersize=4.0, capsize=2.0, linewidth=0.9, label="answers, 95 %"
        )
        for b in calibration.bins:
            at = (b.confidence, b.right.value)
            paper = {"facecolor": "white", "edgecolor": "none", "pad": 0.4, "alpha": 0.8}
            ax.annotate(
                str(b.right.of), at, (-5.0, 0.0), textcoords="offset points", fontsize=7.0, ha="right", va="center",
                bbox=paper, gid="count",
            )  # fmt: skip
    ax.set_xlim(-0.02, 1.03)
    ax.set_ylim(-0.03, 1.03)
    ax.set_xlabel("probability of the verdict")
    ax.set_ylabel("share of verdicts that are right")
    ax.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=2)
    return ax


@styled()
def shrinks(marked: Sequence[Marked], *, must: float, aim: float, ax: Axes | None = None) -> Axes:
    """Held-out shrink of the gap for each single effect that was named right; the median of each is a bar.

    `must` and `aim` are what the median over all is held against. Values below -0.2 stand at the left edge. Effects
    lie in the order of their medians, the best uppermost.
    """
    by: dict[str, list[float]] = {}
    for m in marked:
        if m.shrink is not None:
            by.setdefault(m.truth, []).append(m.shrink)
    order = sorted(by, key=lambda name: float(np.median(by[name])))
    ax = axes_or_new(ax, (FULL_WIDTH_IN, 1.3 + 0.2 * max(len(order), 3)))
    for level, name, style in ((must, "must", "--"), (aim, "aim", ":")):
        ax.axvline(level, color=LIMIT, linestyle=style, linewidth=0.9, label=f"{name} of the median, {level:.0%}")
    for y, name in enumerate(order):
        values = np.clip(by[name], _LEAST, None)
        ax.plot(values, np.full(values.size, y), "o", color=RIGHT, markersize=3.5, alpha=0.75, gid="shrink")
        ax.plot([float(np.median(values))] * 2, [y - 0.35, y + 0.35], color=COLOURS[-1], linewidth=1.6)
    if by:
        every = float(np.median([v for values in by.values() for v in values]))
        ax.axvline(every, color=RIGHT, linewidth=0.9, label=f"median of all, {every:.0%}")
    ax.set_yticks(range(len(order)), [_words(n) for n in order], fontsize=7.5)
    ax.set_ylim(-0.7, max(len(order), 1) - 0.3)
    lowest = min((v for values in by.values() for v in values), default=0.0)
    ax.set_xlim(max(_LEAST, min(0.0, lowest)) - 0.03, 1.05)
    ax.set_xlabel("held-out shrink of the gap [1]")
    ax.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=3)
    return ax


_LEAST = -0.2


@styled()
def confusion_figure(confusion: Mapping[str, Mapping[str, int]]) -> Figure:
    """What was taken for what, with a head."""
    figure = figure_of(confusion_map(confusion))
    total = sum(sum(row.values()) for row in confusion.values())
    right = sum(row.get(truth, 0) for truth, row in confusion.items())
    head(figure, "What was taken for what", f"{right} of {total} answers right; number of arms in each cell")
    return figure


@styled()
def reliability_figure(calibration: Calibration) -> Figure:
    """Whether the probabilities hold, with a head."""
    figure = new_figure(1, 1, (4.6, 4.1))
    reliability(calibration, ax=figure.axes[0])
    c = calibration
    head(
        figure,
        "Do the probabilities hold?",
        f"expected calibration error {c.ece:.3f}; perfect answers would show {c.null_mean:.3f}, "
        f"in 95 % of exams less than {c.null_95:.3f}",
    )
    return figure


@styled()
def shrink_figure(marked: Sequence[Marked], *, must: float, aim: float) -> Figure:
    """How far the gap shrinks, with a head."""
    figure = figure_of(shrinks(marked, must=must, aim=aim))
    named = sum(m.kind == "single" and m.right for m in marked)
    without = named - sum(m.shrink is not None for m in marked)
    detail = f"recordings that no fit has seen; {named} single effects named right"
    head(figure, "How far the gap shrinks", detail + (f", {without} without a gap to shrink" if without else ""))
    return figure
