"""Counterparts of figures 3.3, C.2 to C.4, C.6 and C.7; the lag; the loop at rest."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from loopshape.io.files import write_bytes_whole
from loopshape.toolbox.arm.source import value
from loopshape.view.plots.curves import frequency_axis
from loopshape.view.style import COLOURS, QUIET, head, new_figure, png, styled

FIGURES = Path(__file__).parent.parent.parent / "figures" / Path(__file__).parent.name


def draw(found: dict[str, Any]) -> None:
    """Write all figures."""
    write_bytes_whole(FIGURES / "examples.png", png(examples(found)))
    write_bytes_whole(FIGURES / "ripple.png", png(ripple(found)))
    write_bytes_whole(FIGURES / "lag.png", png(lag(found)))
    write_bytes_whole(FIGURES / "rest.png", png(rest(found)))


@styled()
def examples(found: dict[str, Any]) -> Figure:
    """Figures 3.3, C.6 and C.7."""
    figure = new_figure(2, 2, (7.0, 5.0), height_ratios=(2.0, 2.2))
    for ax, (name, words) in zip(
        figure.axes[:2], (("figure_3_3", "first example"), ("figure_c_6", "second example")), strict=True
    ):
        e = found["examples"][name]
        ax.plot(e["t"], e["threshold"], color=QUIET, linewidth=0.6, label="threshold $v_{th}$")
        ax.plot(e["t"], e["u"], color=COLOURS[0], label="$u$")
        ax.plot(e["t"], e["held"], color=COLOURS[1], linewidth=0.9, label="$u(t_k)$")
        ax.fill_between(e["t"], -0.55, -0.55 + 0.35 * e["valve"], step="mid", color=COLOURS[2], label="valve open")
        ax.set_title(f"{words}: {value(name + '.pwm_frequency'):g} Hz, dead zone {value(name + '.dead_zone'):g}")
        ax.set_xlabel("time [s]")
        ax.set_xlim(0.0, e["t"][-1])
        ax.set_ylim(-0.6, 1.2)
        ax.set_yticks([0.0, 0.5, 1.0])
    figure.axes[0].set_ylabel("command, threshold [1]")
    left, right = figure.axes[2:]
    for (low, high, x, y, _), ax, colour in zip(found["saturation"], (left, left, right, right), COLOURS, strict=False):
        ax.plot(x, y, color=colour, label=f"from {low:g} to {high:g}")
    for ax in (left, right):
        ax.set_title("saturations")
        ax.set_xlabel("x [1]")
        ax.set_ylim(-2.0, 2.0)
        ax.legend(loc="upper left")
    left.set_ylabel("y [1]")
    handles, labels = figure.axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=4)
    head(figure, "A sampled command against a clipped sawtooth gives one pulse a period")
    return figure


@styled()
def ripple(found: dict[str, Any]) -> Figure:
    """Figures C.2, C.3, C.4, each whole and enlarged."""
    figure = new_figure(2, 3, (7.0, 4.8), sharey="row")
    for k, (name, run) in enumerate(found["fillings"].items()):
        whole, part = figure.axes[k], figure.axes[3 + k]
        for ax in (whole, part):
            for column, label, colour in (
                (0, "$p_{in}$", COLOURS[0]),
                (2, "$p_{valve}$", COLOURS[2]),
                (3, "$p_{out}$", COLOURS[1]),
            ):
                ax.plot(run.t_s, run.p_bar[:, column], color=colour, linewidth=0.8, label=label)
            ax.set_xlabel("time [s]")
        whole.set_title(f"block signal of {value(name + '.frequency'):g} Hz")
        whole.set_xlim(0.0, value("figure_c_2.duration"))
        whole.set_ylim(0.0, 1.05)
        middle = float(run.t_s[np.argmax(run.p_bar[:, 3] >= 0.5)])
        part.set_xlim(middle - 0.1, middle + 0.1)
        part.set_ylim(0.42, 0.58)
    for ax in (figure.axes[0], figure.axes[3]):
        ax.set_ylabel("pressure [bar]")
    figure.axes[2].legend(loc="lower right")
    head(figure, "A block signal fills in the same time at every frequency; only the ripple changes")
    return figure


@styled()
def lag(found: dict[str, Any]) -> Figure:
    """The lag over the amplitude at 5 Hz, and over the frequency."""
    figure = new_figure(1, 2, (7.0, 3.4))
    left, right = figure.axes
    dead_zone = value("pwm_dead_zone")
    rows = np.array([r for r in found["lags"] if r[0] == dead_zone], dtype=float)
    for k, offset in enumerate(np.unique(rows[:, 1])):
        some = rows[(rows[:, 1] == offset) & (rows[:, 3] == 5.0)]
        left.semilogx(some[:, 2], some[:, 5], "o", color=COLOURS[k], label=f"about {offset:g} V")
        left.semilogx(some[:, 2], some[:, 6], color=COLOURS[k], linewidth=0.8)
    left.axhline(18.0, color="black", linestyle=":", linewidth=0.9, label="zero-order hold")
    left.axhline(value("pwm_phase_lag_5hz"), color=QUIET, linestyle="--", linewidth=0.9, label="source")
    left.set_xlabel("amplitude of u [V]")
    left.set_ylabel("lag at 5 Hz [deg]")
    left.set_ylim(0.0, 34.0)
    left.set_title("dots: computed; lines: from the pulses' lengths")
    for k, a in enumerate((0.05, 0.2, 0.65, 3.0)):
        some = rows[(rows[:, 1] == 0.0) & (rows[:, 2] == a)]
        right.loglog(some[:, 3], some[:, 5], "o-", color=COLOURS[k], label=f"{a:g} V about 0")
    right.loglog(some[:, 3], some[:, 7], ":", color="black", label="zero-order hold")
    right.plot(5.0, value("pwm_phase_lag_5hz"), "*", color=QUIET, markersize=10, label="source")
    right.set_ylabel("lag [deg]")
    right.set_title("over the frequency")
    frequency_axis(right, 0.5, 20.0)
    left.legend(loc="upper left", ncols=2)
    right.legend(loc="lower right")
    right.set_ylim(0.002, 100.0)
    head(figure, "The PWM's lag is what its pulses are long: no constant, and seldom a hold's")
    return figure


@styled()
def rest(found: dict[str, Any]) -> Figure:
    """Ripple, pulses and static error over the dead zone; and what the motion looks like."""
    figure = new_figure(2, 2, (7.0, 5.4))
    span, pulses, error, trace = figure.axes
    conditions = list(dict.fromkeys(r[0] for r in found["rest"]))
    for k, condition in enumerate(conditions):
        rows = np.array([[float(v) for v in r[1:8]] for r in found["rest"] if r[0] == condition])
        tau = np.maximum(rows[:, 0], 5e-4)
        look: dict[str, Any] = {"color": COLOURS[k], "label": condition, "marker": "os^DvPX"[k], "linewidth": 0.9}
        span.loglog(tau, np.maximum(rows[:, 1], 1e-4), **look)
        pulses.semilogx(tau, rows[:, 4], **look)
        error.loglog(tau, np.maximum(rows[:, 6], 1e-4), **look)
    for ax, title, unit in (
        (span, "motion at rest, median run", "theta2, peak to peak [deg]"),
        (pulses, "pulses of all valves", "pulses [1/s]"),
        (error, "static error, largest run", "|theta2 - reference| [deg]"),
    ):
        ax.set_title(title)
        ax.set_ylabel(unit)
        ax.set_xlabel("dead zone [1]")
        ax.set_xticks([5e-4, 1e-3, 1e-2, 1e-1], ["0", "0.001", "0.01", "0.1"])
        ax.axvline(value("pwm_dead_zone"), color=QUIET, linewidth=0.8, linestyle="--")
    for condition in ("late valves, neither", "noise and converters", "neither"):
        r = next(r for r in found["rest_runs"] if r.condition == condition and r.dead_zone == 0.0)
        x = r.theta_deg[:3000] - r.theta_deg.mean()
        trace.plot(0.001 * np.arange(x.size), x, color=COLOURS[conditions.index(condition)], linewidth=0.8)
    trace.set_title("three of them without dead zone")
    trace.set_xlabel("time [s]")
    trace.set_ylabel("theta2 about its mean [deg]")
    handles, labels = span.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=2)
    head(
        figure,
        "What keeps the arm moving at rest: noise, converters, and valves that close late",
        "marks at 1e-4 deg: that or less; dashed: the source's dead zone",
    )
    return figure
