"""Maps of what a verdict asks for over two operating coordinates: a cell each point, its value in the cell."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Rectangle

from loopshape.data.control.loop import Loop
from loopshape.data.requirement.requirements import LIMIT_OF, Margins
from loopshape.data.result.verdict import Line, Verdict
from loopshape.loop.points import margins_of, point_outcome
from loopshape.view.key import varying
from loopshape.view.labels import number, numbers, quantity
from loopshape.view.style import styled
from loopshape.view.verdict.loop_parts import number3
from loopshape.view.verdict.outcomes import ink_on, missed_colours, near_colours, room_colours, with_stability

COLUMNS = 3
_SHADES = 32
_HATCHES = {"passed": None, "undecided": "....", "failed": "////"}


def map_rows(loops: Sequence[Loop], verdict: Verdict) -> int:
    """Rows of maps that a verdict gives: none unless two coordinates vary and tell the operating points apart."""
    return -(-len(verdict.lines) // COLUMNS) if _coordinates(loops) is not None else 0


def _coordinates(loops: Sequence[Loop]) -> tuple[str, str] | None:
    keys = varying([loop.plant for loop in loops])
    if len(keys) != 2:
        return None
    places = {tuple(loop.plant.operating_point[key] for key in keys) for loop in loops}
    return (keys[0], keys[1]) if len(places) == len(loops) else None


@styled()
def draw_maps(panels: Sequence[Axes], loops: Sequence[Loop], verdict: Verdict) -> None:
    """A map for each line of a verdict; panels left over are taken away."""
    for ax, line in zip(panels, verdict.lines, strict=False):
        point_map(loops, verdict, line, ax=ax)
    for ax in panels[len(verdict.lines) :]:
        ax.remove()


@styled()
def point_map(loops: Sequence[Loop], verdict: Verdict, line: Line, *, ax: Axes) -> Axes:
    """One requirement's quantity over the two coordinates that vary: cells lighter the more room they leave.

    Cells that miss it are dark and hatched, undecided ones dotted; the verdict's worst cell is framed.
    """
    keys = _coordinates(loops)
    assert keys is not None
    found = [(loop, margins_of(loop, k, verdict)) for k, loop in enumerate(loops)]
    known = [(loop, m) for loop, m in found if m is not None]
    xs, ys = (sorted({loop.plant.operating_point[key] for loop in loops}) for key in keys)
    sign = 1.0 if LIMIT_OF[line.quantity].sense == "at_least" else -1.0
    spare = np.array([sign * (getattr(m, line.quantity) - line.wished) for _, m in known])
    largest = float(np.max(np.abs(spare[np.isfinite(spare)]), initial=1e-12))
    for (loop, margins), room in zip(known, spare, strict=True):
        place = tuple(loop.plant.operating_point[key] for key in keys)
        at = (xs.index(place[0]), ys.index(place[1]))
        _cell(ax, at, margins, line, float(np.clip(room / largest, -1.0, 1.0)))
        if loop.plant.recording == line.recording:
            frame: dict[str, Any] = {"fill": False, "edgecolor": "black", "linewidth": 1.6, "zorder": 3.0}
            ax.add_patch(Rectangle((at[0] - 0.48, at[1] - 0.48), 0.96, 0.96, gid="worst", **frame))
    _axes(ax, keys, xs, ys)
    limit = LIMIT_OF[line.quantity]
    unit = "" if limit.unit == "1" else f" {limit.unit}"
    sense = "≥" if sign > 0.0 else "≤"
    text = f"{limit.label.split(' (')[0]} {sense} {number(line.wished)}{unit}"
    ax.set_title(text, loc="left", fontsize=7.5, pad=2.5)
    return ax


def _cell(ax: Axes, at: tuple[int, int], margins: Margins, line: Line, room: float) -> None:
    outcome = with_stability(point_outcome(margins, line.quantity, line.wished), margins)
    colour = _colour(outcome, room)
    edge = ink_on(colour) if _HATCHES[outcome] else "0.55"
    look: dict[str, Any] = {"facecolor": colour, "edgecolor": edge, "linewidth": 0.4, "hatch": _HATCHES[outcome]}
    with mpl.rc_context({"hatch.linewidth": 0.5}):
        ax.add_patch(Rectangle((at[0] - 0.5, at[1] - 0.5), 1.0, 1.0, gid=outcome, in_layout=False, **look))
    value = getattr(margins, line.quantity)
    text = "unst." if margins.stable == "unstable" else number3(value)
    box = None if _HATCHES[outcome] is None else {"facecolor": colour, "edgecolor": "none", "pad": 0.6}
    place: dict[str, Any] = {"ha": "center", "va": "center", "fontsize": 6.5, "in_layout": False}
    ax.text(*at, text, color=ink_on(colour), bbox=box, gid="value", **place)


def _colour(outcome: str, room: float) -> str:
    """Colour of a cell whose room (negative: missed) is a share of the largest of its map."""
    if outcome == "undecided":
        return near_colours(1)[0]
    if outcome == "failed":
        return missed_colours(_SHADES)[round(max(-room, 0.15) * (_SHADES - 1))]
    return room_colours(_SHADES)[round((1.0 - max(room, 0.0)) * (_SHADES - 1))]


def _axes(ax: Axes, keys: tuple[str, str], xs: Sequence[float], ys: Sequence[float]) -> None:
    ax.set_xlim(-0.5, len(xs) - 0.5)
    ax.set_ylim(-0.5, len(ys) - 0.5)
    ax.set_xticks(range(len(xs)), numbers(list(xs)), fontsize=7.0)
    ax.set_yticks(range(len(ys)), numbers(list(ys)), fontsize=7.0)
    ax.tick_params(length=0.0)
    ax.grid(False)
    ax.set_facecolor("0.93")
    ax.set_xlabel(quantity(keys[0]), fontsize=8.0)
    ax.set_ylabel(quantity(keys[1]), fontsize=8.0)
