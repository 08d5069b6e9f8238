"""Figures of the study: counterparts of the source's figures 5.3 to 5.7, H.1 and H.2."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from arm1_loops import Judged
from arm1_motion import P_AB, Moved
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from loopshape.core.units import Array, db, deg
from loopshape.loop.loop import Loop
from loopshape.toolbox.arm.source import value
from loopshape.view.plots.curves import frequency_axis, unwrapped_deg
from loopshape.view.plots.nichols_guides import constant_s, nichols_coordinates
from loopshape.view.style import COLOURS, LIMIT, QUIET, head, new_figure, shades, styled

LOW_HZ, HIGH_HZ = 0.15, 12.0
DASHES: dict[float, Any] = {0.0: "-", 15.0: (0, (5, 2)), 30.0: (0, (1, 1.2))}
PRINTED = {
    "figure_4_12": "measured, (0 deg, 1.0 bar)",
    "figure_4_15.measured": "measured, (30 deg, 0.8 bar)",
    "figure_4_14": "simulated, (0 deg, 1.0 bar)",
    "figure_4_15.simulated": "simulated, (30 deg, 0.8 bar)",
}
NOTCHES = tuple(f"notch at {value(key):g} Hz" for key in ("table_5_1.notch", "figure_5_7.notch"))


@styled()
def draw_printed(rows: Sequence[tuple[str, str, float, Loop, Any]]) -> Figure:
    """Table 5.1, and its variant of figure 5.7, on the four printed plants with the delay: Nichols and |S|."""
    figure = new_figure(2, 2, (7.0, 6.0))
    for k, words in enumerate(dict.fromkeys(row[1] for row in rows)):
        nichols, size = figure.axes[k], figure.axes[2 + k]
        mine = [row for row in rows if row[1] == words and row[2] > 0.0]
        for (place, _, _, loop, _), colour in zip(mine, COLOURS, strict=False):
            _nichols(nichols, loop, color=colour, linewidth=1.0)
            size.semilogx(loop.frequency_hz, db(loop.S), color=colour, linewidth=1.0, label=PRINTED[place])
        _nichols_axes(nichols)
        _sensitivity_axes(size)
        nichols.set_title(NOTCHES[k], loc="left")
    figure.axes[0].set_ylabel("open loop |L| [dB]")
    figure.axes[2].set_ylabel("|S| [dB]")
    figure.legend(*figure.axes[2].get_legend_handles_labels(), loc="outside lower center", ncols=2)
    head(figure, "The source's angle controller on the plants that it prints",
         f"with {1e3 * rows[1][2]:.1f} ms of delay; red: |S| = {value('required.sensitivity'):g} dB")  # fmt: skip
    return figure


def _nichols(ax: Axes, loop: Loop, **look: Any) -> None:
    ax.plot(unwrapped_deg(loop.L), db(loop.L), **look)


def _nichols_axes(ax: Axes, *, label: bool = True) -> None:
    phase, size = nichols_coordinates(constant_s(value("required.sensitivity")))
    for turn in (0.0, -360.0):
        ax.fill(phase + turn, size, facecolor=LIMIT, alpha=0.14, linewidth=0.0)
        ax.plot(phase + turn, size, color=LIMIT, linewidth=1.0)
        ax.plot([turn - 180.0], [0.0], "+", color="black")
    ax.set_xlim(-450.0, 0.0)
    ax.set_xticks(np.arange(-450.0, 1.0, 90.0))
    ax.set_ylim(-30.0, 30.0)
    if label:
        ax.set_xlabel("open-loop phase [deg]")


def _sensitivity_axes(ax: Axes) -> None:
    ax.axhline(value("required.sensitivity"), color=LIMIT, linewidth=1.0)
    ax.set_ylim(-30.0, 20.0)
    frequency_axis(ax, LOW_HZ, HIGH_HZ)


@styled()
def draw_loops(columns: Sequence[Judged], words: Sequence[str]) -> Figure:
    """|L|, |S| and Nichols at 24 equilibria, a column a controller on an arm."""
    figure = new_figure(3, len(columns), (7.0, 7.6), sharey="row")
    sums = sorted({loop.plant.operating_point["p_ab_bar"] for loop in columns[0].loops})
    colours = dict(zip(sums, shades(len(sums)), strict=True))
    for k, (judged, text) in enumerate(zip(columns, words, strict=True)):
        size, sensitivity, nichols = (figure.axes[k + len(columns) * j] for j in range(3))
        for loop in judged.loops:
            at = loop.plant.operating_point
            look = {"color": colours[at["p_ab_bar"]], "linestyle": DASHES[abs(at["theta2_deg"])], "linewidth": 0.8}
            size.semilogx(loop.frequency_hz, db(loop.L), **look)
            sensitivity.semilogx(loop.frequency_hz, db(loop.S), **look)
            _nichols(nichols, loop, **look)
        _loop_axes(size, judged)
        _sensitivity_axes(sensitivity)
        _nichols_axes(nichols)
        nichols.set_xlim(-360.0, 0.0)
        nichols.set_xticks([-270.0, -180.0, -90.0])
        size.set_title(f"{text}\nstable {judged.stable}, as required {judged.meeting} of 24", loc="left", fontsize=8.0)
    for ax, label in zip(figure.axes[:: len(columns)], ("|L| [dB]", "|S| [dB]", "|L| [dB]"), strict=True):
        ax.set_ylabel(label)
    keys = [Line2D([], [], color=c, label=f"{p:g} bar") for p, c in colours.items()]
    keys += [Line2D([], [], color="black", linestyle=d, label=f"{t:g} deg, both sides") for t, d in DASHES.items()]
    figure.legend(handles=keys, loc="outside lower center", ncols=5)
    head(figure, "The angle loop of simulated arms at 24 equilibria, the source's controller and the shipped one",
         "shaded: the source's span of bandwidth; red: its limit of |S|")  # fmt: skip
    return figure


def _loop_axes(ax: Axes, judged: Judged) -> None:
    ax.axvspan(value("table_5_1.bandwidth_low"), value("table_5_1.bandwidth_high"), color="0.92", zorder=0.5)
    ax.axhline(0.0, color="black", linewidth=0.6)
    ax.set_ylim(-50.0, 35.0)
    frequency_axis(ax, LOW_HZ, HIGH_HZ, label=False)


@styled()
def draw_pressure(arms: Sequence[Judged]) -> Figure:
    """The pressure loop at 0 deg: plants (H.1), |S| and bandwidth (5.5), Nichols (H.2)."""
    figure = new_figure(2, 2, (7.0, 5.8))
    size, angle, sensitivity, nichols = figure.axes
    sums = [loop.plant.operating_point["p_ab_bar"] for loop in arms[0].loops]
    for judged, dash in zip(arms, ("-", (0, (4, 2))), strict=True):
        for loop, colour in zip(judged.loops, shades(len(sums)), strict=True):
            look: dict[str, Any] = {"color": colour, "linestyle": dash, "linewidth": 0.9}
            f = loop.frequency_hz
            size.semilogx(f, db(loop.plant.siso), **look)
            angle.semilogx(f, unwrapped_deg(loop.plant.siso), **look)
            sensitivity.semilogx(f, db(loop.S), **look)
            _nichols(nichols, loop, **look)
    _pressure_axes(size, angle, sensitivity, nichols)
    keys = [Line2D([], [], color=c, label=f"{p:g} bar") for p, c in zip(sums, shades(len(sums)), strict=True)]
    keys += [Line2D([], [], color="black", linestyle=d, label=a.arm.label)
             for a, d in zip(arms, ("-", (0, (4, 2))), strict=True)]  # fmt: skip
    figure.legend(handles=keys, loc="outside lower center", ncols=4)
    head(figure, "The pressure loop under the source's controller, simulated arms",
         "dotted grey: first crossing at the bandwidth that the source prints; red: its limit of |S|")  # fmt: skip
    return figure


def _pressure_axes(size: Axes, angle: Axes, sensitivity: Axes, nichols: Axes) -> None:
    for ax in (size, angle):
        frequency_axis(ax, LOW_HZ, HIGH_HZ)
    size.set_ylabel(r"|$p_{AB}$ / $z_p$| [dB re 1 bar/V]")
    size.set_title("plant: magnitude", loc="left")
    angle.set_ylabel("phase [deg]")
    angle.set_ylim(-225.0, 0.0)
    angle.set_yticks([-180.0, -90.0, 0.0])
    _sensitivity_axes(sensitivity)
    sensitivity.axvline(value("table_5_2.bandwidth"), color=QUIET, linestyle=":", linewidth=1.0)
    sensitivity.set_ylabel("|S| [dB]")
    sensitivity.set_title("sensitivity", loc="left")
    _nichols_axes(nichols)
    nichols.set_xlim(-360.0, 0.0)
    nichols.set_ylabel("open loop |L| [dB]")
    nichols.set_title("open loop", loc="left")


@styled()
def draw_steps(every: Sequence[Moved], printed: Mapping[str, tuple[Array, Array]], at_s: float) -> Figure:
    """Angle and pressure under steps, and the computed step of the printed plant."""
    figure = new_figure(2, 1, (7.0, 5.4), sharex=True)
    top, bottom = figure.axes
    first = every[0].steps
    t = first.column("t_s")
    top.plot(t, deg(first.column("r_theta2_rad")), color="black", linewidth=0.7, linestyle="--", label="setpoint")
    bottom.plot(t, first.column("r_p_ab_bar"), color="black", linewidth=0.7, linestyle="--")
    for m, colour in zip(every, COLOURS, strict=False):
        t = m.steps.column("t_s")
        top.plot(t, deg(m.steps.column("theta2_rad")), color=colour, linewidth=0.9, label=_words(m))
        bottom.plot(t, m.steps.output(P_AB), color=colour, linewidth=0.9)
    for (words, (time_s, angle)), dash in zip(printed.items(), (":", "-"), strict=True):
        top.plot(time_s + at_s, angle, color=QUIET, linestyle=dash, linewidth=1.0, label=words)
    top.set_ylabel(r"$\theta_2$ [deg]")
    top.set_ylim(-12.0, 48.0)
    bottom.set_ylabel(r"$p_{AB}$ [bar]")
    bottom.set_xlabel("time [s]")
    figure.legend(*top.get_legend_handles_labels(), loc="outside lower center", ncols=2)
    head(figure, "Steps of angle and pressure, and an infeasible setpoint at the end")
    return figure


def _words(m: Moved) -> str:
    return f"{m.arm.label}; {m.controllers}"


@styled()
def draw_tracking(every: Sequence[Moved]) -> Figure:
    """Angle, its error, and the pressure while a third-order profile is tracked."""
    figure = new_figure(3, 1, (7.0, 6.4), sharex=True)
    angle, error, pressure = figure.axes
    r, t = deg(every[0].profile.column("r_theta2_rad")), every[0].profile.column("t_s")
    angle.plot(t, r, color="black", linewidth=0.7, linestyle="--", label="setpoint")
    pressure.plot(t, every[0].profile.column("r_p_ab_bar"), color="black", linewidth=0.7, linestyle="--")
    for m, colour in zip(every, COLOURS, strict=False):
        t, y = m.profile.column("t_s"), deg(m.profile.column("theta2_rad"))
        angle.plot(t, y, color=colour, linewidth=0.9, label=_words(m))
        error.plot(t, r[: y.size] - y, color=colour, linewidth=0.8)
        pressure.plot(t, m.profile.output(P_AB), color=colour, linewidth=0.8)
    for ax, label in zip(figure.axes, (r"$\theta_2$ [deg]", "error [deg]", r"$p_{AB}$ [bar]"), strict=True):
        ax.set_ylabel(label)
    pressure.set_xlabel("time [s]")
    figure.legend(*angle.get_legend_handles_labels(), loc="outside lower center", ncols=1)
    head(figure, "A third-order profile of the angle at a constant pressure of 1 bar")
    return figure
