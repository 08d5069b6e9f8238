"""Counterparts of figures D.8 to D.12, and what the rattling and the small volumes do."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pneumatic_models as models
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from loopshape.io.files import write_bytes_whole
from loopshape.toolbox.arm.source import value
from loopshape.view.style import COLOURS, QUIET, head, new_figure, png, styled

FIGURES = Path(__file__).parent.parent.parent / "figures" / Path(__file__).parent.name
FOUR = ("p_c", "p_1", "p_2", "p_m")
LOOK = dict(zip(FOUR, (COLOURS[0], COLOURS[6], COLOURS[2], COLOURS[1]), strict=True))


def draw(found: dict[str, Any], b: models.Bench) -> None:
    """Write all figures."""
    write_bytes_whole(FIGURES / "filling.png", png(filling(found["runs"], b)))
    write_bytes_whole(FIGURES / "flows.png", png(flows(found, b)))
    write_bytes_whole(FIGURES / "small_volumes.png", png(small(found)))


def pressures(ax: Axes, run: models.Filling, names: tuple[str, ...], line: str = "-", *, named: bool = True) -> None:
    """Curves of the pressures of a run."""
    for k, name in enumerate(names):
        label = f"${name}$" if named else None
        ax.plot(run.t_s, run.p_bar[:, k], line, color=LOOK[name], linewidth=0.9, label=label)


def decorate(ax: Axes, title: str, end_s: float) -> None:
    """Axes as the source's."""
    ax.set_title(title)
    ax.set_xlim(0.0, end_s)
    ax.set_ylim(0.0, 1.05)
    ax.set_xlabel("time [s]")
    ax.set_ylabel("pressure [bar]")


@styled()
def filling(runs: dict[str, models.Filling], b: models.Bench) -> Figure:
    """Figures D.8, D.9, D.10 and D.12."""
    figure = new_figure(2, 2, (7.0, 5.2))
    d8, d9, d10, d12 = figure.axes
    short_s = value("figure_d_9.duration")
    pressures(d8, runs["tuned"], FOUR, "--")
    pressures(d8, runs["pts2"], FOUR, named=False)
    d8.plot(runs["pts1"].t_s, runs["pts1"].p_bar[:, 3], ":", color=LOOK["p_m"], label="$p_m$, by dimensions")
    decorate(d8, "PTS1 tuned (dashed) to PTS2 (solid)", value("figure_d_8.duration"))
    pressures(d9, models.explicit(models.pts2(b), short_s, 5e-4, models.BOGACKI_SHAMPINE, keep=1), FOUR)
    d9.plot(*_curve(runs["pts2"], 3), color="black", linewidth=0.9, dashes=(2, 3), label="$p_m$, Radau")
    decorate(d9, "PTS2, third-order steps of 0.5 ms", short_s)
    pressures(d10, runs["pts2_pulsed"], FOUR)
    decorate(d10, "PTS2, block signal of 25 Hz, 50 %", short_s)
    d12.plot(*_curve(runs["pts3"], 0), color=LOOK["p_c"], label="$p_c$, PTS3")
    d12.plot(*_curve(runs["pts3"], 1), color=LOOK["p_m"], label="$p_m$, PTS3")
    d12.plot(*_curve(runs["pts2"], 3), color="black", linewidth=0.8, dashes=(2, 3), label="$p_m$, PTS2")
    decorate(d12, "PTS3, no small volumes", short_s)
    for ax in figure.axes:
        ax.legend(loc="lower right", ncols=2 if ax is not d8 else 1)
    head(figure, "Filling a fixed volume through a valve: throttles fill with a knee, Poiseuille with a tail")
    return figure


def _curve(run: models.Filling, column: int) -> tuple[np.ndarray, np.ndarray]:
    return run.t_s, run.p_bar[:, column]


