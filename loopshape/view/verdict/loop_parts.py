"""Parts that the pictures of loops share: titles, the worst point in words, panels of a response, bands, limits."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from loopshape.core.errors import WrongUseError
from loopshape.core.units import Array, ComplexArray, db
from loopshape.data.requirement.limits_over import Mask
from loopshape.data.requirement.requirements import LIMIT_OF, Requirements
from loopshape.data.result.margins import Margins
from loopshape.data.result.verdict import Verdict
from loopshape.loop.loop import Loop
from loopshape.loop.points import NEAREST, Worst, band, margins_of
from loopshape.view.key import Entry, Key, count, curve, varying
from loopshape.view.labels import decibel, point, ratio, symbol, units_of
from loopshape.view.plots.curves import (
    controller_phase_deg,
    draw_band,
    draw_known,
    fit_decibels,
    fit_degrees,
    frequency_axis,
    loop_phase_deg,
    plant_phase_deg,
    shown_band_hz,
)
from loopshape.view.plots.nichols_guides import turns
from loopshape.view.style import COLOURS, LIMIT, QUIET

#: a band's face, and the line of a worst point among others
BAND: dict[str, Any] = {"alpha": 0.5, "zorder": 2.7}
BAND_COLOUR = COLOURS[5]
_CONTROLLER: dict[str, Any] = {"color": "0.15", "linewidth": 1.2}


def needs_loops(loops: Sequence[Loop]) -> None:
    """Refuse a picture of nothing."""
    if not loops:
        raise WrongUseError("a picture of loops needs at least one", "none", "give the loops of an FRF set")


def title_of(what: str, loops: Sequence[Loop]) -> str:
    """What, of which loop, at how many operating points."""
    plant = loops[0].plant
    parts = [what, f"loop {symbol(plant.loop)}" if plant.loop else ""]
    parts.append(count([loop.plant for loop in loops]))
    return "  ·  ".join(part for part in parts if part)


def worst_text(loops: Sequence[Loop], worst: Worst, verdict: Verdict | None) -> str:
    """Which point is the worst, why, where, and how near to -1 it comes with its 95 % interval."""
    loop = loops[worst.index]
    margins = margins_of(loop, worst.index, verdict)
    least = float(np.min(np.abs(1.0 + loop.L))) if margins is None else margins.modulus_margin
    ends = None if margins is None else margins["modulus_margin"].interval
    between = "" if ends is None else f" (95 %: {number3(ends[0])} to {number3(ends[1])})"
    size, at_hz = f"least |1 + L| = {number3(least)}{between}", f"at {worst.at_hz:.3g} Hz"
    what = f"{size} {at_hz}" if worst.why == NEAREST else f"{worst.why} {at_hz}; {size}"
    return f"worst: {named(loop)}, {what}" if len(loops) > 1 else what


def named(loop: Loop, among: Sequence[Loop] = ()) -> str:
    """A loop's operating point, or what of it differs among those loops; the recording where none was stated."""
    at = loop.plant.operating_point
    own = {key: at[key] for key in varying([other.plant for other in among])}
    return point(own or at) or loop.plant.recording


def with_interval(margins: Margins, quantity: str, last_hz: float = np.inf) -> str:
    """A margin in words: value, unit, 95 % interval and frequency; "above" the last line where it may lie beyond."""
    limit = LIMIT_OF[quantity]
    unit = "" if limit.unit == "1" else f" {limit.unit}"
    read = margins[quantity]
    ends, at_hz = read.interval, read.at_hz
    places = {"dB": 2, "deg": 1}.get(limit.unit)
    between = "" if ends is None else f" (95 %: {number3(ends[0], places)} to {number3(ends[1], places)})"
    at = "" if at_hz is None else f" {'above' if at_hz >= last_hz else 'at'} {at_hz:.3g} Hz"
    return f"{number3(read.value, places)}{unit}{between}{at}"


def number3(value: float, places: int | None = None) -> str:
    """Three figures, at most `places` decimals, a true minus sign (none before zero), the infinity sign for no end."""
    if np.isinf(value):
        return "∞" if value > 0.0 else "\N{MINUS SIGN}∞"
    small = places is not None and abs(value) < 10.0 ** (2 - places)
    text = f"{value:.{places}f}" if small else f"{value:#.3g}".rstrip(".")
    return text.replace("-", "\N{MINUS SIGN}" if float(text) else "")


def unit_of_response(plant_units: tuple[str, str], name: str) -> str:
    """Unit of a loop's response: P and PS in output per input, C and CS the other way, the others plain numbers."""
    unit_in, unit_out = plant_units
    return {"P": ratio(unit_out, unit_in), "C": ratio(unit_in, unit_out)}.get(name[0] if name != "CS" else "C", "")


def response(loop: Loop, name: str) -> ComplexArray:
    """P, C, L, S, T, CS or PS on the loop's lines."""
    return loop.plant.siso if name == "P" else getattr(loop, name)


