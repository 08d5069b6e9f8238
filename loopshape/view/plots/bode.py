"""Bode page of one operating point: P, C, L, S and T with 95 % bands, the frequencies as measured, and the margins."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from loopshape.core.units import db, deg
from loopshape.data.requirement.requirements import Requirements
from loopshape.data.result.margins import Margins
from loopshape.data.result.verdict import Verdict
from loopshape.loop.loop import Loop
from loopshape.loop.points import margins_of, worst_of
from loopshape.view.key import Entry, notes_with_room
from loopshape.view.labels import point
from loopshape.view.plots.curves import hide_inner, known_lines, nearest_branch
from loopshape.view.style import COLOURS, FULL_WIDTH_IN, head, new_figure, styled
from loopshape.view.verdict.loop_parts import (
    BAND_COLOUR,
    guides,
    limit_entries,
    magnitude_and_phase,
    phase_of,
    sensitivity,
    title_of,
    with_interval,
    worst_text,
)

_LOOK: dict[str, Any] = {"color": COLOURS[0], "linewidth": 1.2, "zorder": 2.9}
_DOTS: dict[str, Any] = {"linestyle": "none", "marker": ".", "markersize": 2.5, "markeredgewidth": 0.0, "color": "0.45"}
_MARK: dict[str, Any] = {"color": "black", "markersize": 3.5, "capsize": 2.0, "linewidth": 1.1, "zorder": 3.5}


@styled()
def bode_page(loop: Loop, requirements: Requirements | None, *, verdict: Verdict | None = None) -> Figure:
    """P, C and L with phases, |S| and |T|, each with its 95 % band (of every line by itself) and limits.

    Dots are P and L on the lines as they were measured. With a verdict the gain and phase margins stand as bars at
    their frequencies, the bandwidth and the peaks of |S| and |T| as dots, with their 95 % intervals: those of a peak
    or a margin, bias-corrected, so a dot may lie beside its curve.
    """
    figure = new_figure(4, 2, (FULL_WIDTH_IN, 8.8), sharex=True)
    panels = dict(zip("PpCcLlST", figure.axes, strict=True))
    for name in "PCL":
        magnitude_and_phase(panels[name], panels[name.lower()], [loop], [_LOOK], name, 0)
    for name in "ST":
        sensitivity(panels[name], [loop], [_LOOK], name, 0)
    for name in "PL" if loop.raw is not None else "":
        _measured(panels[name], panels[name.lower()], loop, name)
    hide_inner(*figure.axes[:-2])
    margins = margins_of(loop, 0, verdict)
    if margins is not None:
        _margins(panels, loop, margins)
    guides(panels, requirements, None)
    _notes(panels, loop, requirements)
    plant = loop.plant
    words = worst_text([loop], worst_of([loop], verdict), verdict)
    head(figure, title_of("Loop shaping", [loop]), point(plant.operating_point), words, plant.method, *plant.notes)
    return figure


def _measured(top: Axes, side: Axes, loop: Loop, name: str) -> None:
    """Lines as they were measured, as dots that do not stretch the axes; phases where they are known."""
    raw = loop.raw
    assert raw is not None
    f = raw.frequency_hz
    value = raw.siso if name == "P" else raw.siso * loop.controller.response(f)
    phase, known = phase_of(loop, name)
    near = np.interp(np.log(f), np.log(loop.frequency_hz), phase)
    shown = known_lines(raw) & np.interp(f, loop.frequency_hz, known).astype(bool)
    for ax, y, use in ((top, db(value), raw.valid), (side, nearest_branch(deg(np.angle(value)), near), shown)):
        limits = ax.get_ylim()
        ax.plot(f[use], y[use], scalex=False, scaley=False, gid="measured", zorder=1.9, **_DOTS)
        ax.set_ylim(limits)


def _margins(panels: dict[str, Axes], loop: Loop, margins: Margins) -> None:
    """Margins as bars, bandwidth and peaks as dots with their intervals; in words above each panel."""
    gain_hz, turn_hz = margins["gain_margin_db"].at_hz, margins["phase_margin_deg"].at_hz
    if gain_hz and np.isfinite(margins.gain_margin_db):
        _bar(panels["L"], gain_hz, -margins.gain_margin_db, 0.0, "gain margin")
    if turn_hz is not None and np.isfinite(margins.phase_margin_deg):
        phase, _ = phase_of(loop, "L")
        there = float(np.interp(np.log(turn_hz), np.log(loop.frequency_hz), phase))
        limit = -180.0 + 360.0 * round((there + 180.0) / 360.0)
        _bar(panels["l"], turn_hz, limit, limit + np.copysign(margins.phase_margin_deg, there - limit), "phase margin")
    _bandwidth(panels["L"], margins)
    for name, quantity in (("S", "sensitivity_peak_db"), ("T", "complementary_peak_db")):
        _peak(panels[name], margins, quantity)
    words = {"L": ("gain_margin_db", "gain margin"), "l": ("phase_margin_deg", "phase margin")}
    words |= {"S": ("sensitivity_peak_db", "peak"), "T": ("complementary_peak_db", "peak")}
    for name, (quantity, word) in words.items():
        text = with_interval(margins, quantity, float(loop.frequency_hz[-1]))
        # not in the layout: it may be wider than its panel, which would then leave its neighbours no width
        panels[name].set_title(f"{word} {text}", loc="left", fontsize=7.5, pad=2.5).set_in_layout(False)


def _bar(ax: Axes, at_hz: float, low: float, high: float, gid: str) -> None:
    style: dict[str, Any] = {"color": "black", "linewidth": 1.3, "marker": "_", "markersize": 6.0, "zorder": 3.5}
    ax.plot([at_hz, at_hz], [low, high], scalex=False, scaley=False, gid=gid, **style)


def _bandwidth(ax: Axes, margins: Margins) -> None:
    """The first 0 dB crossing with the interval of its frequency."""
    value = margins.bandwidth_hz
    if not np.isfinite(value) or value <= 0.0:
        return
    low, high = margins["bandwidth_hz"].ends
    low, high = max(low, 1e-3 * value), min(high, 1e3 * value)
    limits = ax.get_xlim()
    bar = ax.errorbar([value], [0.0], xerr=[[value - low], [high - value]], fmt="o", **_MARK)
    bar.lines[0].set_gid("bandwidth")
    ax.set_xlim(limits)


def _peak(ax: Axes, margins: Margins, quantity: str) -> None:
    value, at_hz = margins[quantity].value, margins[quantity].at_hz
    left_hz, right_hz = ax.get_xlim()
    if not at_hz or not np.isfinite(value) or not left_hz <= at_hz <= right_hz:  # it has no place on the axis
        return
    low, high = margins[quantity].ends
    limits = ax.get_ylim()
    bar = ax.errorbar([at_hz], [value], yerr=[[value - low], [high - value]], fmt="o", **_MARK)
    bar.lines[0].set_gid("peak")
    for part in (bar.lines[0], *bar.lines[1], *bar.lines[2]):
        part.set_clip_on(False)
    ax.set_ylim(limits[0], max(limits[1], 10.0 * np.ceil(min(high, limits[1] + 20.0) / 10.0)))


def _notes(panels: dict[str, Axes], loop: Loop, requirements: Requirements | None) -> None:
    curves: list[Entry] = []
    if loop.raw is not None:
        curves.append(("frequencies as measured", _DOTS | {"markersize": 5.0}))
        curves.append(("smoothed over frequency", _LOOK))
    if np.any(loop.plant.variance):
        look: dict[str, Any] = {"color": BAND_COLOUR, "alpha": 0.5, "linewidth": 6.0, "solid_capstyle": "butt"}
        curves.append(("95 %, each frequency by itself", look))
    notes_with_room(panels["c"], curves, "upper right")
    notes_with_room(panels["S"], limit_entries(requirements, None), "lower right")
    kinds = ", ".join(block.kind.replace("_", " ") for block in loop.controller.blocks)
    panels["C"].set_title(f"controller: {kinds}" if kinds else "controller", loc="left", fontsize=7.5, pad=2.5)
