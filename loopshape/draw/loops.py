"""Pictures of loops at all operating points: Nichols, controller with plant and open loop, sensitivities."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MultipleLocator

from loopshape.draw.contours import constant_s, constant_t, nichols_coordinates, turns
from loopshape.draw.curves import (
    UNTRUSTED,
    draw_trusted,
    fit_decibels,
    fit_degrees,
    frequency_axis,
    hide_inner,
    shown_band_hz,
    unwrapped_deg,
)
from loopshape.draw.key import Entry, Key, count, curve, key_of, place_key, place_notes
from loopshape.draw.labels import decibel, number, ratio, symbol, units_of
from loopshape.draw.style import FULL_WIDTH_IN, LIMIT, QUIET, axes_or_new, figure_of, head, new_figure, styled
from loopshape.errors import WrongUseError
from loopshape.loop import Loop
from loopshape.requirements import Requirements, Verdict
from loopshape.units import ComplexArray, db

LEVELS_DB = (12.0, 6.0, 3.0, 0.0, -6.0, -12.0)
_REACH_DB = 40.0


@styled()
def nichols(loops: Sequence[Loop], requirements: Requirements | None, *, ax: Axes | None = None) -> Axes:
    """Open loops, phase against magnitude, with the region that |S|'s limit forbids and the margins wished.

    Curves of a stable loop keep the critical point (-180 degrees, 0 dB) and its repeats on their left as
    frequency rises. Thin grey contours are of constant |S|. Without `ax` a key stands below.
    """
    _needs_loops(loops)
    own = ax is None
    ax = axes_or_new(ax, (FULL_WIDTH_IN, 5.4))
    key = key_of([loop.plant for loop in loops])
    for k, (loop, look) in enumerate(zip(loops, key.looks, strict=True)):
        use = loop.plant.trusted
        draw_trusted(ax, unwrapped_deg(loop.L, use), db(loop.L), use, **curve(look, k, len(loops)))
    _nichols_axes(ax)
    closest = None if requirements is None else _closest_db(requirements)
    _contours(ax, [level for level in LEVELS_DB if closest is None or level < closest])
    notes: list[Entry] = [("|S| constant", {"color": "0.72", "linewidth": 0.6})]
    if requirements is not None:
        notes += _forbidden(ax, requirements, closest)
    place_notes(ax, notes, "upper left")
    if own:
        place_key(figure_of(ax), key)
        head(figure_of(ax), _title("Open loop", loops), key.common)
    return ax


def _needs_loops(loops: Sequence[Loop]) -> None:
    if not loops:
        raise WrongUseError("a picture of loops needs at least one", "none", "give the loops of a FRF set")


def _nichols_axes(ax: Axes) -> None:
    """Limits around what lies within 40 dB of the 0 dB line; the critical point always shows."""
    xy = np.concatenate([np.asarray(line.get_xydata()) for line in ax.lines if line.get_gid() != UNTRUSTED])
    xy = xy[np.isfinite(xy).all(axis=1) & (np.abs(xy[:, 1]) <= _REACH_DB)]
    xy = np.vstack([xy, [[-225.0, 10.0], [-135.0, -20.0]]])
    (x_low, y_low), (x_high, y_high) = xy.min(axis=0), xy.max(axis=0)
    ax.set_xlim(90.0 * np.floor((x_low - 5.0) / 90.0), 90.0 * np.ceil((x_high + 5.0) / 90.0))
    ax.set_ylim(10.0 * np.floor(y_low / 10.0), 10.0 * np.ceil(y_high / 10.0))
    ax.xaxis.set_major_locator(MultipleLocator(90.0))
    ax.xaxis.set_minor_locator(MultipleLocator(45.0))
    ax.set_xlabel("open-loop phase [deg]")
    ax.set_ylabel("open-loop magnitude |L| [dB]")


def _contours(ax: Axes, levels_db: Sequence[float]) -> None:
    for level in levels_db:
        phase, size = nichols_coordinates(constant_s(level))
        for shift in turns(*ax.get_xlim()):
            style: dict[str, Any] = {"color": "0.72", "linewidth": 0.6, "zorder": 1.5, "gid": f"|S| {level:g} dB"}
            ax.plot(phase + shift, size, scalex=False, scaley=False, **style)
            _contour_label(ax, phase + shift, size, level)


def _contour_label(ax: Axes, phase: np.ndarray, size: np.ndarray, level: float) -> None:
    """The level on its contour: at its left end where closed, else on its right branch."""
    (x_low, x_high), (y_low, y_high) = ax.get_xlim(), ax.get_ylim()
    k = int(np.argmin(phase)) if level > 0.0 else int(0.93 * size.size) if level < 0.0 else int(0.985 * size.size)
    if x_low + 6.0 < phase[k] < x_high - 6.0 and y_low + 1.0 < size[k] < y_high - 1.0:
        box = {"facecolor": "white", "edgecolor": "none", "pad": 0.4, "alpha": 0.85}
        text = f"{number(level)} dB"
        ax.text(phase[k], size[k], text, color="0.5", fontsize=6.5, ha="center", va="center", bbox=box, zorder=1.6)


def _forbidden(ax: Axes, wished: Requirements, closest: float | None) -> list[Entry]:
    """Region and crosses at every critical point in view; the key's entries for them."""
    entries: list[Entry] = []
    for shift in turns(*ax.get_xlim()):
        if closest is not None:
            x, y = nichols_coordinates(constant_s(closest))
            ax.fill(x + shift, y, facecolor=LIMIT, alpha=0.14, linewidth=0.0, zorder=1.7)
            ax.plot(x + shift, y, color=LIMIT, linewidth=1.1, scalex=False, scaley=False, zorder=2.5, gid="limit |S|")
        if wished.complementary_peak_db is not None and wished.complementary_peak_db > 0.0:
            x, y = nichols_coordinates(constant_t(wished.complementary_peak_db))
            ax.plot(x + shift, y, color=LIMIT, linewidth=0.9, linestyle=":", zorder=2.5, gid="limit |T|")
        _cross(ax, wished, shift - 180.0)
    if closest is not None:
        entries.append((f"|S| at most {closest:.3g} dB", {"color": LIMIT, "linewidth": 1.1}))
    if wished.complementary_peak_db is not None and wished.complementary_peak_db > 0.0:
        entries.append((f"|T| at most {wished.complementary_peak_db:g} dB", {"color": LIMIT, "linestyle": ":"}))
    if text := _cross_text(wished):
        entries.append((text, {"color": LIMIT, "linewidth": 1.8}))
    return entries


