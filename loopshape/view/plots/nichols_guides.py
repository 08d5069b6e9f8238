"""What a Nichols chart holds curves against: contours of |S| and |T|, what is forbidden, the required margins.

Nichols coordinates are open-loop phase in degrees and magnitude in dB.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Polygon

from loopshape.core.units import TWO_PI, Array, ComplexArray, db, deg, from_db
from loopshape.data.requirement.requirements import Requirements
from loopshape.view.key import Entry, LabelRoom
from loopshape.view.labels import number
from loopshape.view.style import LIMIT

LEVELS_DB = (12.0, 6.0, 3.0, 0.0, -6.0, -12.0, -20.0)
_S: dict[str, Any] = {"color": "0.66", "linewidth": 0.6, "linestyle": "-"}
_T: dict[str, Any] = {"color": "0.66", "linewidth": 0.7, "linestyle": (0, (5, 3))}
CONTOUR_ENTRIES: tuple[Entry, ...] = (("|S| constant", _S), ("|T| constant", _T))


def closest_db(required: Requirements) -> float | None:
    """The sharper of the limits on |S|'s peak and on the modulus margin, as |S| in dB; None without either."""
    limits = [] if required.sensitivity_peak_db is None else [required.sensitivity_peak_db]
    if required.modulus_margin is not None:
        limits.append(-float(db(required.modulus_margin)))
    limits = [limit for limit in limits if limit > 0.0]
    return min(limits) if limits else None


def contours(ax: Axes, room: LabelRoom, below_db: float | None) -> None:
    """Contours of |S| (solid) and |T| (dashed) at `LEVELS_DB`, those below a limit; labels where there is room."""
    levels = [level for level in LEVELS_DB if below_db is None or level < below_db]
    for name, of, style in (("S", constant_s, _S), ("T", constant_t, _T)):
        for level in levels:
            _contour(ax, room, f"|{name}| {number(level)} dB", of, level, style)


def _contour(
    ax: Axes, room: LabelRoom, text: str, of: Callable[[float], ComplexArray], level_db: float, style: dict[str, Any]
) -> None:
    phase, size = nichols_coordinates(of(level_db))
    places = []
    for shift in turns(*ax.get_xlim()):
        ax.plot(phase + shift, size, scalex=False, scaley=False, zorder=1.5, gid=text, **style)
        places.append(np.column_stack([phase + shift, size])[::6])
    x, y = np.vstack(places).T
    k = room.emptiest(x, y)
    if k is not None and room.room_in(np.array([x[k], y[k]])) > 0.1:
        _label(ax, x[k], y[k], text)
        room.add_box(x[k], y[k], 0.5, 0.1)


def _label(ax: Axes, x: float, y: float, text: str) -> None:
    box = {"facecolor": "white", "edgecolor": "none", "pad": 0.3, "alpha": 0.9}
    style: dict[str, Any] = {"fontsize": 6.0, "ha": "center", "va": "center", "bbox": box, "in_layout": False}
    ax.text(x, y, text, color="0.4", zorder=1.6, clip_on=True, **style)


def forbidden(ax: Axes, room: LabelRoom, required: Requirements, closest: float | None) -> None:
    """The regions that limits of |S| and |T| forbid, and crosses of the required margins, at every critical point."""
    t_limit = required.complementary_peak_db
    for shift in turns(*ax.get_xlim()):
        if closest is not None:
            x, y = _shifted(constant_s(closest), shift)
            region = Polygon(np.column_stack([x, y]), facecolor=LIMIT, alpha=0.14, linewidth=0.0, zorder=1.7)
            ax.add_artist(region)  # `fill` would take its thousand edges one by one for limits that stand
            for share in (0.3, 0.6, 0.8, 1.0):
                room.add(shift - 180.0 + share * (x - shift + 180.0), share * y)
            ax.plot(x, y, color=LIMIT, linewidth=1.1, scalex=False, scaley=False, zorder=2.5, gid="limit |S|")
        if t_limit is not None and t_limit > 0.0:
            x, y = _shifted(constant_t(t_limit), shift)
            style: dict[str, Any] = {"color": LIMIT, "linewidth": 0.9, "linestyle": ":", "zorder": 2.5}
            ax.plot(x, y, scalex=False, scaley=False, gid="limit |T|", **style)
        _cross(ax, required, shift - 180.0)


def forbidden_entries(required: Requirements, closest: float | None) -> list[Entry]:
    """What the notes say of them."""
    entries: list[Entry] = []
    if closest is not None:
        entries.append((f"|S| at most {closest:.3g} dB", {"color": LIMIT, "linewidth": 1.1}))
    if required.complementary_peak_db is not None and required.complementary_peak_db > 0.0:
        entries.append((f"|T| at most {required.complementary_peak_db:g} dB", {"color": LIMIT, "linestyle": ":"}))
    if text := _cross_text(required):
        entries.append((text, {"color": LIMIT, "linewidth": 1.8}))
    return entries


