"""Nichols charts: open loops at all operating points against |S|, |T|, what is forbidden, and what noise leaves.

And the same in the complex plane, near the point that they must not encircle.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patches import Circle, Polygon
from matplotlib.ticker import MultipleLocator

from loopshape.core.units import Array, db, deg
from loopshape.data.requirement.requirements import Requirements
from loopshape.data.result.verdict import Verdict
from loopshape.loop.loop import Loop
from loopshape.loop.points import Worst, worst_of
from loopshape.view.key import Entry, LabelRoom, corner_with_room, curve, key_of, place_entries, place_key
from loopshape.view.plots.curves import NOT_VALID, draw_known, loop_phase_deg, nearest_branch
from loopshape.view.plots.nichols_guides import (
    CONTOUR_ENTRIES,
    centre_marks,
    closest_db,
    contours,
    error_region,
    forbidden,
    forbidden_entries,
)
from loopshape.view.style import COLOURS, FULL_WIDTH_IN, LIMIT, QUIET, axes_or_new, figure_of, head, styled
from loopshape.view.verdict.loop_parts import looks_of, named, needs_loops, shown, standing_out, title_of, worst_text

#: error regions stand on lines with |L| within so many dB of 1: so many on the worst loop, one on some next worst
REGION_DB, REGIONS, NEXT_WORST = 15.0, 8, 2
#: measured lines drawn as dots, at most
DOTS = 300
_REACH_DB, _SEEN_DB = 40.0, 0.4
#: |L| below which, and standard deviation above which, lines are dots and no curve
_FAR_BELOW, _VISIBLE_STD = 0.25, 0.03
_FAINT = (NOT_VALID, "measured")
_TICK: dict[str, Any] = {"marker": "o", "color": "black", "markerfacecolor": "white", "markersize": 3.0}


@dataclass(frozen=True, eq=False)
class _Curve:
    """One open loop on its lines: phase on its branch, magnitude, and the lines whose phase is known."""

    loop: Loop
    phase_deg: Array
    size_db: Array
    known: np.ndarray
    look: dict[str, Any]

    @property
    def drawn(self) -> np.ndarray:
        """Known lines without those far below 0 dB whose noise shows: they are dots, a curve would only scribble."""
        far = self.size_db < db(_FAR_BELOW)
        return self.known & ~(far & (self.loop.plant.relative_std[:, 0, 0] > _VISIBLE_STD))


@styled()
def nichols(
    loops: Sequence[Loop], requirements: Requirements | None, *, verdict: Verdict | None = None, ax: Axes | None = None
) -> Axes:
    """Open loops, phase against magnitude, with the region that |S|'s limit forbids and the required margins.

    Curves of a stable loop keep the critical point (-180 degrees, 0 dB) and its repeats on their left as frequency
    rises. Grey contours are of constant |S| (solid) and |T| (dashed). The worst operating point is thick and named, by
    `verdict` where there is one; regions about some of its lines hold L in 95 %, each by itself, and dots are its lines
    as they were measured. Lines whose phase noise hides are faint dots. Without `ax` a key stands below.
    """
    needs_loops(loops)
    own = ax is None
    ax = axes_or_new(ax, (FULL_WIDTH_IN, 5.4))
    key = key_of([loop.plant for loop in loops])
    curves = [_curve(x, curve(look, k, len(loops))) for k, (x, look) in enumerate(zip(loops, key.looks, strict=True))]
    worst = worst_of(loops, verdict)
    for k, one in enumerate(curves):
        if k != worst.index:
            draw_known(ax, one.phase_deg, one.size_db, one.drawn, **one.look)
    entries = _draw_worst(ax, curves[worst.index], len(loops))
    _axes(ax)
    entries += _regions(ax, curves, worst)
    if curves[worst.index].known.any():
        entries.append(("frequency [Hz]", {"linestyle": "none", **_TICK}))
    closest = None if requirements is None else closest_db(requirements)
    entries = [*CONTOUR_ENTRIES, *([] if requirements is None else forbidden_entries(requirements, closest)), *entries]
    _guides(ax, curves[worst.index], worst, requirements, entries)
    if own:
        place_key(figure_of(ax), key)
        head(figure_of(ax), title_of("Open loop", loops), worst_text(loops, worst, verdict), key.common)
    return ax


def _guides(ax: Axes, one: _Curve, worst: Worst, required: Requirements | None, entries: Sequence[Entry]) -> None:
    """Words where there is room for them: notes, the worst point's name, the contours' levels."""
    size_in = (6.35, 4.3)  # what is left of the figure for the axes, about
    room = LabelRoom(ax, size_in)
    closest = None if required is None else closest_db(required)
    if required is None:
        centre_marks(ax)
    else:
        forbidden(ax, room, required, closest)
    loc = corner_with_room(ax, room, entries)
    room.add_corner(loc, entries)
    _name(ax, room, one, worst)
    _frequencies(ax, room, one)
    contours(ax, room, closest)
    place_entries(ax, entries, loc)


def _curve(loop: Loop, look: dict[str, Any]) -> _Curve:
    phase, known = loop_phase_deg(loop)
    return _Curve(loop, phase, db(loop.L), known, look)


def _draw_worst(ax: Axes, one: _Curve, count: int) -> list[Entry]:
    """The worst curve thick on black, above its lines as they were measured; alone it is an ordinary line."""
    entries: list[Entry] = []
    look = one.look | {"linewidth": 1.2}
    if count > 1:
        look = standing_out(one.look)
        entries.append((f"worst: {named(one.loop)}", shown(look)))
    if one.loop.raw is not None:
        dots: dict[str, Any] = {"color": "0.45", "linestyle": "none", "marker": ".", "markersize": 2.5}
        dots["markeredgewidth"] = 0.0
        ax.add_artist(Line2D(*_measured(one), gid="measured", zorder=1.9, **dots))
        entries.append(
            ("its frequencies as measured" if count > 1 else "frequencies as measured", dots | {"markersize": 4.0})
        )
    draw_known(ax, one.phase_deg, one.size_db, one.drawn, **look)
    return entries


def _measured(one: _Curve) -> tuple[Array, Array]:
    """L on the lines as they were measured, at most `DOTS` of them, on the branch of the smoothed curve."""
    raw = one.loop.raw
    assert raw is not None
    rows = np.unique(np.linspace(0, raw.frequency_hz.size - 1, DOTS).astype(int))
    f = raw.frequency_hz[rows]
    L = raw.siso[rows] * one.loop.controller.response(f)
    near = np.interp(np.log(f), np.log(one.loop.frequency_hz), one.phase_deg)
    return nearest_branch(deg(np.angle(L)), near), db(L)


def _axes(ax: Axes) -> None:
    """Limits around what lies within 40 dB of the 0 dB line; the critical point always shows."""
    xy = np.concatenate([np.asarray(line.get_xydata()) for line in ax.lines if line.get_gid() not in _FAINT])
    xy = xy[np.isfinite(xy).all(axis=1) & (np.abs(xy[:, 1]) <= _REACH_DB)]
    xy = np.vstack([xy, [[-225.0, 10.0], [-135.0, -20.0]]])
    (x_low, y_low), (x_high, y_high) = xy.min(axis=0), xy.max(axis=0)
    ax.set_xlim(90.0 * np.floor((x_low - 5.0) / 90.0), 90.0 * np.ceil((x_high + 5.0) / 90.0))
    ax.set_ylim(10.0 * np.floor(y_low / 10.0), 10.0 * np.ceil(y_high / 10.0))
    ax.xaxis.set_major_locator(MultipleLocator(90.0))
    ax.xaxis.set_minor_locator(MultipleLocator(45.0))
    ax.set_xlabel("open-loop phase [deg]")
    ax.set_ylabel("open-loop magnitude |L| [dB]")


def _regions(ax: Axes, curves: Sequence[_Curve], worst: Worst) -> list[Entry]:
    """95 % regions on lines of the worst loop and at the nearest line of the next worst ones."""
    distance = [float(np.min(np.abs(1.0 + one.loop.L))) for one in curves]
    others = [k for k in np.argsort(distance) if k != worst.index][:NEXT_WORST]
    heights = _regions_of(ax, curves[worst.index], REGIONS)
    for k in others:
        heights += _regions_of(ax, curves[k], 1)
    style: dict[str, Any] = {"color": COLOURS[5], "alpha": 0.6, "linewidth": 5.0, "solid_capstyle": "round"}
    return [("95 % of L at a frequency", style)] if max(heights, default=0.0) > _SEEN_DB else []


def _regions_of(ax: Axes, one: _Curve, count: int) -> list[float]:
    """Regions on some lines; their heights in dB."""
    error = np.abs(one.loop.C) * np.sqrt(one.loop.plant.variance[:, 0, 0])
    heights = []
    for k in chosen_lines(one.loop, one.phase_deg, one.known & (error > 0.0), count):
        edge = np.column_stack(error_region(complex(one.loop.L[k]), float(error[k]), float(one.phase_deg[k])))
        if np.isfinite(edge).all():
            face: dict[str, Any] = {"facecolor": COLOURS[5], "alpha": 0.6, "linewidth": 0.0, "zorder": 2.75}
            ax.add_artist(Polygon(edge, gid="region", **face))  # the limits stand
            ax.add_artist(Polygon(edge, fill=False, linewidth=0.5, edgecolor="0.15", zorder=3.0, gid="region edge"))
            heights.append(float(np.ptp(edge[:, 1])))
    return heights


def chosen_lines(loop: Loop, phase_deg: Array, known: np.ndarray, count: int) -> list[int]:
    """The line nearest to -1 and up to `count` - 1 more with |L| within 15 dB of 1, evenly spread along the curve."""
    size = db(loop.L)
    rows = np.flatnonzero(known & (np.abs(size) <= REGION_DB))
    if not rows.size:
        return []
    nearest = int(rows[np.argmin(np.abs(1.0 + loop.L[rows]))])
    way = np.concatenate([[0.0], np.cumsum(np.hypot(np.diff(phase_deg[rows]) / 45.0, np.diff(size[rows]) / 10.0))])
    spread = np.searchsorted(way, np.linspace(0.0, way[-1], count + 1)[1:-1])
    return sorted({nearest, *(int(rows[k]) for k in spread)})


def _name(ax: Axes, room: LabelRoom, one: _Curve, worst: Worst) -> None:
    """A dot where the worst curve is worst, with its frequency beside it where there is room."""
    k = int(np.argmin(np.abs(one.loop.frequency_hz - worst.at_hz)))
    x, y = float(one.phase_deg[k]), float(one.size_db[k])
    ax.plot([x], [y], "o", color="black", markersize=4.5, scalex=False, scaley=False, zorder=4.0, gid="worst")
    around = room.around(x, y, 0.4)
    best = room.emptiest(around[:, 0], around[:, 1])
    if best is None:
        return
    place = (float(around[best, 0]), float(around[best, 1]))
    arrow = {"arrowstyle": "-", "color": "black", "linewidth": 0.7, "shrinkA": 0.0, "shrinkB": 2.0}
    ax.annotate(f"{worst.at_hz:.3g} Hz", (x, y), place, zorder=4.1, arrowprops=arrow, **_word(7.5))
    room.add_box(*place, 0.55, 0.15)


def _frequencies(ax: Axes, room: LabelRoom, one: _Curve) -> None:
    """Ticks at 1, 2 and 5 Hz and their decades along the worst curve, with words where there is room."""
    f, known = one.loop.frequency_hz, one.known
    decades = 10.0 ** np.arange(np.floor(np.log10(f[0])), np.ceil(np.log10(f[-1])))
    for wanted in (decades[:, None] * (1.0, 2.0, 5.0)).ravel():
        k = int(np.argmin(np.abs(np.log(f / wanted))))
        if not known[k] or abs(f[k] / wanted - 1.0) > 0.03:
            continue
        around = room.around(one.phase_deg[k], one.size_db[k], 0.13)[:24]
        best = room.emptiest(around[:, 0], around[:, 1])
        if best is None or room.room_in(around[best]) < 0.1:
            continue
        free: dict[str, Any] = {"scalex": False, "scaley": False, "zorder": 3.5}
        ax.plot(one.phase_deg[k], one.size_db[k], gid="frequency", **free, **_TICK)
        ax.text(around[best, 0], around[best, 1], f"{wanted:g}", zorder=3.4, **_word(6.5))
        room.add_box(around[best, 0], around[best, 1], 0.3, 0.1)


def _word(size: float) -> dict[str, Any]:
    box = {"facecolor": "white", "edgecolor": "none", "pad": 0.5, "alpha": 0.8}
    return {"in_layout": False, "fontsize": size, "ha": "center", "va": "center", "bbox": box}


@styled()
def nyquist(
    loops: Sequence[Loop], requirements: Requirements | None, *, verdict: Verdict | None = None, ax: Axes
) -> Axes:
    """L at all operating points for positive frequencies, the worst thick, with the unit circle about 0.

    Red is the circle about -1 that a required modulus margin (the least |1 + L|) keeps clear; a limit on |S| is one of
    its inverse. What lies outside of the frame is left out.
    """
    needs_loops(loops)
    key = key_of([loop.plant for loop in loops])
    for loop, look in zip(loops, looks_of(key, worst_of(loops, verdict).index), strict=True):
        ax.plot(loop.L.real, loop.L.imag, **look)
    ax.add_patch(Circle((0.0, 0.0), 1.0, fill=False, color=QUIET, linewidth=0.7))
    if radius := _radius(requirements):
        ax.add_patch(Circle((-1.0, 0.0), radius, facecolor=LIMIT, alpha=0.2, edgecolor="none", gid="forbidden"))
    ax.plot([-1.0], [0.0], "+", color="black", markersize=7.0)
    # what is shown of the complex plane: -1 and the unit circle with room about them
    real, imaginary = (-3.0, 1.5), (-2.25, 2.25)
    ax.set(xlim=real, ylim=imaginary, xlabel="real part of L", ylabel="imaginary part of L", aspect="equal")
    ax.set_title(title_of("Nyquist plot", loops), loc="left", fontsize=9.0)
    return ax


def _radius(required: Requirements | None) -> float:
    """Least |1 + L| that requirements allow, 0 without one."""
    if required is None:
        return 0.0
    peak_db = required.sensitivity_peak_db
    return max(required.modulus_margin or 0.0, 0.0 if peak_db is None else 10.0 ** (-peak_db / 20.0))