def _closest_db(wished: Requirements) -> float | None:
    """The sharper of the limits on |S|'s peak and on the modulus margin, as |S| in dB; None without either."""
    limits = [] if wished.sensitivity_peak_db is None else [wished.sensitivity_peak_db]
    if wished.modulus_margin is not None:
        limits.append(-float(db(wished.modulus_margin)))
    limits = [limit for limit in limits if limit > 0.0]
    return min(limits) if limits else None


def _cross(ax: Axes, wished: Requirements, phase_deg: float) -> None:
    """Margins wished as a cross at a critical point: left and right the phase, down the gain, up its reduction."""
    style: dict[str, Any] = {"color": LIMIT, "linewidth": 1.8, "solid_capstyle": "butt", "zorder": 2.6}
    pm, gm, up = wished.phase_margin_deg, wished.gain_margin_db, wished.gain_reduction_margin_db
    if pm is not None:
        ax.plot([phase_deg - pm, phase_deg + pm], [0.0, 0.0], gid="phase margin", **style)
    if gm is not None or up is not None:
        ax.plot([phase_deg, phase_deg], [-(gm or 0.0), up or 0.0], gid="gain margin", **style)
    ax.plot([phase_deg], [0.0], "+", color="black", markersize=7.0, zorder=2.7, gid="critical point")


def _cross_text(wished: Requirements) -> str:
    parts = []
    if wished.phase_margin_deg is not None:
        parts.append(f"phase ±{wished.phase_margin_deg:g} deg")
    if wished.gain_margin_db is not None:
        parts.append(f"gain \N{MINUS SIGN}{wished.gain_margin_db:g} dB")
    if wished.gain_reduction_margin_db is not None:
        parts.append(f"+{wished.gain_reduction_margin_db:g} dB")
    return "margins " + ", ".join(parts) if parts else ""