def phase_of(loop: Loop, name: str) -> tuple[Array, np.ndarray]:
    """Continuous phase of P, C or L in degrees and where it is known."""
    if name == "C":
        return controller_phase_deg(loop.controller, loop.frequency_hz), np.ones(loop.frequency_hz.size, dtype=bool)
    return plant_phase_deg(loop) if name == "P" else loop_phase_deg(loop)


def looks_of(key: Key, worst: int) -> list[dict[str, Any]]:
    """Line properties of each curve; the worst among several stands out."""
    count = len(key.looks)
    looks = [curve(look, k, count) for k, look in enumerate(key.looks)]
    return [standing_out(look) if k == worst and count > 1 else look for k, look in enumerate(looks)]


def standing_out(look: dict[str, Any]) -> dict[str, Any]:
    """Properties of the worst curve among others: thick, and black where its markers keep its own colour."""
    if "marker" not in look:
        return look | {"linewidth": 2.4, "zorder": 2.8}
    return look | {"color": "black", "linewidth": 1.7, "zorder": 2.8, "markerfacecolor": look["color"]}


def magnitude_and_phase(
    top: Axes, side: Axes, loops: Sequence[Loop], looks: Sequence[dict[str, Any]], name: str, worst: int
) -> None:
    """|.| and phase of P, C or L, with the worst one's 95 % band; a controller common to all once, in black."""
    once = name == "C" and len({id(loop.controller) for loop in loops}) == 1
    for k, (loop, look) in enumerate(zip(loops, looks, strict=True)):
        if once and k != _longest(loops):
            continue
        phase, known = phase_of(loop, name)
        style = _CONTROLLER if once else look
        use = np.ones(known.size, dtype=bool) if name == "C" else loop.plant.valid
        draw_known(top, loop.frequency_hz, db(response(loop, name)), use, **style)
        draw_known(side, loop.frequency_hz, phase, known, **style)
        if k == worst and name != "C":
            draw_bands(top, side, loop, name, BAND_COLOUR)
    for ax in (top, side):
        frequency_axis(ax, *shown_band_hz(*(loop.plant for loop in loops)))
    fit_decibels(top)
    fit_degrees(side)
    top.set_ylabel(decibel(f"|{name}|", unit_of_response(units_of(loops[0].plant), name)))
    side.set_ylabel(f"phase of {name} [deg]")


def _longest(loops: Sequence[Loop]) -> int:
    return int(np.argmax([loop.frequency_hz[-1] for loop in loops]))


def draw_bands(top: Axes, side: Axes | None, loop: Loop, name: str, colour: str) -> None:
    """95 % band of a magnitude and of its phase, where it is known; nothing for an FRF without variance."""
    if not np.any(loop.plant.variance):
        return
    ends, use = band(loop, name), loop.plant.valid
    f = loop.frequency_hz
    floor = np.maximum(ends.low_db, -400.0)
    draw_band(top, f[use], floor[use], ends.high_db[use], color=colour, gid="band", **BAND)
    if side is not None:
        phase, known = phase_of(loop, name)
        for run in _runs(known):
            low, high = (phase + ends.low_deg)[run], (phase + ends.high_deg)[run]
            draw_band(side, f[run], low, high, color=colour, gid="band", **BAND)


def _runs(known: np.ndarray) -> list[slice]:
    """Unbroken runs of two known lines or more."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], known, [False]]).astype(int)))
    return [slice(a, b) for a, b in edges.reshape(-1, 2) if b - a > 1]


def sensitivity(
    ax: Axes, loops: Sequence[Loop], looks: Sequence[dict[str, Any]], name: str, worst: int, up_to_hz: float = 0.0
) -> None:
    """|S|, |T|, |CS| or |PS| in dB of all loops, with the worst one's 95 % band."""
    for k, (loop, look) in enumerate(zip(loops, looks, strict=True)):
        draw_known(ax, loop.frequency_hz, db(response(loop, name)), loop.plant.valid, **look)
        if k == worst:
            draw_bands(ax, None, loop, name, BAND_COLOUR)
    low, high = shown_band_hz(*(loop.plant for loop in loops))
    last = max(float(loop.frequency_hz[-1]) for loop in loops)
    frequency_axis(ax, low, max(high, min(up_to_hz, last)))
    fit_decibels(ax, span=60.0)
    ax.set_ylabel(decibel(f"|{name}|", unit_of_response(units_of(loops[0].plant), name)))


def worst_entries(loops: Sequence[Loop], looks: Sequence[dict[str, Any]], worst: int) -> list[Entry]:
    """What the notes say of the worst curve and of bands."""
    entries: list[Entry] = []
    if len(loops) > 1:
        entries.append((f"worst: {named(loops[worst], loops)}", shown(looks[worst])))
    if np.any(loops[worst].plant.variance):
        text = "its 95 %, each frequency by itself" if len(loops) > 1 else "95 %, each frequency by itself"
        entries.append((text, {"color": BAND_COLOUR, "alpha": 0.5, "linewidth": 6.0, "solid_capstyle": "butt"}))
    return entries


