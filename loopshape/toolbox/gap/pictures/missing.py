"""The missing force: what acts at a place without a name, with its interval, and the best named effect over it."""

from __future__ import annotations

from collections.abc import Sequence

from matplotlib.axes import Axes

from loopshape.toolbox.gap.nouns.gap_report import Curve, GapReport
from loopshape.view.labels import bracket
from loopshape.view.style import COLOURS, axes_or_new, styled

CURVES = 2  # at most, side by side
ROOM = 0.6  # of the curves' height, above and below


@styled()
def missing(report: GapReport, curve: Curve, *, ax: Axes | None = None) -> Axes:
    """One curve: what would close the gap over speed, position or size, its 95 % interval, and the named effect."""
    ax = axes_or_new(ax)
    ax.axhline(0.0, color="0.7", linewidth=0.6)
    ax.fill_between(curve.x, curve.low, curve.high, color=COLOURS[0], alpha=0.2, linewidth=0.0, gid="interval")
    ax.plot(curve.x, curve.value, color=COLOURS[0], linewidth=1.4, gid="nameless", label="what would close the gap")
    if curve.named is not None:
        label = report.leading_name.replace("_", " ")
        ax.plot(
            curve.x, curve.named, color=COLOURS[1], linewidth=1.2, linestyle=(0, (4, 1.5)), gid="named", label=label
        )
    ax.set_xlabel(f"{curve.over}{bracket(curve.over_unit)}")
    ax.set_ylabel(f"added{bracket(curve.unit)}")
    ax.set_xlim(curve.x[0], curve.x[-1])
    ends = [curve.value, *([] if curve.named is None else [curve.named])]
    low, high = min(float(y.min()) for y in ends), max(float(y.max()) for y in ends)
    room = ROOM * max(high - low, 1e-12)  # an interval that is wider tells no more
    ax.set_ylim(low - room, high + room)
    return ax


def shown(curves: Sequence[Curve]) -> list[Curve]:
    """The curves that matter most: those that swing furthest."""
    return sorted(curves, key=lambda c: -float(c.value.max() - c.value.min()))[:CURVES]
