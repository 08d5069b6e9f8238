"""Figures of the study: FRFs of 24 equilibria, maps of the fits, and pages as the source's 4.12, 4.14 and 4.15."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from arm1_sweeps import Found
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from source_controllers import third_order_plant

from loopshape.core.units import db
from loopshape.toolbox.arm.source import value
from loopshape.view.plots.curves import frequency_axis, unwrapped_deg
from loopshape.view.plots.frequency import spectra
from loopshape.view.style import COLOURS, LIMIT, MARKERS, QUIET, head, new_figure, shades, styled

LOW_HZ, HIGH_HZ = 0.15, 12.0
SIZE_DB = (-50.0, 15.0)
DASHES: dict[float, Any] = {0.0: "-", 15.0: (0, (5, 2)), 30.0: (0, (1, 1.2))}
ARM_COLOURS = (COLOURS[3], COLOURS[4])  # blue, red and green are the spectra's
PUBLISHED: dict[str, dict[str, Any]] = {
    "measured": {"color": LIMIT, "linestyle": "--", "linewidth": 1.2},
    "simulated": {"color": QUIET, "linestyle": (0, (1, 1)), "linewidth": 1.4},
}


@styled()
def draw_frfs(arms: Sequence[Sequence[Found]]) -> Figure:
    """Magnitudes and phases at all equilibria, a column an arm; colour is p_AB, dashes the angle's size."""
    figure = new_figure(2, 2, (7.0, 5.6), sharex=True, sharey="row")
    sums = sorted({f.point[1] for f in arms[0]})
    colours = dict(zip(sums, shades(len(sums)), strict=True))
    for k, every in enumerate(arms):
        top, bottom = figure.axes[k], figure.axes[2 + k]
        for f in every:
            look = {"color": colours[f.point[1]], "linestyle": DASHES[abs(f.point[0])], "linewidth": 0.8}
            _bode(top, bottom, f, **look)
        top.set_title(every[0].arm.label, loc="left")
        _axes(top, bottom)
    figure.axes[0].set_ylabel(r"|$\theta_2$ / $z_\theta$| [dB re 1 rad/V]")
    figure.axes[2].set_ylabel("phase [deg]")
    keys = [Line2D([], [], color=c, label=f"{p:g} bar") for p, c in colours.items()]
    keys += [Line2D([], [], color="black", linestyle=d, label=f"{t:g} deg, both sides") for t, d in DASHES.items()]
    figure.legend(handles=keys, loc="outside lower center", ncols=5)
    head(figure, "The response of the angle at 24 equilibria, simulated arms", "within the valid band")
    return figure


def _bode(top: Axes, bottom: Axes, f: Found, **look: Any) -> None:
    mine = f.frf.valid_lines()
    top.semilogx(mine.frequency_hz, db(mine.siso), **look)
    bottom.semilogx(mine.frequency_hz, unwrapped_deg(mine.siso), **look)


def _axes(top: Axes, bottom: Axes) -> None:
    top.set_ylim(*SIZE_DB)
    bottom.set_ylim(-315.0, -45.0)
    bottom.set_yticks([-270.0, -180.0, -90.0])
    frequency_axis(bottom, LOW_HZ, HIGH_HZ)


@styled()
def draw_maps(arms: Sequence[Sequence[Found]]) -> Figure:
    """kappa, f and zeta with intervals over p_AB and angle, a column an arm, the published points beside."""
    figure = new_figure(3, 2, (7.0, 7.2), sharex=True, sharey="row")
    rows = (("kappa", r"$\kappa$ [rad/(V s$^3$)]", "kappa"), ("f_hz", "f [Hz]", "f"), ("zeta", r"$\zeta$ [1]", "zeta"))
    for j, (name, label, key) in enumerate(rows):
        for k, every in enumerate(arms):
            ax = figure.axes[2 * j + k]
            _map(ax, every, name)
            _published(ax, key)
            if j == 0:
                ax.set_title(every[0].arm.label, loc="left")
        figure.axes[2 * j].set_ylabel(label)
    for ax in figure.axes[4:]:
        ax.set_xlabel(r"$p_{AB}$ [bar]")
        ax.set_xlim(0.62, 1.87)
    handles, labels = figure.axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=4)
    details = "open: supply at 1.25 bar instead of 1.0; lines: linearisation with averaged valves, supply 1.0 bar"
    head(figure, "Third-order fits over both coordinates, with 95 % intervals, and what the source prints", details)
    return figure