def shown(look: dict[str, Any]) -> dict[str, Any]:
    """What notes need of a curve's properties."""
    names = ("color", "linewidth", "marker", "markerfacecolor", "markeredgecolor", "markeredgewidth", "markersize")
    return {name: look[name] for name in names if name in look}


def guides(panels: dict[Any, Axes], required: Requirements | None, verdict: Verdict | None) -> None:
    """0 dB, the stability limit's phases, and limits and bandwidths where they are known."""
    panels["L"].axhline(0.0, color="0.3", linewidth=0.7, zorder=1.5)
    low, high = panels["l"].get_ylim()
    for shift in turns(low, high):
        panels["l"].axhline(shift - 180.0, color="0.3", linewidth=0.7, zorder=1.5)
    if required is not None:
        ceiling(panels["S"], required.sensitivity_peak_db)
        ceiling(panels["T"], required.complementary_peak_db)
        for mask in (mask for name in "LST" for mask in required.masks_on(name)):
            mask_line(panels[mask.response], mask)
        if required.phase_margin_deg is not None:
            panels["l"].axhline(required.phase_margin_deg - 180.0, color=LIMIT, linewidth=0.9, linestyle="--")
        if required.bandwidth_hz is not None:
            for name in "LlST":
                panels[name].axvline(required.bandwidth_hz, color=LIMIT, linewidth=0.9, gid="bandwidth required")
    panels["l"].set_ylim(low, high)
    found = [] if verdict is None else [m.bandwidth_hz for m in verdict.margins.values() if np.isfinite(m.bandwidth_hz)]
    for name in "LlST" if found and max(found) > min(found) else "":
        panels[name].axvspan(min(found), max(found), color=QUIET, alpha=0.15, linewidth=0.0, zorder=1.0)


def limit_entries(required: Requirements | None, verdict: Verdict | None) -> list[Entry]:
    """What the notes say of limits and bandwidths."""
    entries: list[Entry] = []
    if required is not None and required.sensitivity_peak_db is not None:
        entries.append((f"|S| at most {required.sensitivity_peak_db:g} dB", {"color": LIMIT, "linewidth": 1.1}))
    if required is not None and required.bandwidth_hz is not None:
        entries.append((f"bandwidth at least {required.bandwidth_hz:g} Hz", {"color": LIMIT, "linewidth": 0.9}))
    if required is not None and required.phase_margin_deg is not None:
        text = f"phase margin {required.phase_margin_deg:g} deg"
        entries.append((text, {"color": LIMIT, "linestyle": "--", "linewidth": 0.9}))
    if required is not None and any(required.masks_on(name) for name in "LST"):
        entries.append(("masks", {"color": LIMIT, "linewidth": 1.1}))
    if verdict is not None and len(verdict.margins) > 1:
        entries.append(
            ("range of bandwidths", {"color": QUIET, "alpha": 0.3, "linewidth": 6.0, "solid_capstyle": "butt"})
        )
    return entries


def mask_line(ax: Axes, mask: Mask) -> None:
    """A mask over frequency, its forbidden side tinted; the axis of magnitude grows to show it."""
    (left, right), (bottom, top) = ax.get_xlim(), ax.get_ylim()
    low, high = max(left, mask.band_hz[0]), min(right, mask.band_hz[1])
    if low >= high:
        return
    inner = [f for f, _ in mask.points if low < f < high]
    f = np.array([low, *inner, high])
    level = mask.level_db(f)
    bottom = min(bottom, 10.0 * np.floor((level.min() - 1.0) / 10.0))
    top = max(top, 10.0 * np.ceil((level.max() + 1.0) / 10.0))
    ax.plot(f, level, color=LIMIT, linewidth=1.1, scalex=False, scaley=False, gid="limit")
    ax.fill_between(f, level, bottom if mask.sense == "at_least" else top, color=LIMIT, alpha=0.08, linewidth=0.0)
    ax.set_xlim(left, right)
    ax.set_ylim(bottom, top)


def ceiling(ax: Axes, limit_db: float | None, from_hz: float | None = None) -> None:
    """A limit from above, from a frequency on; the forbidden side is tinted."""
    if limit_db is None:
        return
    low_hz, high_hz = ax.get_xlim()
    low_hz = low_hz if from_hz is None else from_hz
    if low_hz > high_hz:
        return
    bottom, top = ax.get_ylim()
    bottom = min(bottom, 10.0 * np.floor((limit_db - 1.0) / 10.0))
    top = max(top, 10.0 * np.ceil((limit_db + 1.0) / 10.0))
    style: dict[str, Any] = {"color": LIMIT, "linewidth": 1.1, "scalex": False, "scaley": False, "gid": "limit"}
    ax.plot([low_hz, high_hz], [limit_db, limit_db], **style)
    ax.fill_between([low_hz, high_hz], limit_db, top, color=LIMIT, alpha=0.08, linewidth=0.0)
    ax.set_xlim(ax.get_xlim())
    ax.set_ylim(bottom, top)
