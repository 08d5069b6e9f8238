"""Pictures of loops at all operating points: controller with plant and open loop, sensitivities."""

from __future__ import annotations

from collections.abc import Sequence

from matplotlib.figure import Figure

from loopshape.data.requirement.requirements import Requirements
from loopshape.data.result.verdict import Verdict
from loopshape.loop.loop import Loop
from loopshape.loop.points import worst_of
from loopshape.view.key import key_of, notes_with_room, place_key, place_notes
from loopshape.view.plots.curves import hide_inner
from loopshape.view.style import FULL_WIDTH_IN, LIMIT, head, new_figure, styled
from loopshape.view.verdict.loop_parts import (
    ceiling,
    guides,
    limit_entries,
    looks_of,
    magnitude_and_phase,
    mask_line,
    needs_loops,
    sensitivity,
    title_of,
    worst_entries,
    worst_text,
)

PLOTTED = ("S", "T", "CS", "PS")


@styled()
def loop_page(loops: Sequence[Loop], requirements: Requirements | None, *, verdict: Verdict | None = None) -> Figure:
    """Plant, controller, open loop with their phases, |S| and |T| with limits; as figure 5.3 of DCT 2007.002.

    The worst operating point is thick and has its 95 % bands. The required bandwidth is a red line; with a verdict the
    range of bandwidths is shaded. Of one loop `bode_page` shows more.
    """
    needs_loops(loops)
    key, worst = key_of([loop.plant for loop in loops]), worst_of(loops, verdict)
    looks = looks_of(key, worst.index)
    figure = new_figure(4, 2, (FULL_WIDTH_IN, 8.8), sharex=True)
    panels = dict(zip("PpCcLlST", figure.axes, strict=True))
    for name in "PCL":
        magnitude_and_phase(panels[name], panels[name.lower()], loops, looks, name, worst.index)
    for name in "ST":
        sensitivity(panels[name], loops, looks, name, worst.index)
    hide_inner(*figure.axes[:-2])
    guides(panels, requirements, verdict)
    notes_with_room(panels["c"], worst_entries(loops, looks, worst.index), "upper right")
    notes_with_room(panels["S"], limit_entries(requirements, verdict), "lower right")
    place_key(figure, key)
    head(figure, title_of("Loop shaping", loops), worst_text(loops, worst, verdict), key.common)
    return figure


@styled()
def sensitivities(
    loops: Sequence[Loop], requirements: Requirements | None, *, verdict: Verdict | None = None
) -> Figure:
    """|S|, |T|, |CS| and |PS| of all operating points, each under its limit where there is one.

    The worst operating point is thick and has its 95 % band.
    """
    needs_loops(loops)
    key, worst = key_of([loop.plant for loop in loops]), worst_of(loops, verdict)
    looks = looks_of(key, worst.index)
    from_hz = None if requirements is None else requirements.control_high_frequency_from_hz
    figure = new_figure(2, 2, (FULL_WIDTH_IN, 6.2), sharex=True)
    for ax, name in zip(figure.axes, PLOTTED, strict=True):
        sensitivity(ax, loops, looks, name, worst.index, 1.6 * (from_hz or 0.0))
    for ax, name in zip(figure.axes, PLOTTED, strict=True):
        for limit_db, begins_hz in [] if requirements is None else requirements.ceilings_db(name):
            ceiling(ax, limit_db, begins_hz)
        for mask in () if requirements is None else requirements.masks_on(name):
            mask_line(ax, mask)
    s, t, _, _ = figure.axes
    hide_inner(s, t)
    entries = worst_entries(loops, looks, worst.index)
    if any(line.get_gid() == "limit" for ax in figure.axes for line in ax.lines):
        entries.insert(0, ("limit", {"color": LIMIT, "linewidth": 1.1}))
    place_notes(s, entries, "lower right")
    place_key(figure, key)
    head(figure, title_of("Sensitivities", loops), worst_text(loops, worst, verdict), key.common)
    return figure
