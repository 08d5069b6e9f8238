"""Figures of joint 1 alone: the plant over its fits, Nichols charts, steps."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.figure import Figure

from loopshape.core.units import db, deg
from loopshape.data.response.frf import FRF
from loopshape.data.response.model import Fit
from loopshape.data.signal.recording import Recording
from loopshape.toolbox.arm.dynamics.linear2 import Linearisation2
from loopshape.view.plots.curves import frequency_axis
from loopshape.view.style import COLOURS, FULL_WIDTH_IN, QUIET, head, new_figure, styled

PANELS = 8  # of a loop page


@styled()
def draw_plant(frfs: Sequence[FRF], fits: Sequence[Fit], linears: Sequence[Linearisation2]) -> Figure:
    """theta1/z_theta1 at every point: valid lines, third-order fit, linearisation."""
    figure = new_figure(2, 3, (FULL_WIDTH_IN, 4.6), sharex=True, sharey="row")
    f = np.geomspace(0.1, 10.0, 600)
    for k, (frf, fit, lin) in enumerate(zip(frfs, fits, linears, strict=True)):
        size, angle = figure.axes[k % 3], figure.axes[3 + k % 3]
        look = {"color": COLOURS[k // 3]}
        used = frf.valid
        H, P = fit.model.response(f), lin.response(f)[:, 0, 0]
        label = f"p_CD {frf.operating_point['p_cd_bar']:g} bar"
        size.semilogx(frf.frequency_hz[used], db(frf.siso[used]), ".", markersize=2.0, label=label, **look)
        angle.semilogx(frf.frequency_hz[used], _branch(frf.siso[used]), ".", markersize=2.0, **look)
        size.semilogx(f, db(H), linewidth=0.8, label="its third-order fit", **look)
        angle.semilogx(f, _branch(H), linewidth=0.8, **look)
        size.semilogx(f, db(P), linestyle=(0, (4, 2)), linewidth=0.7, color=QUIET, zorder=1.0)
        angle.semilogx(f, _branch(P), linestyle=(0, (4, 2)), linewidth=0.7, color=QUIET, zorder=1.0)
        size.set_title(f"theta1 = {frf.operating_point['theta1_deg']:g} deg")
    figure.axes[0].set_ylabel("|theta1/z_theta1| [dB re rad/V]")
    figure.axes[3].set_ylabel("phase [deg]")
    figure.axes[0].set_ylim(-70.0, 30.0)
    figure.axes[0].set_yticks(np.arange(-60.0, 21.0, 20.0))
    figure.axes[3].set_ylim(-400.0, 0.0)
    figure.axes[3].set_yticks(np.arange(-360.0, 1.0, 90.0))
    for ax in figure.axes[3:]:
        frequency_axis(ax, 0.1, 10.0)
    handles, labels = figure.axes[0].get_legend_handles_labels()
    handles += [figure.axes[0].plot([], [], color=QUIET, linestyle=(0, (4, 2)), linewidth=0.7)[0]]
    figure.legend(handles, [*labels, "linearisation"], loc="outside lower center", ncols=5)
    head(figure, "Joint 1 alone: the response theta1/z_theta1 of the simulated arm at six working points")
    return figure


def _branch(H: np.ndarray) -> np.ndarray:
    """Phase in deg between -405 and -45."""
    return np.mod(deg(np.angle(H)) + 45.0, 360.0) - 405.0


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
def draw_steps(runs: Mapping[str, Recording]) -> Figure:
    """theta1, theta2, p_CD and p_AB over time under each controller."""
    figure = new_figure(3, 1, (FULL_WIDTH_IN, 5.4), sharex=True)
    for k, (name, r) in enumerate(runs.items()):
        t, look = r.column("t_s"), {"color": COLOURS[k], "linewidth": 0.9, "label": name}
        figure.axes[0].plot(t, deg(r.column("theta1_rad")), **look)
        figure.axes[1].plot(t, deg(r.column("theta2_rad")), **look)
        figure.axes[2].plot(t, r.column("p_c_bar") + r.column("p_d_bar"), **look)
    for ax, column, scale in ((figure.axes[0], "r_theta1_rad", deg(1.0)), (figure.axes[2], "r_p_cd_bar", 1.0)):
        ax.plot(t, scale * r.column(column), color="black", linewidth=0.7, label="setpoint")
    for ax, label in zip(figure.axes, ("theta1 [deg]", "theta2 [deg]", "p_CD [bar]"), strict=True):
        ax.set_ylabel(label)
    figure.axes[2].set_xlabel("time [s]")
    figure.axes[0].legend(loc="upper right", ncols=3)
    figure.axes[0].set_ylim(-7.0, 17.0)
    head(figure, "Joint 1 alone: steps of theta1 and of p_CD, A and B held at 0.95 bar each")
    return figure
