"""Pictures of a verdict: what each operating point has, against what is wished."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from loopshape.draw.labels import bracket, number, symbol
from loopshape.draw.style import COLOURS, FULL_WIDTH_IN, LIMIT, axes_or_new, head, new_figure, styled
from loopshape.requirements import LIMITS, Line, Verdict


@styled()
def margin(verdict: Verdict, line: Line, *, ax: Axes | None = None) -> Axes:
    """One quantity of every recording against its limit; the forbidden side is tinted.

    A margin without end (the loop never comes to the crossing) is a hollow triangle at the edge; an
    unstable or undecided loop is a red cross.
    """
    ax = axes_or_new(ax, (FULL_WIDTH_IN, 2.0))
    names = list(verdict.margins)
    limit = next(limit for limit in LIMITS if limit.name == line.quantity)
    found = np.array([getattr(verdict.margins[name], line.quantity) for name in names])
    low, high = _span(np.append(found, line.wished))
    bad = np.array([name in verdict.unstable for name in names])
    x, ends = np.arange(len(names)), ~np.isfinite(found)
    ax.plot(x[~ends & ~bad], found[~ends & ~bad], "o", color=COLOURS[0], gid="found")
    ax.plot(x[~ends & bad], found[~ends & bad], "x", color=LIMIT, markeredgewidth=1.4, gid="unstable")
    edge = np.where(found == np.inf, high, low)
    if ends.any():  # an empty line that is not clipped would upset the layout
        ax.plot(x[ends], edge[ends], "^", markerfacecolor="white", color=COLOURS[0], clip_on=False, gid="without end")
    ax.axhline(line.wished, color=LIMIT, linewidth=1.1, gid="wished")
    ax.axhspan(*((low, line.wished) if limit.sense == "at_least" else (line.wished, high)), color=LIMIT, alpha=0.08)
    ax.set_ylim(low, high)
    ax.set_xlim(-0.6, len(names) - 0.4)
    ax.set_xticks(x, names, rotation=90.0)
    sense = limit.sense.replace("_", " ")
    unit = "" if limit.unit == "1" else f" {limit.unit}"
    ax.set_title(f"{limit.label}, {sense} {number(line.wished)}{unit}", loc="left", fontsize=8.0, pad=2.5)
    ax.set_ylabel(bracket(limit.unit).strip() or "[1]")
    return ax


def _span(values: np.ndarray) -> tuple[float, float]:
    seen = values[np.isfinite(values)]
    room = 0.15 * (float(np.ptp(seen)) or abs(float(seen[0])) or 1.0)
    return float(seen.min()) - room, float(seen.max()) + room


@styled()
def margins_map(verdict: Verdict) -> Figure:
    """Every wished quantity of a verdict over the recordings, one panel each."""
    rows = max(len(verdict.lines), 1)
    figure = new_figure(rows, 1, (FULL_WIDTH_IN, 0.9 + 1.35 * rows), sharex=True)
    for ax, line in zip(figure.axes, verdict.lines, strict=False):
        margin(verdict, line, ax=ax)
    for ax in figure.axes[:-1]:
        ax.tick_params(labelbottom=False)
    word = "passes" if verdict.passed else "does not pass"
    lost = f"unstable or undecided (crosses): {', '.join(verdict.unstable)}" if verdict.unstable else ""
    head(figure, f"Verdict  ·  loop {symbol(verdict.loop)} {word}", lost)
    return figure
