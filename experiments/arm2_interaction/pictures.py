"""Pictures of the study: k_I and the matrix at three pressures, and where the two ways to measure part."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from loopshape.core.units import ComplexArray, db
from loopshape.data.response.frf import FRF
from loopshape.view.plots.curves import draw_band, frequency_axis
from loopshape.view.style import COLOURS, LIMIT, QUIET, head, new_figure, styled

#: |P| in dB that the source reads off its figure 5.8, in rad/V
SOURCE_DB = {(0, 0): -10.0, (0, 1): -30.0, (1, 0): -40.0, (1, 1): -20.0}
POINT = "(0, 0) deg, $p_A$ = 0.4 bar"


@styled()
def draw_coefficient(found: Sequence[Any]) -> Figure:
    """|k_I| of the angles at each pressure, measured both ways with 95 % bands, and linearised."""
    names = list(dict.fromkeys(one.name for one in found))
    pressures = sorted({one.p_c_bar for one in found})
    colours = dict(zip(pressures, COLOURS, strict=False))
    figure = new_figure(1, 2, (7.0, 3.6), sharey=True)
    for ax, name in zip(figure.axes, names, strict=True):
        for one in (x for x in found if x.name == name):
            f, k, colour = one.frf.frequency_hz, one.met.coefficients[0], colours[one.p_c_bar]
            ax.semilogx(f, db(linear_coefficient(one.bare)), color=colour, linewidth=0.8, linestyle=(0, (4, 2)))
            low = np.maximum(db(np.maximum(k.low, 1e-9)), -120.0)
            draw_band(ax, f, low, np.minimum(db(np.minimum(k.high, 1e9)), 60.0), color=colour, alpha=0.13)
            ax.semilogx(f, db(k.coefficient), color=colour)
        ax.semilogx([0.1, 4.0], [-20.0, -20.0], color=LIMIT, linewidth=1.4)
        ax.set_title(name, loc="left")
        frequency_axis(ax, 0.35, 8.0)
        ax.set_ylim(-75.0, 20.0)
    figure.axes[0].set_ylabel("|$k_I$| [dB]")
    keys = [Line2D([], [], color=colours[p], label=f"$p_C$ = {p:g} bar") for p in pressures]
    keys.append(Line2D([], [], color=QUIET, linewidth=0.8, linestyle=(0, (4, 2)), label="linearised"))
    keys.append(Line2D([], [], color=LIMIT, linewidth=1.4, label="the source: below, to 4 Hz"))
    figure.legend(handles=keys, loc="outside lower center", ncols=5)
    head(figure, f"Interaction of the two angles at {POINT}", "shaded: 95 % of each line, four realisations")
    return figure


def linear_coefficient(P: ComplexArray) -> ComplexArray:
    """k_I (nf,) of a plant (nf, 2, 2)."""
    return np.asarray(P[:, 0, 1] * P[:, 1, 0] / (P[:, 0, 0] * P[:, 1, 1]))


@styled()
def draw_matrix(found: Sequence[Any]) -> Figure:
    """|P| of the angles in the layout of the source's figure 5.8, with the levels that it gives."""
    figure = new_figure(2, 2, (7.0, 5.2), sharex=True, sharey=True)
    for (i, j), ax in zip(np.ndindex(2, 2), figure.axes, strict=True):
        for one, colour in zip(found, COLOURS, strict=False):
            f, H = one.frf.frequency_hz, one.frf.response[:, i, j]
            reach = 1.96 * np.sqrt(one.frf.variance[:, i, j] / 2.0)
            ax.semilogx(f, db(one.bare[:, i, j]), color=colour, linewidth=0.8, linestyle=(0, (4, 2)))
            draw_band(ax, f, db(np.maximum(np.abs(H) - reach, 1e-6)), db(np.abs(H) + reach), color=colour, alpha=0.18)
            ax.semilogx(f, db(H), color=colour, label=f"$p_C$ = {one.p_c_bar:g} bar")
        ax.axhline(SOURCE_DB[i, j], color=QUIET, linestyle=":", linewidth=1.2)
        ax.set_title(rf"$\theta_{{{i + 1}}}$ / $z_{{\theta {j + 1}}}$", loc="left")
        frequency_axis(ax, 0.12, 8.0, label=i == 1)
    for ax in figure.axes[::2]:
        ax.set_ylabel("|P| [dB re 1 rad/V]")
    figure.axes[0].set_ylim(-70.0, 20.0)
    keys = figure.axes[0].get_legend_handles_labels()[0]
    keys.append(Line2D([], [], color=QUIET, linewidth=0.8, linestyle=(0, (4, 2)), label="linearised"))
    keys.append(Line2D([], [], color=QUIET, linewidth=1.2, linestyle=":", label="level that the source reads"))
    figure.legend(handles=keys, loc="outside lower center", ncols=5)
    head(figure, f"Angles of the 2-DoF arm at {POINT}, pressures closed", "one loop at a time; shaded: 95 %")
    return figure


@styled()
def draw_cause(steps: Sequence[tuple[str, FRF, FRF, ComplexArray]], arm: Sequence[Any]) -> Figure:
    """What both at once measures over one at a time: the arm, and linear arms with one property of the valves each."""
    figure = new_figure(2, 2, (7.0, 5.0), sharex=True)
    looks = {
        "averaged valves": (COLOURS[6], "-", 1.0),
        "dead zone": (COLOURS[4], "-", 1.0),
        "filling unlike exhaust": (COLOURS[2], "-", 1.0),
        "and one throttle for all": (COLOURS[0], "-", 1.4),
    }
    cases = [(name, one.frequency_hz, both.response / one.response) for name, one, both, _ in steps if name in looks]
    cases.append(("the simulated arm", arm[0].frf.frequency_hz, arm[1].frf.response / arm[0].frf.response))
    for (i, j), ax in zip(np.ndindex(2, 2), figure.axes, strict=True):
        for name, f, ratio in cases:
            colour, line, width = looks.get(name, (COLOURS[1], "-", 0.9))
            ax.semilogx(f, db(ratio[:, i, j]), color=colour, linestyle=line, linewidth=width, label=name)
        ax.set_title(rf"$\theta_{{{i + 1}}}$ / $z_{{\theta {j + 1}}}$", loc="left")
        ax.set_ylim(-8.0, 8.0)
        frequency_axis(ax, 0.5, 8.0, label=i == 1)
    for ax in figure.axes[::2]:
        ax.set_ylabel("at once / one at a time [dB]")
    figure.legend(*figure.axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=3)
    head(
        figure, f"Why the two ways to measure differ, at {POINT}, $p_C$ = 0.4 bar", "linear arms with one property each"
    )
    return figure