def _title(what: str, loops: Sequence[Loop]) -> str:
    plant = loops[0].plant
    parts = [what, f"loop {symbol(plant.loop)}" if plant.loop else ""]
    parts.append(count([loop.plant for loop in loops]))
    return "  ·  ".join(part for part in parts if part)


@styled()
def loop_page(loops: Sequence[Loop], requirements: Requirements | None, *, verdict: Verdict | None = None) -> Figure:
    """Plant, controller, open loop with their phases, |S| and |T| with limits; as figure 5.3 of DCT 2007.002.

    The wished bandwidth is a red line; with a verdict the span of the bandwidths found is shaded.
    """
    _needs_loops(loops)
    key = key_of([loop.plant for loop in loops])
    figure = new_figure(4, 2, (FULL_WIDTH_IN, 8.8), sharex=True)
    panels = dict(zip("PpCcLlST", figure.axes, strict=True))
    unit_in, unit_out = units_of(loops[0].plant)
    units = {"P": ratio(unit_out, unit_in), "C": ratio(unit_in, unit_out), "L": ""}
    for name, unit in units.items():
        _magnitude_and_phase(panels[name], panels[name.lower()], loops, key, name, unit)
    for name in "ST":
        _sensitivity(panels[name], loops, key, name, "")
    _guides(panels, requirements, verdict)
    if place_notes(panels["S"], _limit_entries(requirements, verdict), "lower right"):
        low, high = panels["S"].get_ylim()
        panels["S"].set_ylim(low - 0.4 * (high - low), high)  # room for the notes
    place_key(figure, key)
    head(figure, _title("Loop shaping", loops), key.common)
    return figure


def _responses(loops: Sequence[Loop], name: str) -> list[ComplexArray]:
    return [loop.plant.siso if name == "P" else getattr(loop, name) for loop in loops]


def _magnitude_and_phase(top: Axes, side: Axes, loops: Sequence[Loop], key: Key, name: str, unit: str) -> None:
    """One row of the loop page; a controller common to all loops is drawn once, in black."""
    once = name == "C" and len({id(loop.controller) for loop in loops}) == 1
    chosen = [max(loops, key=lambda loop: float(loop.frequency_hz[-1]))] if once else loops
    for k, (loop, response) in enumerate(zip(chosen, _responses(chosen, name), strict=True)):
        look = {"color": "0.15", "linewidth": 1.2} if once else curve(key.looks[k], k, len(chosen))
        use = np.ones(response.size, dtype=bool) if name == "C" else loop.plant.trusted
        draw_trusted(top, loop.frequency_hz, db(response), use, **look)
        draw_trusted(side, loop.frequency_hz, unwrapped_deg(response, use), use, **look)
    band = shown_band_hz(*(loop.plant for loop in loops))
    for ax in (top, side):
        frequency_axis(ax, *band)
        hide_inner(ax)
    fit_decibels(top)
    fit_degrees(side)
    top.set_ylabel(decibel(f"|{name}|", unit))
    side.set_ylabel(f"phase of {name} [deg]")


def _sensitivity(ax: Axes, loops: Sequence[Loop], key: Key, name: str, unit: str, up_to_hz: float = 0.0) -> None:
    for k, (loop, response) in enumerate(zip(loops, _responses(loops, name), strict=True)):
        draw_trusted(ax, loop.frequency_hz, db(response), loop.plant.trusted, **curve(key.looks[k], k, len(loops)))
    low, high = shown_band_hz(*(loop.plant for loop in loops))
    last = max(float(loop.frequency_hz[-1]) for loop in loops)
    frequency_axis(ax, low, max(high, min(up_to_hz, last)))
    fit_decibels(ax, span=60.0)
    ax.set_ylabel(decibel(f"|{name}|", unit))


