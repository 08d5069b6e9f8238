"""Sensitivity atlas: |S| over frequency at every operating point, and each margin over two operating coordinates."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import BoundaryNorm, ListedColormap, to_hex, to_rgb
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Rectangle
from matplotlib.ticker import FixedLocator

from loopshape.core.outcomes import ClosedLoop, Outcome
from loopshape.core.units import Array, db
from loopshape.data.requirement.requirements import LIMIT_OF, Requirements
from loopshape.data.result.margins import Margins
from loopshape.data.result.verdict import RequirementResult, Verdict
from loopshape.loop.loop import Loop
from loopshape.loop.points import margins_of, point_outcome, worst_of
from loopshape.view.key import key_of, varying
from loopshape.view.labels import number, numbers, quantity
from loopshape.view.plots.curves import frequency_axis, shown_band_hz
from loopshape.view.plots.nichols_guides import closest_db
from loopshape.view.style import FULL_WIDTH_IN, head, styled
from loopshape.view.verdict.loop_parts import needs_loops, number3, title_of, worst_text
from loopshape.view.verdict.verdicts import MARKS, mark_entries, with_stability

#: levels of |S| in dB that part the colours; the limit takes the place of one near it
LEVELS_DB = (-30.0, -20.0, -10.0, -6.0, -3.0, 0.0, 3.0, 6.0, 9.0, 12.0)
#: from much room to none, then missed by ever more; each darker than the one before, so that grey paper keeps the order
_ROOM, _NEAR, _MISSED = ("#FFFFFF", "#B4D4EC"), ("#F6C37A", "#EFA94A"), ("#E8953A", "#B9410A", "#4A0F00")


@dataclass(frozen=True, eq=False)
class Row:
    """One operating point of the atlas: |S| (nf,) in dB on its own lines, its peak with interval, and the outcome."""

    name: str
    frequency_hz: Array
    size_db: Array
    peak_db: float
    peak_hz: float
    interval: tuple[float, float] | None
    outcome: Outcome
    stable: ClosedLoop


@styled()
def sensitivity_atlas(
    loops: Sequence[Loop], requirements: Requirements | None, *, verdict: Verdict | None = None
) -> Figure:
    """|S| in dB over frequency, one row an operating point, sorted by the operating coordinates that vary.

    Thin lines part cells below 0 dB from those above it, and cells beyond the limit are framed. A mark stands on each
    peak, its value with the 95 % interval beside the row (with a verdict bias-corrected; a peak above the last line
    is marked there). An unstable row is hatched: there |S| means nothing. Each row has its own lines; where these leave
    a gap the row does. Where exactly two coordinates vary, and the verdict asks for something, maps of each requirement
    over both stand below, with values in the cells.
    """
    needs_loops(loops)
    common = key_of([loop.plant for loop in loops]).common
    order, worst = sorted_points(loops), worst_of(loops, verdict)
    rows = [_row(loops[k], k, requirements, verdict) for k in order]
    below = 0 if verdict is None else _map_rows(loops, verdict)
    heights = (1.1 + max(0.17 * len(rows), 0.35), 1.75 * below)
    figure = Figure(figsize=(FULL_WIDTH_IN, 0.5 + sum(heights)))
    grid = figure.add_gridspec(2 if below else 1, 1, height_ratios=heights if below else heights[:1])
    ax = figure.add_subplot(grid[0])
    _heat(figure, ax, rows, None if requirements is None else closest_db(requirements))
    frequency_axis(ax, *shown_band_hz(*(loop.plant for loop in loops)))
    _row_names(ax, loops, rows, order)
    _peaks(ax, rows, order.index(worst.index))
    if below and verdict is not None:
        panels = grid[1].subgridspec(below, _COLUMNS).subplots(squeeze=False)
        _draw_maps(list(panels.ravel()), loops, verdict)
    head(figure, title_of("Sensitivity |S|", loops), worst_text(loops, worst, verdict), common)
    return figure


def sorted_points(loops: Sequence[Loop]) -> list[int]:
    """Order of the rows: by the operating coordinates that vary, in their order; as they come where none does."""
    keys = varying([loop.plant for loop in loops])
    return sorted(range(len(loops)), key=lambda k: tuple(loops[k].plant.operating_point[name] for name in keys))


def _row(loop: Loop, k: int, required: Requirements | None, verdict: Verdict | None) -> Row:
    use = loop.plant.valid if loop.plant.valid.any() else np.ones(loop.frequency_hz.size, dtype=bool)
    f, size = loop.frequency_hz[use], db(loop.S)[use]
    margins, limit = margins_of(loop, k, verdict), None if required is None else closest_db(required)
    name = loop.plant.recording or f"frf {k + 1}"
    peak, at_hz, interval = float(size.max()), float(f[np.argmax(size)]), None
    outcome = Outcome.PASSED if limit is None or peak <= limit else Outcome.FAILED
    if margins is not None:
        read = margins["sensitivity_peak_db"]
        peak, at_hz = read.value, max(at_hz if read.at_hz is None else read.at_hz, float(f[0]))
        interval = read.interval
        outcome = Outcome.PASSED if limit is None else point_outcome(margins, "sensitivity_peak_db", limit)
    stable = ClosedLoop.STABLE if margins is None else margins.stable
    return Row(name, f, size, peak, at_hz, interval, with_stability(outcome, margins), stable)


def _heat(figure: Figure, ax: Axes, rows: Sequence[Row], limit_db: float | None) -> None:
    """The cells, frames about those beyond the limit, and the scale of colours."""
    levels = levels_with(limit_db)
    colours = _colours(levels, limit_db)
    norm = BoundaryNorm(levels, len(levels) + 1, extend="both")
    look: dict[str, Any] = {"cmap": ListedColormap(colours), "norm": norm, "rasterized": True}
    mesh = None
    for k, row in enumerate(rows):
        edges, values = cells(row.frequency_hz, row.size_db)
        mesh = ax.pcolormesh(edges, [k - 0.46, k + 0.46], values[None], gid=row.name, **look)
        ax.vlines(zero_crossings(edges, values), k - 0.46, k + 0.46, color="0.25", linewidth=0.7, gid="0 dB")
        for low, high in [] if limit_db is None else beyond(edges, values, limit_db):
            frame: dict[str, Any] = {"fill": False, "edgecolor": "black", "linewidth": 1.0, "zorder": 3.0}
            ax.add_patch(Rectangle((low, k - 0.46), high - low, 0.92, gid="beyond the limit", **frame))
        if row.stable is not ClosedLoop.STABLE:
            face: dict[str, Any] = {"facecolor": "none", "edgecolor": "0.25", "linewidth": 0.0, "zorder": 2.5}
            hatch = "////" if row.stable is ClosedLoop.UNSTABLE else "...."
            ax.axhspan(k - 0.46, k + 0.46, hatch=hatch, gid=row.stable, **face)
    ax.set_facecolor("0.86")
    ax.grid(False)
    assert mesh is not None
    bar = figure.colorbar(mesh, ax=ax, location="top", aspect=60.0, shrink=0.75, pad=0.02, ticks=FixedLocator(levels))
    bar.ax.set_xticklabels([number(level) for level in levels], fontsize=7.0)
    bar.ax.tick_params(which="both", length=0.0)
    text = "" if limit_db is None else f", limit {limit_db:.3g} dB: cells beyond it are framed"
    bar.set_label(f"|S| [dB]{text}", fontsize=8.0)
    bar.ax.axvline(0.0, color="0.25", linewidth=0.7)
    if limit_db is not None:
        bar.ax.axvline(limit_db, color="black", linewidth=2.0)


def levels_with(limit_db: float | None) -> list[float]:
    """The levels that part colours, rising, the limit among them."""
    if limit_db is None:
        return list(LEVELS_DB)
    return sorted({x for x in LEVELS_DB if abs(x - limit_db) >= 1.5 or x == 0.0} | {float(limit_db)})


def _colours(levels: Sequence[float], limit_db: float | None) -> list[str]:
    """A colour for each step between levels and beyond both ends: blues below 0 dB, then light and dark oranges."""
    limit = 6.0 if limit_db is None else limit_db
    lower = [-np.inf, *levels]
    damped = sum(1 for x in lower if x < 0.0)
    near = sum(1 for x in lower if 0.0 <= x < limit)
    return [*room_colours(damped), *near_colours(near), *missed_colours(len(lower) - damped - near + 1)[1:]]


def cells(frequency_hz: Array, values: Array) -> tuple[Array, Array]:
    """Edges (n + 1,) in Hz of cells about lines, and their values (n,): nan where lines leave a gap."""
    f = np.asarray(frequency_hz, dtype=float)
    if f.size == 1:
        return np.array([f[0] / 1.03, f[0] * 1.03]), np.asarray(values)
    middle, step = np.sqrt(f[1:] * f[:-1]), np.diff(f)
    around = np.minimum(np.append(step[1:], step[-1]), np.insert(step[:-1], 0, step[0]))
    gap = step > 4.0 * around  # lines further apart than so many times their neighbours leave a gap
    low, high = f[:-1] + np.minimum(0.5 * around, 0.5 * step), f[1:] - np.minimum(0.5 * around, 0.5 * step)
    edges, out = [max(f[0] - 0.5 * step[0], f[0] / (middle[0] / f[0]))], []
    for k, value in enumerate(values):
        out.append(value)
        if k == f.size - 1:
            edges.append(f[-1] * (f[-1] / middle[-1]))
        elif gap[k]:
            edges += [low[k], high[k]]
            out.append(np.nan)
        else:
            edges.append(middle[k])
    return np.array(edges), np.array(out)


def beyond(edges: Array, values: Array, limit_db: float) -> list[tuple[float, float]]:
    """Ends in Hz of the unbroken runs of cells above a limit."""
    over = np.concatenate([[False], np.nan_to_num(values, nan=-np.inf) > limit_db, [False]]).astype(int)
    turns = np.flatnonzero(np.diff(over))
    return [(float(edges[a]), float(edges[b])) for a, b in turns.reshape(-1, 2)]


def zero_crossings(edges: Array, values: Array) -> Array:
    """Edges in Hz between cells below 0 dB and cells above it."""
    return np.asarray(edges[1:-1][np.sign(values[1:]) * np.sign(values[:-1]) < 0.0])


def _row_names(ax: Axes, loops: Sequence[Loop], rows: Sequence[Row], order: Sequence[int]) -> None:
    """Operating coordinates beside each row; recordings where they do not vary or do not tell the rows apart."""
    keys = varying([loop.plant for loop in loops])
    columns = [numbers([loops[k].plant.operating_point[key] for k in order]) for key in keys]
    names = [", ".join(parts) for parts in zip(*columns, strict=True)]
    if not keys or len(keys) > 3 or len(set(names)) < len(rows):
        names, keys = [row.name for row in rows], []
    ax.set_ylim(len(rows) - 0.5, -0.5)
    ax.set_yticks(range(len(rows)), names, fontsize=7.0)
    ax.tick_params(axis="y", length=0.0)
    text, left = ", ".join(quantity(key) for key in keys) if keys else "recording", -4.4 * max(map(len, names)) - 14.0
    look: dict[str, Any] = {"rotation": 90.0, "ha": "center", "va": "center", "annotation_clip": False}
    ax.annotate(text, (0.0, 0.5), (left, 0.0), "axes fraction", "offset points", fontsize=9.0, gid="rows", **look)


def _peaks(ax: Axes, rows: Sequence[Row], worst: int) -> None:
    """A mark on each peak, and again beside the row with the value and its interval; the worst row is bold."""
    low, high = ax.get_xlim()
    beside = ax.get_yaxis_transform()
    for k, row in enumerate(rows):
        mark = MARKS[row.outcome] | {"linestyle": "none", "zorder": 4.0, "clip_on": False}
        on_map = mark | {"color": "black"} | ({"markeredgecolor": "white"} if row.outcome is Outcome.PASSED else {})
        on_map |= {"markersize": 4.5, "markeredgewidth": 1.6 if row.outcome is Outcome.FAILED else 0.7}
        if row.outcome is Outcome.UNDECIDED:
            on_map |= {"markeredgecolor": "black", "markerfacecolor": "white"}
        ax.plot(float(np.clip(row.peak_hz, low, high)), k, scalex=False, scaley=False, gid="peak", **on_map)
        ax.plot(1.02, k, transform=beside, scalex=False, scaley=False, gid=row.outcome, **mark)
        ax.text(1.035, k, _peak_text(row), transform=beside, fontsize=7.0, va="center", gid="peak value")
    if len(rows) > 1:
        ax.get_yticklabels()[worst].set_fontweight("bold")
    ax.annotate("peak |S| [dB] (95 %)", (1.01, 1.0), (0.0, 3.0), "axes fraction", "offset points", fontsize=7.0)
    entries = mark_entries({row.outcome for row in rows})
    handles = [Line2D([], [], **look) for _, look in entries]
    style: dict[str, Any] = {"loc": "upper left", "bbox_to_anchor": (1.0, 0.0), "fontsize": 7.0, "borderaxespad": 0.2}
    ax.legend(handles, [text for text, _ in entries], **style)


def _peak_text(row: Row) -> str:
    if row.stable is not ClosedLoop.STABLE:
        return {"unstable": "unstable"}.get(row.stable, f"{number3(row.peak_db, 2)}, stability undecided")
    ends = "" if row.interval is None else f" ({number3(row.interval[0], 2)} to {number3(row.interval[1], 2)})"
    return f"{number3(row.peak_db, 2)}{ends}"


_COLUMNS = 3
_SHADES = 32
_HATCHES = {"passed": None, "undecided": "....", "failed": "////"}


def _map_rows(loops: Sequence[Loop], verdict: Verdict) -> int:
    """Rows of maps that a verdict gives: none unless two coordinates vary and tell the operating points apart."""
    return -(-len(verdict.lines) // _COLUMNS) if _coordinates(loops) is not None else 0


def _coordinates(loops: Sequence[Loop]) -> tuple[str, str] | None:
    keys = varying([loop.plant for loop in loops])
    if len(keys) != 2:
        return None
    places = {tuple(loop.plant.operating_point[key] for key in keys) for loop in loops}
    return (keys[0], keys[1]) if len(places) == len(loops) else None


@styled()
def _draw_maps(panels: Sequence[Axes], loops: Sequence[Loop], verdict: Verdict) -> None:
    """A map for each line of a verdict; panels left over are taken away."""
    for ax, line in zip(panels, verdict.lines, strict=False):
        _point_map(loops, verdict, line, ax=ax)
    for ax in panels[len(verdict.lines) :]:
        ax.remove()


@styled()
def _point_map(loops: Sequence[Loop], verdict: Verdict, line: RequirementResult, *, ax: Axes) -> Axes:
    """One requirement's quantity over the two coordinates that vary: cells lighter the more room they leave.

    Cells that miss it are dark and hatched, undecided ones dotted; the verdict's worst cell is framed.
    """
    keys = _coordinates(loops)
    assert keys is not None
    found = [(loop, margins_of(loop, k, verdict)) for k, loop in enumerate(loops)]
    known = [(loop, m) for loop, m in found if m is not None]
    xs, ys = (sorted({loop.plant.operating_point[key] for loop in loops}) for key in keys)
    sign = LIMIT_OF[line.quantity].sign
    slack = np.array([sign * (m[line.quantity].value - line.required) for _, m in known])
    largest = float(np.max(np.abs(slack[np.isfinite(slack)]), initial=1e-12))
    for (loop, margins), room in zip(known, slack, strict=True):
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
    text = f"{limit.short} {sense} {number(line.required)}{unit}"
    ax.set_title(text, loc="left", fontsize=7.5, pad=2.5)
    return ax


def _cell(ax: Axes, at: tuple[int, int], margins: Margins, line: RequirementResult, room: float) -> None:
    outcome = with_stability(point_outcome(margins, line.quantity, line.required), margins)
    colour = _colour(outcome, room)
    edge = ink_on(colour) if _HATCHES[outcome] else "0.55"
    look: dict[str, Any] = {"facecolor": colour, "edgecolor": edge, "linewidth": 0.4, "hatch": _HATCHES[outcome]}
    with mpl.rc_context({"hatch.linewidth": 0.5}):
        ax.add_patch(Rectangle((at[0] - 0.5, at[1] - 0.5), 1.0, 1.0, gid=outcome, in_layout=False, **look))
    value = margins[line.quantity].value
    text = "unst." if margins.stable is ClosedLoop.UNSTABLE else number3(value)
    box = None if _HATCHES[outcome] is None else {"facecolor": colour, "edgecolor": "none", "pad": 0.6}
    place: dict[str, Any] = {"ha": "center", "va": "center", "fontsize": 6.5, "in_layout": False}
    ax.text(*at, text, color=ink_on(colour), bbox=box, gid="value", **place)


def _colour(outcome: Outcome, room: float) -> str:
    """Colour of a cell whose room (negative: missed) is a share of the largest of its map."""
    if outcome is Outcome.UNDECIDED:
        return near_colours(1)[0]
    if outcome is Outcome.FAILED:
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


def room_colours(steps: int) -> list[str]:
    """Colours of `steps` rising steps with room left, from white."""
    return _ramp(_ROOM, steps)


def near_colours(steps: int) -> list[str]:
    """Colours of `steps` rising steps with little room left."""
    return _ramp(_NEAR, steps)


def missed_colours(steps: int) -> list[str]:
    """Colours of `steps` rising steps beyond a limit."""
    return _ramp(_MISSED, steps)


def _ramp(nodes: tuple[str, ...], steps: int) -> list[str]:
    """`steps` colours evenly along some nodes."""
    at = np.linspace(0.0, 1.0, len(nodes))
    rgb = np.array([to_rgb(node) for node in nodes])
    t = np.linspace(0.0, 1.0, steps) if steps > 1 else np.array([0.5])
    mixed = np.stack([np.interp(t, at, rgb[:, k]) for k in range(3)], axis=1)
    return [to_hex((r, g, b)) for r, g, b in mixed]


def luminance(colour: str) -> float:
    """Relative luminance in [0, 1] (ITU-R BT.709, of linearised sRGB): what grey paper keeps of a colour."""
    rgb = np.array(to_rgb(colour))
    linear = np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4)
    return float(linear @ (0.2126, 0.7152, 0.0722))


def ink_on(colour: str) -> str:
    """Black or white, whichever reads on a colour."""
    return "black" if luminance(colour) > 0.25 else "white"