@styled()
def flows(found: dict[str, Any], b: models.Bench) -> Figure:
    """Figure D.11 at two steps and by Radau, its rattle as the range over 10 ms; amplitude and onset over the step."""
    figure = new_figure(2, 2, (7.0, 5.2))
    for ax, step in zip(figure.axes[:2], (1e-3, 1e-4), strict=True):
        _flow_panel(
            ax,
            models.explicit(models.pts2(b), value("figure_d_9.duration"), step, models.BOGACKI_SHAMPINE, keep=1),
            found["runs"]["pts2"],
        )
        ax.set_title(f"PTS2's flows, steps of {1e3 * step:g} ms")
    figure.axes[1].legend(loc="upper right")
    size, onset = figure.axes[2:]
    for k, method in enumerate(("Euler", "Bogacki-Shampine", "RK4")):
        steps, rattles = _by_step(found, "pts2", method)
        size.loglog(steps, [1e4 * r.off for r in rattles], "o-", color=COLOURS[k], label=f"PTS2, {method}")
        onset.semilogx(steps, [r.onset_s for r in rattles], "o-", color=COLOURS[k], label=method)
    for kind, mark in (("float32", "x"), ("longdouble", "+")):
        row, r = next((row, r) for row, r in found["rattles"] if row[2] == kind)
        size.loglog(float(row[3]), 1e4 * r.off, mark, color="black", markersize=9, label=f"third order, {kind}")
    size.set_ylabel("error of $q_1$ [$10^{-4}$ kg/s]")
    size.set_title("its amplitude goes with the step, not with the digits")
    onset.axhline(value("figure_d_9.unstable_from"), color=QUIET, linestyle="--", linewidth=0.9, label="source")
    onset.set_ylim(0.0, 1.6)
    onset.set_ylabel("rattles from [s]")
    onset.set_title("and so does its onset")
    for ax in (size, onset):
        ax.set_xlabel("step [s]")
        ax.legend(loc="upper left" if ax is size else "lower left")
    size.set_ylim(1e-3, 1e3)
    head(figure, "The fluctuating flows are the explicit solver's, not the air's", "shaded: range within 10 ms")
    return figure


def _flow_panel(ax: Axes, run: models.Filling, true: models.Filling) -> None:
    blocks = np.array_split(np.arange(run.t_s.size), 160)
    t = np.array([run.t_s[rows].mean() for rows in blocks])
    for k, name, colour in ((1, "q_1", COLOURS[1]), (3, "q_2", COLOURS[2]), (0, "q_{in}", COLOURS[0])):
        q = 1e4 * run.q_kg_s[:, k]
        low, high = (np.array([of(q[rows]) for rows in blocks]) for of in (np.min, np.max))
        ax.fill_between(t, low, high, color=colour, alpha=0.35, linewidth=0.0)
        ax.plot(t, [np.mean(q[rows]) for rows in blocks], color=colour, linewidth=1.0, label=f"${name}$, mean")
    ax.plot(true.t_s[5:], 1e4 * true.q_kg_s[5:, 1], color="black", linewidth=0.9, dashes=(3, 2), label="$q_1$, Radau")
    ax.set_xlim(0.0, value("figure_d_9.duration"))
    ax.set_ylim(1.5 * value("figure_d_11.flow_low"), value("figure_d_11.flow_high"))
    ax.set_xlabel("time [s]")
    ax.set_ylabel("flow [$10^{-4}$ kg/s]")


def _by_step(found: dict[str, Any], model: str, method: str) -> tuple[list[float], list[Any]]:
    pairs = [(float(row[3]), r) for row, r in found["rattles"] if row[:3] == [model, method, "float64"]]
    return [h for h, _ in pairs], [r for _, r in pairs]


@styled()
def small(found: dict[str, Any]) -> Figure:
    """PTS2 against PTS3 over the small volumes."""
    figure = new_figure(1, 1, (4.8, 3.2))
    ax = figure.axes[0]
    table = np.array([[float(v) for v in row] for row in found["small"]])
    words = {2: "PTS3, hoses in series", 3: "the same, small volumes lumped", 4: "PTS3, valve alone"}
    words |= {5: "hoses in series, 25 Hz", 6: "lumped, 25 Hz"}
    for k, (column, label) in enumerate(words.items()):
        line = "s--" if column > 4 else "o-"
        ax.loglog(table[:, 1], 1e3 * table[:, column], line, color=COLOURS[k], label=label)
    ax.set_xlabel("each small volume [ml]")
    ax.set_ylabel("largest difference of $p_m$ [mbar]")
    figure.legend(loc="outside right center")
    head(figure, "PTS3 is the limit of PTS2")
    return figure