def _guides(panels: dict[Any, Axes], wished: Requirements | None, verdict: Verdict | None) -> None:
    """0 dB, the stability limit's phases, and limits and bandwidths where they are known."""
    panels["L"].axhline(0.0, color="0.3", linewidth=0.7, zorder=1.5)
    low, high = panels["l"].get_ylim()
    for shift in turns(low, high):
        panels["l"].axhline(shift - 180.0, color="0.3", linewidth=0.7, zorder=1.5)
    if wished is not None:
        _ceiling(panels["S"], wished.sensitivity_peak_db)
        _ceiling(panels["T"], wished.complementary_peak_db)
        if wished.phase_margin_deg is not None:
            panels["l"].axhline(wished.phase_margin_deg - 180.0, color=LIMIT, linewidth=0.9, linestyle="--")
        if wished.bandwidth_hz is not None:
            for name in "LlST":
                panels[name].axvline(wished.bandwidth_hz, color=LIMIT, linewidth=0.9, gid="bandwidth wished")
    panels["l"].set_ylim(low, high)
    found = [] if verdict is None else [m.bandwidth_hz for m in verdict.margins.values() if np.isfinite(m.bandwidth_hz)]
    for name in "LlST" if found else "":
        panels[name].axvspan(min(found), max(found), color=QUIET, alpha=0.15, linewidth=0.0, zorder=1.0)


def _limit_entries(wished: Requirements | None, verdict: Verdict | None) -> list[Entry]:
    entries: list[Entry] = []
    if wished is not None and wished.sensitivity_peak_db is not None:
        entries.append((f"|S| at most {wished.sensitivity_peak_db:g} dB", {"color": LIMIT, "linewidth": 1.1}))
    if wished is not None and wished.bandwidth_hz is not None:
        entries.append((f"bandwidth at least {wished.bandwidth_hz:g} Hz", {"color": LIMIT, "linewidth": 0.9}))
    if wished is not None and wished.phase_margin_deg is not None:
        text = f"phase margin {wished.phase_margin_deg:g} deg"
        entries.append((text, {"color": LIMIT, "linestyle": "--", "linewidth": 0.9}))
    if verdict is not None:
        entries.append(("bandwidths found", {"color": QUIET, "alpha": 0.3, "linewidth": 6.0, "solid_capstyle": "butt"}))
    return entries


def _ceiling(ax: Axes, limit_db: float | None, from_hz: float | None = None) -> None:
    """A limit from above, from a frequency on; the forbidden side is tinted."""
    if limit_db is None:
        return
    low_hz, high_hz = ax.get_xlim()
    low_hz = low_hz if from_hz is None else from_hz
    if low_hz > high_hz:
        return
    bottom, top = ax.get_ylim()
    bottom, top = (
        min(bottom, 10.0 * np.floor((limit_db - 1.0) / 10.0)),
        max(top, 10.0 * np.ceil((limit_db + 1.0) / 10.0)),
    )
    ax.set_ylim(bottom, top)
    ax.plot(
        [low_hz, high_hz], [limit_db, limit_db], color=LIMIT, linewidth=1.1, scalex=False, scaley=False, gid="limit"
    )
    ax.fill_between([low_hz, high_hz], limit_db, top, color=LIMIT, alpha=0.08, linewidth=0.0)
    ax.set_xlim(ax.get_xlim())
    ax.set_ylim(bottom, top)


@styled()
def sensitivities(loops: Sequence[Loop], requirements: Requirements | None) -> Figure:
    """|S|, |T|, |CS| and |PS| of all operating points, each under its limit where there is one."""
    _needs_loops(loops)
    key = key_of([loop.plant for loop in loops])
    from_hz = None if requirements is None else requirements.control_high_frequency_from_hz
    figure = new_figure(2, 2, (FULL_WIDTH_IN, 6.2), sharex=True)
    unit_in, unit_out = units_of(loops[0].plant)
    units = {"S": "", "T": "", "CS": ratio(unit_in, unit_out), "PS": ratio(unit_out, unit_in)}
    for ax, (name, unit) in zip(figure.axes, units.items(), strict=True):
        _sensitivity(ax, loops, key, name, unit, 1.6 * (from_hz or 0.0))
    s, t, cs, _ = figure.axes
    if requirements is not None:
        _ceiling(s, requirements.sensitivity_peak_db)
        _ceiling(t, requirements.complementary_peak_db)
        _ceiling(cs, requirements.control_peak_db)
        _ceiling(cs, requirements.control_high_frequency_db, from_hz)
    hide_inner(s, t)
    if any(line.get_gid() == "limit" for ax in figure.axes for line in ax.lines):
        place_notes(s, [("limit", {"color": LIMIT, "linewidth": 1.1})], "lower right")
    place_key(figure, key)
    head(figure, _title("Sensitivities", loops), key.common)
    return figure