def _shifted(open_loop: ComplexArray, shift_deg: float) -> tuple[Array, Array]:
    phase, size = nichols_coordinates(open_loop)
    return phase + shift_deg, size


def _cross(ax: Axes, required: Requirements, phase_deg: float) -> None:
    """Required margins as a cross at a critical point: left and right the phase, down the gain, up its reduction."""
    style: dict[str, Any] = {"color": LIMIT, "linewidth": 1.8, "solid_capstyle": "butt", "zorder": 2.6}
    free: dict[str, Any] = {"scalex": False, "scaley": False}
    pm, gm, up = required.phase_margin_deg, required.gain_margin_db, required.gain_reduction_margin_db
    if pm is not None:
        ax.plot([phase_deg - pm, phase_deg + pm], [0.0, 0.0], gid="phase margin", **style, **free)
    if gm is not None or up is not None:
        ax.plot([phase_deg, phase_deg], [-(gm or 0.0), up or 0.0], gid="gain margin", **style, **free)
    ax.plot([phase_deg], [0.0], "+", color="black", markersize=7.0, zorder=2.7, gid="critical point", **free)


def _cross_text(required: Requirements) -> str:
    parts = []
    if required.phase_margin_deg is not None:
        parts.append(f"phase ±{required.phase_margin_deg:g} deg")
    if required.gain_margin_db is not None:
        parts.append(f"gain \N{MINUS SIGN}{required.gain_margin_db:g} dB")
    if required.gain_reduction_margin_db is not None:
        parts.append(f"+{required.gain_reduction_margin_db:g} dB")
    return "margins " + ", ".join(parts) if parts else ""


def centre_marks(ax: Axes) -> None:
    """Critical points alone, where nothing is required."""
    for shift in turns(*ax.get_xlim()):
        style: dict[str, Any] = {"color": "black", "markersize": 7.0, "zorder": 2.7, "gid": "critical point"}
        ax.plot([shift - 180.0], [0.0], "+", scalex=False, scaley=False, **style)


#: radius that holds 95 % of a circular error, in its standard deviations sqrt(E|d|²)
_REACH_95 = float(np.sqrt(-np.log(0.05)))


def constant_s(sensitivity_db: float, points: int = 721) -> ComplexArray:
    """Open loops L (points,) with |S| = 1/|1 + L| at a level: a circle around -1, from phase -360 round to 0."""
    edge = 1e-9 if sensitivity_db <= 0.0 else 0.0  # circles around the origin too stay open at its phase jump
    turn = np.linspace(edge, TWO_PI - edge, points)
    return np.asarray(-1.0 + np.exp(1j * turn) / from_db(sensitivity_db))


def constant_t(complementary_db: float, points: int = 721) -> ComplexArray:
    """Open loops L (points,) with |T| = |L|/|1 + L| at a level."""
    edge = 1e-9 if complementary_db <= 0.0 else 0.0
    t = from_db(complementary_db) * np.exp(1j * np.linspace(edge, TWO_PI - edge, points))
    return np.asarray(t / (1.0 - t))


def nichols_coordinates(open_loop: ComplexArray) -> tuple[Array, Array]:
    """Phase in (-360, 0] degrees and magnitude in dB."""
    phase = deg(np.angle(open_loop))
    return np.where(phase > 0.0, phase - 360.0, phase), db(open_loop)


def turns(low_deg: float, high_deg: float) -> list[float]:
    """Whole turns by which something around -180 degrees is repeated to fill a range of phases."""
    first, last = np.floor((low_deg + 180.0) / 360.0), np.ceil((high_deg + 180.0) / 360.0)
    return [360.0 * k for k in range(int(first), int(last) + 1)]


def error_region(centre: complex, deviation: float, phase_deg: float, points: int = 73) -> tuple[Array, Array]:
    """Edge (points,) of the 95 % region of a response with a circular error: phase in degrees and magnitude in dB.

    A circle about `centre` of 1.73 times `deviation` = sqrt(E|d|²), carried over point by point: in these coordinates
    it is bent, not an ellipse. `phase_deg` is the centre's own phase on the branch wanted. Where the circle holds the
    origin the phase is not known: the edge is then nan.
    """
    if _REACH_95 * deviation >= abs(centre):
        return np.full(points, np.nan), np.full(points, np.nan)
    edge = centre + _REACH_95 * deviation * np.exp(1j * np.linspace(0.0, TWO_PI, points))
    return phase_deg + deg(np.angle(edge / centre)), db(edge)
