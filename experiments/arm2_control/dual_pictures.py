"""Figures of both joints: steps of figures 5.11 and 5.12, and the damping."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from loopshape.core.units import deg
from loopshape.data.signal.recording import Recording
from loopshape.view.style import COLOURS, FULL_WIDTH_IN, QUIET, head, new_figure, styled

PANELS = 8  # of a loop page
_ROWS = (
    ("theta1 [deg]", "theta1_rad"), ("p_C [bar]", "p_c_bar"), ("theta2 [deg]", "theta2_rad"), ("p_A [bar]", "p_a_bar"),
)  # fmt: skip
_WORDS = {
    "joint-1": ("figure_5_11", "Steps of theta1 and p_C, simulated arm of two joints"),
    "joint-2": ("figure_5_12", "Steps of theta2 and p_A, simulated arm of two joints"),
}


@styled()
def draw_steps(runs: Mapping[str, Sequence[Recording]]) -> dict[str, Figure]:
    """A page an experiment: left the run that ends by itself, right 3 s of each step of the other."""
    out = {}
    for k, (name, title) in enumerate(_WORDS.values()):
        own, early = runs["plant's own"][k], runs["source's"][k]
        steps = _steps_s(own)
        figure = new_figure(4, 1 + len(steps), (FULL_WIDTH_IN, 6.4), sharey="row", sharex="col")
        for row, (label, column) in enumerate(_ROWS):
            scale = float(deg(1.0)) if column.endswith("_rad") else 1.0
            axes = figure.axes[row * (1 + len(steps)) : (row + 1) * (1 + len(steps))]
            axes[0].plot(
                early.column("t_s"), scale * early.column(column), color=COLOURS[1], label="source's controllers"
            )
            for ax, at_s in zip(axes[1:], steps, strict=True):
                _around(ax, own, column, scale, at_s)
            axes[0].set_ylabel(label)
        for ax, words in zip(figure.axes, ("until the end", *(f"step at {at:g} s" for at in steps)), strict=False):
            ax.set_title(words, loc="left")
        for ax in figure.axes[-1 - len(steps) :]:
            ax.set_xlabel("time [s]")
        (left,), right = figure.axes[0].lines, figure.axes[1].lines
        figure.legend(handles=[left, *right], loc="outside lower center", ncols=3)
        head(figure, title)
        out[name] = figure
    return out


def _steps_s(r: Recording) -> list[float]:
    """When a setpoint jumps."""
    t = r.column("t_s")
    jumps = {
        round(float(t[k]), 2) for _, c in _ROWS for k in np.flatnonzero(np.abs(np.diff(r.column(f"r_{c}"))) > 0.02)
    }
    return sorted(jumps)


def _around(ax: Axes, r: Recording, column: str, scale: float, at_s: float) -> None:
    t = r.column("t_s")
    rows = (t > at_s - 0.5) & (t < at_s + 3.0)
    ax.plot(t[rows] - at_s, scale * r.column(column)[rows], color=COLOURS[0], label="plant's own controllers")
    ax.plot(t[rows] - at_s, scale * r.column(f"r_{column}")[rows], color="black", linewidth=0.7, label="setpoint")


def entitled(figure: Figure, title: str) -> Figure:
    """A loop page or chart under what it shows here, not its general title; a page's notes clear of its curves."""
    next(t for t in figure.texts if t.get_text().startswith(("Loop shaping", "Open loop"))).set_text(title)
    if len(figure.axes) == PANELS:
        for ax, place in ((figure.axes[3], "lower left"), (figure.axes[6], "lower right")):  # phase of C, |S|
            low, high = ax.get_ylim()
            ax.set_ylim(low - 0.3 * (high - low), high)
            notes = ax.get_legend()
            if notes is not None:
                notes.set_loc(place)
    return figure


@styled()
def draw_damping(linear: Sequence[Sequence], simulated: Sequence[Sequence]) -> Figure:
    """Overshoot and damping of theta2 against the bandwidth of p_A's loop."""
    figure = new_figure(1, 2, (FULL_WIDTH_IN, 4.2), sharex=True)
    over, damping = figure.axes
    for name, colour in (("dual", COLOURS[0]), ("pairs", COLOURS[1])):
        for factor, dash in ((0.5, ":"), (1.0, "-"), (2.0, "--")):
            rows = [r for r in linear if r[0] == name and r[1] == factor and r[5] != ""]
            x = [float(r[3]) for r in rows]
            look = {"color": colour, "linestyle": dash}
            label = f"{name}, theta2's gain x {factor:g}"
            over.semilogx(x, [float(r[5]) for r in rows], label=label, **look)
            damping.semilogx(x, [float(r[9]) for r in rows], **look)
        hz = {float(r[2]): float(r[3]) for r in linear if r[0] == name and r[1] == 1.0}
        for size, mark in ((3.0, "o"), (15.0, "s")):
            mine = [r for r in simulated if r[0] == name and r[1] == size and r[7] == ""]
            x = [hz[r[2]] for r in mine if r[2] in hz]
            y = [float(r[3]) for r in mine if r[2] in hz]
            over.plot(x, y, mark, color=colour, markerfacecolor="white", label=f"{name}, simulated, {size:g} deg")
    own = next(float(r[4]) for r in linear if r[0] == "dual" and r[1] == 1.0)
    for ax in figure.axes:
        ax.axvline(own, color=QUIET, linewidth=0.8)
        ax.set_xlabel("bandwidth of the pressure loop [Hz]")
    over.set_title("overshoot of theta2's step")
    over.set_ylabel("overshoot [%]")
    damping.set_title("damping of its leading oscillation, linear")
    damping.set_ylabel("damping ratio [1]")
    damping.set_ylim(0.0, 1.0)
    over.set_ylim(0.0, None)
    handles, labels = over.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=3)
    head(
        figure,
        "The damping that a pressure loop adds to theta2 (section 5.3.3)",
        "lines: linearisation; marks: simulated arm, theta2's gain x 1; grey: bandwidth of theta2's own loop, gain x 1",
    )
    return figure
