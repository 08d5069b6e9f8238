"""Pictures of the study: the source's three figures, the gas in a shut muscle, the falling arm, the solver."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from open_loop_scores import Found
from open_loops import Trace, length_a_mm, run, slack_bar

from loopshape.toolbox.arm.source import value
from loopshape.view.style import COLOURS, LIMIT, QUIET, head, new_figure, styled

LAWS = {"gauge": ("-", "gauge, as printed"), "absolute": ("--", "absolute"), "adiabatic": (":", "absolute, 1.4")}


def pages(found: Found, s: dict) -> list[tuple[str, Figure]]:
    """All pages by name."""
    return [
        ("records", draw_records(found)),
        ("shut_muscle", draw_shut(found)),
        ("falling", draw_falling(found, s)),
        ("solver", draw_solver(s)),
    ]


@styled()
def draw_records(found: Found) -> Figure:
    """Figures 4.16 to 4.18 as the source lays them out: pressures, angle, input."""
    figure = new_figure(3, 3, (7.0, 5.6), sharex=True)
    shown = (
        ("figure-4-16", "opposite pressures"),
        ("figure-4-17", "muscle A shut"),
        ("figure-4-18-wide", "equal pressures"),
    )
    for column, (name, title) in enumerate(shown):
        record(figure.axes[column::3], found.replays[name])
        figure.axes[column].set_title(title)
    stopped = found.replays["figure-4-18"]
    figure.axes[5].axvline(stopped.time_s[-1], color=LIMIT, linewidth=0.8, linestyle=":")
    figure.axes[5].annotate(
        "leaves the\nmodel's range", (stopped.time_s[-1], 35.0), (-4, 0), textcoords="offset points", ha="right",
        va="center", fontsize=7, color=LIMIT,
    )  # fmt: skip
    for ax, label in zip(figure.axes[::3], ("pressure [bar]", "$\\theta_2$ [deg]", "u [V]"), strict=True):
        ax.set_ylabel(label)
    for ax, limits in zip(figure.axes[3:6], ((-10, 15), (0, 50), (-20, 60)), strict=True):
        ax.set_ylim(*limits)
    for ax in figure.axes[6:]:
        ax.set_xlabel("time [s]")
        ax.set_xlim(0.0, value("open_loop.duration"))
    figure.axes[0].legend(loc="upper right", ncols=2)
    figure.axes[6].legend(loc="upper right", ncols=2)
    head(
        figure,
        "Open loop: the model's answer to inputs that fit the source's text",
        "axes as in the source's figures, whose inputs and measurements are drawn only",
    )
    return figure


def record(axes: list[Axes], trace: Trace) -> None:
    """One column."""
    pressures, angle, inputs = axes
    for values, name, colour in ((trace.p_a_bar, "A", COLOURS[0]), (trace.p_b_bar, "B", COLOURS[1])):
        pressures.plot(trace.time_s, values, color=colour, label=f"$p_{name}$")
    pressures.axhline(value("open_loop.low_pressure"), color=QUIET, linewidth=0.8, linestyle=":")
    pressures.set_ylim(0.0, 1.0)
    angle.plot(trace.time_s, trace.theta2_deg, color=COLOURS[2])
    for values, name, colour, dash in ((trace.u_a_v, "A", COLOURS[0], "-"), (trace.u_b_v, "B", COLOURS[1], "--")):
        inputs.plot(trace.time_s, values, color=colour, linestyle=dash, label=f"$u_{name}$")
    inputs.set_ylim(-1.0, 1.0)


@styled()
def draw_shut(found: Found) -> Figure:
    """Figure 4.17 under three gas laws, and the rise per mm."""
    figure = new_figure(1, 3, (7.0, 3.0))
    pressure, angle, rate = figure.axes
    for colour, (name, trace) in zip(COLOURS, found.shut.items(), strict=False):
        dash, label = LAWS[name]
        pressure.plot(trace.time_s, 1e3 * (trace.p_a_bar - trace.p_a_bar[0]), color=colour, linestyle=dash)
        angle.plot(trace.time_s, trace.theta2_deg, color=colour, linestyle=dash)
        mine = [(row[2], row[3]) for row in found.rise if row[0] == name]
        rate.plot(*np.array(mine, dtype=float).T, "o", color=colour, linestyle=dash, label=label)
    pressure.set(title="rise of $p_A$, muscle A shut", xlabel="time [s]", ylabel="rise [mbar]")
    angle.set(title="its angle", xlabel="time [s]", ylabel="$\\theta_2$ [deg]")
    rate.set(title="at 190 mm, by the formula", xlabel="$p_A$ [bar]", ylabel="rise [mbar/mm]", ylim=(0, None))
    figure.legend(*rate.get_legend_handles_labels(), loc="outside lower center", ncols=3)
    head(figure, "A shut muscle that is stretched: the printed gas law hides the rise")
    return figure


@styled()
def draw_falling(found: Found, s: dict) -> Figure:
    """What holds the joint over pressure, and figure 4.18 under three gas laws."""
    figure = new_figure(1, 2, (7.0, 4.2))
    left, right = figure.axes
    t = found.terms["fitted"]
    p = t.pressure_bar
    for values, label, colour in (
        (t.stiffness, "stiffness, $r^2k$", COLOURS[0]), (t.slope, "its slope, $r^2k'(h-h_0)$", COLOURS[1]),
        (t.gravity, "gravity", COLOURS[4]), (t.geometry, "levers turning", QUIET),
    ):  # fmt: skip
        left.plot(p, values, color=colour, label=label)
    left.plot(p, t.at_constant_pressure, color="0.1", linewidth=1.8, label="sum, constant pressure")
    left.plot(p, t.at_constant_pressure + t.absolute, color=COLOURS[2], linestyle="--", label="sum, shut, absolute")
    left.axhline(0.0, color="0.5", linewidth=0.6)
    left.axvline(slack_bar(1e-3 * length_a_mm(0.0)), color=LIMIT, linestyle=":", label="$h_0$ = length at 0 deg")
    left.set(xlabel="$p_A = p_B$ [bar]", ylabel="N m/rad, positive holds", xlim=(p[0], 0.45), ylim=(-15, 20))
    left.set_title("what holds the joint at 0 deg")
    for colour, (name, trace) in zip(COLOURS, found.fallen.items(), strict=False):
        dash, label = LAWS[name]
        right.plot(trace.time_s, trace.theta2_deg, color=colour, linestyle=dash, label=label)
    right.set(xlabel="time [s]", ylabel="$\\theta_2$ [deg]", xlim=(4.0, 7.0), ylim=(-20, 60))
    right.set_title("equal pressures, three gas laws")
    right.legend(loc="upper left")
    figure.legend(*left.get_legend_handles_labels(), loc="outside lower center", ncols=3, fontsize=7.5)
    head(figure, "The arm falls because its muscles push, not because gravity pulls")
    return figure


@styled()
def draw_solver(s: dict) -> Figure:
    """The source's solver minus exact edges."""
    figure = new_figure(1, 2, (7.0, 3.2), sharex=True)
    for ax, name in zip(figure.axes, ("figure-4-16", "figure-4-17"), strict=True):
        exact = run(name, steps=s["solver"]["reference_steps"])
        for colour, steps in zip(COLOURS, s["solver"]["steps"], strict=False):
            off = run(name, solver="grid", steps=steps).theta2_deg - exact.theta2_deg
            ax.plot(exact.time_s, off, color=colour, label=f"{1.0 / steps:g} ms")
        ax.set(title=f"input of {name.replace('-', ' ', 1).replace('-', '.')}", xlabel="time [s]")
    figure.axes[0].set_ylabel("$\\theta_2$, grid minus exact edges [deg]")
    figure.axes[0].set_xlim(0.0, value("open_loop.duration"))
    figure.legend(*figure.axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=4)
    head(figure, "Third order on a grid: the missed valve edges add up")
    return figure
