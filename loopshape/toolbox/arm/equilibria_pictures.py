"""Pictures of where the plant can rest: contours over two pressures, or over angle and summed pressure."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.path import Path

from loopshape.core.units import Array
from loopshape.view.labels import numbers, quantity
from loopshape.view.style import COLOURS, axes_or_new, styled

Curve = Callable[[Array, Array], Array]
Points = Sequence[Mapping[str, float]]
_SIZE = (4.6, 4.4)


@styled()
def contours_by_pressures(
    p_a_bar: Array,
    p_b_bar: Array,
    theta2_deg: Array,
    *,
    ax: Axes | None = None,
    points: Points = (),
) -> Axes:
    """Contours of the angle (n, m) and of p_AB over p_A (m,) and p_B (n,); NaN where nothing is in equilibrium.

    `points` with the keys `p_a_bar` and `p_b_bar` are marked. As figure 4.7 of van den Brink, DCT 2007.002.
    """
    ax = axes_or_new(ax, _SIZE)
    total = np.asarray(p_b_bar)[:, None] + np.asarray(p_a_bar)[None, :]
    _frame(ax, p_a_bar, p_b_bar, "p_a_bar", "p_b_bar")
    ax.set_aspect("equal")
    _contours(ax, p_a_bar, p_b_bar, total, 0.2, COLOURS[1], "--", lambda x, y: x - y - 0.12)
    _contours(ax, p_a_bar, p_b_bar, theta2_deg, 10.0, COLOURS[0], "-", lambda x, y: x + y - 1.32)
    _mark(ax, points, "p_a_bar", "p_b_bar")
    _legend(ax, {quantity("theta2_deg"): (COLOURS[0], "-"), quantity("p_ab_bar"): (COLOURS[1], "--")}, bool(points))
    return ax


@styled()
def contours_by_angle(
    theta2_deg: Array,
    p_ab_bar: Array,
    p_a_bar: Array,
    p_b_bar: Array,
    *,
    ax: Axes | None = None,
    points: Points = (),
) -> Axes:
    """Contours of p_A and p_B (n, m) over the angle (m,) and p_AB (n,); NaN where nothing is in equilibrium.

    `points` with the keys `theta2_deg` and `p_ab_bar` are marked. As figure 4.8 of van den Brink, DCT 2007.002.
    """
    ax = axes_or_new(ax, _SIZE)
    _frame(ax, theta2_deg, p_ab_bar, "theta2_deg", "p_ab_bar")
    _contours(ax, theta2_deg, p_ab_bar, p_a_bar, 0.1, COLOURS[0], "-", lambda x, y: x - 0.94)
    _contours(ax, theta2_deg, p_ab_bar, p_b_bar, 0.1, COLOURS[1], "--", lambda x, y: x - 0.06)
    _mark(ax, points, "theta2_deg", "p_ab_bar")
    _legend(ax, {quantity("p_a_bar"): (COLOURS[0], "-"), quantity("p_b_bar"): (COLOURS[1], "--")}, bool(points))
    return ax


def _frame(ax: Axes, x: Array, y: Array, x_column: str, y_column: str) -> None:
    ax.set_xlim(float(np.min(x)), float(np.max(x)))
    ax.set_ylim(float(np.min(y)), float(np.max(y)))
    ax.set_xlabel(quantity(x_column))
    ax.set_ylabel(quantity(y_column))


def _contours(ax: Axes, x: Array, y: Array, z: Array, step: float, colour: str, dash: str, line: Curve) -> None:
    """Labelled contours at whole steps, the labels along a line across them; nothing where the values hold none."""
    levels = _levels(np.asarray(z, dtype=float), step)
    if not levels.size:
        return
    masked = np.ma.masked_invalid(z)
    lines = ax.contour(x, y, masked, levels=levels, colors=[colour], linestyles=[dash], linewidths=0.9)
    places = _places(ax, lines.get_paths(), line)
    texts = dict(zip(lines.levels, numbers(list(lines.levels)), strict=True))
    ax.clabel(lines, fmt=texts, fontsize=7.0, inline_spacing=3.0, manual=places)


def _places(ax: Axes, paths: Sequence[Path], line: Curve) -> list[tuple[float, float]]:
    """The vertex of each contour nearest to the zero of `line`, a function of fractions of what they span.

    A contour that ends far from that line, or runs along the frame only, stays without a label.
    """
    groups = [np.asarray(path.vertices) for path in paths if len(path.vertices)]  # type: ignore[arg-type]
    if not groups:
        return []
    every = np.concatenate(groups)
    low, span = every.min(axis=0), np.ptp(every, axis=0) + 1e-12
    frame = np.array([ax.get_xlim(), ax.get_ylim()])
    places = []
    for vertices in groups:
        inside = np.abs((vertices - frame[:, 0]) / (frame[:, 1] - frame[:, 0]) - 0.5).max(axis=1) < 0.44
        away = np.where(inside, np.abs(line(*((vertices - low) / span).T)), np.inf)
        k = int(np.argmin(away))
        if away[k] < 0.45:
            places.append((float(vertices[k, 0]), float(vertices[k, 1])))
    return places


def _levels(z: Array, step: float, most: int = 14) -> Array:
    """Whole multiples of the step, or of 2 or 5 steps, that lie within the values."""
    seen = z[np.isfinite(z)]
    if not seen.size or seen.min() == seen.max():
        return np.empty(0)
    for factor in (1, 2, 5, 10, 20, 50, 100):
        unit = factor * step
        levels = np.round(np.arange(np.ceil(seen.min() / unit), np.floor(seen.max() / unit) + 1.0) * unit, 9)
        if levels.size <= most:
            return levels + 0.0
    return np.linspace(seen.min(), seen.max(), most)


def _mark(ax: Axes, points: Points, x: str, y: str) -> None:
    chosen = [p for p in points if x in p and y in p]
    look: dict[str, Any] = {"marker": "o", "markersize": 4.0, "linestyle": "none", "gid": "points"}
    ax.plot([p[x] for p in chosen], [p[y] for p in chosen], color="0.1", scalex=False, scaley=False, **look)


def _legend(ax: Axes, entries: Mapping[str, tuple[str, str]], marked: bool) -> None:
    looks: list[dict[str, Any]] = [{"color": c, "linestyle": d, "label": t} for t, (c, d) in entries.items()]
    handles = [Line2D([], [], linewidth=0.9, **look) for look in looks]
    if marked:
        handles.append(Line2D([], [], color="0.1", marker="o", linestyle="none", label="operating points"))
    ax.legend(handles=handles, loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=3, columnspacing=1.2)
