"""A gain-scheduled controller: its magnitude at the nodes, and what each frozen operating point reaches under it."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from loopshape.core.units import db
from loopshape.data.result.verdict import Verdict
from loopshape.toolbox.schedules.gain_scheduled import GainScheduled
from loopshape.view.labels import quantity, symbol
from loopshape.view.style import COLOURS, FULL_WIDTH_IN, MARKERS, axes_or_new, head, shades, styled

#: more curves than this have their legend beside the plot
BESIDE = 6


@styled()
def magnitudes(C: GainScheduled, *, ax: Axes | None = None) -> Axes:
    """|C| in dB at each node, shaded by the last variable, from a thousandth of the rate's half up to it."""
    ax = axes_or_new(ax, (3.4, 2.6))
    f_hz = np.geomspace(5e-5, 0.45, 300) * C.rate_hz
    last = C.variables[-1]
    colours = dict(zip(last.knots, shades(len(last.knots)), strict=True))
    named: set[float] = set()
    for at, one in zip(C.nodes, C.controllers, strict=True):
        value = at[last.name]
        label = None if value in named else f"{value:g}"
        named.add(value)
        ax.semilogx(f_hz, db(one.response(f_hz)), color=colours[value], linewidth=0.9, label=label)
    ax.set_xlabel("frequency [Hz]")
    ax.set_ylabel("|C| [dB]")
    ax.legend(title=quantity(last.name), ncols=2)
    return ax


@styled()
def frozen_points(C: GainScheduled, verdict: Verdict, operating_points: dict[str, dict[str, float]], *,
                  ax: Axes | None = None) -> Axes:  # fmt: skip
    """Bandwidth at each frozen operating point that was checked, over the first variable; hollow between the nodes.

    `operating_points` by the names of the verdict's margins.
    """
    ax = axes_or_new(ax, (3.4, 2.6))
    first, last = C.variables[0], C.variables[-1]
    seconds = sorted({at[last.name] for at in operating_points.values()})
    for k, second in enumerate(seconds):
        mine = [name for name, at in operating_points.items() if at[last.name] == second]
        mine.sort(key=lambda name: operating_points[name][first.name])
        x = np.array([operating_points[name][first.name] for name in mine])
        y = np.array([verdict.margins[name].bandwidth_hz for name in mine])
        node = np.array([operating_points[name] in C.nodes for name in mine])
        look = {"color": shades(len(seconds))[k], "marker": MARKERS[k % len(MARKERS)]}
        ax.plot(x, y, linewidth=0.8, markerfacecolor="white", label=f"{second:g}", **look)  # type: ignore[arg-type]
        ax.plot(x[node], y[node], linestyle="none", **look)  # type: ignore[arg-type]
    lowest = min(verdict.margins[name].bandwidth_hz for name in operating_points)
    ax.axhline(lowest, color=COLOURS[1], linewidth=0.8, linestyle="--")
    ax.set_xlabel(quantity(first.name))
    ax.set_ylabel("bandwidth [Hz]")
    if first is not last:
        title = quantity(last.name)
        if len(seconds) > BESIDE:
            ax.legend(title=title, loc="center left", bbox_to_anchor=(1.02, 0.5))
        else:
            ax.legend(title=title, ncols=2)
    return ax


@styled()
def gain_scheduled_page(C: GainScheduled, verdict: Verdict, operating_points: dict[str, dict[str, float]]) -> Figure:
    """Both side by side."""
    figure = Figure(figsize=(FULL_WIDTH_IN, 3.4))
    left, right = figure.subplots(1, 2)
    magnitudes(C, ax=left)
    frozen_points(C, verdict, operating_points, ax=right)
    lowest = min(verdict.margins[name].bandwidth_hz for name in operating_points)
    head(
        figure,
        f"Gain-scheduled controller  ·  loop {symbol(C.loop)}",
        f"{len(C.controllers)} nodes; lowest bandwidth {lowest:.3g} Hz at {len(operating_points)} frozen operating"
        " points (hollow: between the nodes)",
    )
    return figure