def _map(ax: Axes, every: Sequence[Found], name: str) -> None:
    angles = sorted({f.point[0] for f in every})
    for k, theta in enumerate(angles):
        colour, aside = shades(len(angles))[k], 0.012 * (k - 0.5 * (len(angles) - 1))
        row = sorted((f for f in every if f.point[0] == theta), key=lambda f: f.point[1])
        for f in row:
            low, high = f.interval(name)
            reach = [[f.value(name) - low], [high - f.value(name)]]
            face = "white" if f.frf.parameters else colour
            look: dict[str, Any] = {"color": colour, "marker": MARKERS[k], "markerfacecolor": face, "linestyle": "none"}
            label = f"{theta:g} deg" if f is row[0] else None
            ax.errorbar([f.point[1] + aside], [f.value(name)], yerr=reach, label=label, elinewidth=0.9, **look)
        plain = [f for f in row if not f.frf.parameters]
        place = {"kappa": 0, "f_hz": 1, "zeta": 2}[name]
        linear = [f.linear.third_order()[place] for f in plain]
        ax.plot([f.point[1] for f in plain], linear, color=colour, linewidth=0.7, alpha=0.8)


def _published(ax: Axes, key: str) -> None:
    for kind, looks in (("measured", ("P", LIMIT)), ("simulated", ("X", QUIET))):
        upright = "figure_4_12" if kind == "measured" else "figure_4_14"
        for p, place, angle in ((1.0, upright, "0"), (0.8, f"figure_4_15.{kind}", "30")):
            label = f"source, {kind}, 0 and 30 deg" if angle == "0" else None
            x, y = p - 0.05, value(f"{place}.{key}")
            look: dict[str, Any] = {"color": looks[1], "markersize": 7.0, "markeredgecolor": "white"}
            ax.plot([x], [y], looks[0], label=label, linestyle="none", zorder=4.0, **look)
            beside: dict[str, Any] = {"textcoords": "offset points", "ha": "right", "fontsize": 7.0}
            ax.annotate(angle, (x, y), (-6.0, -2.5), color=looks[1], **beside)


@styled()
def draw_sensitivity(arms: Sequence[Found], published: Mapping[str, str]) -> Figure:
    """FRF, spectra and coherence as in the source's figures, with its two fitted curves beside ours."""
    figure = new_figure(2, 2, (7.0, 5.4), sharex=True)
    size, power, angle, coherent = figure.axes
    for f, colour in zip(arms, ARM_COLOURS, strict=True):
        _bode(size, angle, f, color=colour, linewidth=1.0, label=f.arm.label)
    f = np.geomspace(LOW_HZ, HIGH_HZ, 500)
    for kind, place in published.items():
        P = third_order_plant(place).response(f)
        size.semilogx(f, db(P), label=f"source's fit, {kind}", **PUBLISHED[kind])
        angle.semilogx(f, unwrapped_deg(P), **PUBLISHED[kind])
    _axes(size, angle)
    size.set_ylim(SIZE_DB[0] - 30.0, SIZE_DB[1])  # room for the legend
    spectra(arms[0].frf, ax=power)
    _coherence(coherent, arms)
    size.set_ylabel(r"|$\theta_2$ / $z_\theta$| [dB re 1 rad/V]")
    angle.set_ylabel("phase [deg]")
    size.legend(loc="lower left")
    power.set_xlabel("")
    for ax in (power, coherent):
        frequency_axis(ax, LOW_HZ, HIGH_HZ, label=ax is coherent)
    theta, p = arms[0].point
    title = f"The angle's response from its sensitivity at ({theta:g} deg, {p:g} bar)"
    head(figure, title, f"spectra: {arms[0].arm.label}; shaded: the source's band of good coherence at (0 deg, 1 bar)")
    return figure


def _coherence(ax: Axes, arms: Sequence[Found]) -> None:
    ax.axvspan(value("identification.coherent_from"), value("identification.coherent_to"), color="0.93", zorder=0.5)
    for f, colour in zip(arms, ARM_COLOURS, strict=True):
        ax.semilogx(f.frf.frequency_hz, f.frf.coherence, color=colour, linewidth=0.9)
    ax.set_ylim(0.0, 1.05)
    ax.set_ylabel("coherence [1]")
