"""Pictures of the study: maps, points, where the stiffnesses part, stability, crossing lines."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Rectangle
from standing import MODELS, arm, off_square_deg

from loopshape.core.units import Array
from loopshape.toolbox.arm.equilibria_pictures import contours_by_angle, contours_by_pressures
from loopshape.toolbox.arm.source import value
from loopshape.view.style import COLOURS, LIMIT, QUIET, head, new_figure, shades, styled

Maps = Mapping[str, tuple[Array, ...]]
Rows = Sequence[Sequence[object]]
LOOK = {"fitted": COLOURS[0], "analytical": COLOURS[1]}


def pages(
    maps: Maps, points: Rows, cuts: Mapping[str, Mapping[float, Array]], firm: Maps, moves: Rows, s: dict
) -> list[tuple[str, Figure]]:
    """All pages by name."""
    return [
        ("maps", draw_maps(maps)),
        ("points", draw_points(points)),
        ("where_they_part", draw_parting(cuts, moves, s)),
        ("stability", draw_stability(firm)),
        ("decoupling", draw_decoupling(maps)),
    ]


@styled()
def draw_maps(maps: Maps) -> Figure:
    """Figures 4.7 and 4.8, and the same of the analytical stiffness."""
    figure = new_figure(2, 2, (7.0, 7.4))
    titles = (
        ("angle, fitted stiffness", "pressures, fitted stiffness"),
        ("angle, analytical stiffness", "pressures, analytical stiffness"),
    )
    for k, (name, row) in enumerate(zip(maps, titles, strict=True)):
        grid, theta, angles, sums, p_a, p_b = maps[name]
        left, right = figure.axes[2 * k : 2 * k + 2]
        contours_by_pressures(grid, grid, theta, ax=left)
        contours_by_angle(angles, sums, p_a, p_b, ax=right)
        for ax, title in zip((left, right), row, strict=True):
            below(ax)
            ax.set_title(title)
    head(figure, "Where the arm stands, and what pressures hold it")
    return figure


def below(ax: Axes) -> None:
    """Move a legend that stands where the title goes."""
    legend = ax.get_legend()
    handles, texts = legend.legend_handles, [t.get_text() for t in legend.get_texts()]
    legend.remove()
    ax.legend(handles, texts, loc="upper center", bbox_to_anchor=(0.5, -0.14), ncols=2, columnspacing=1.2)


@styled()
def draw_points(points: Rows) -> Figure:
    """Figures 4.9 and 4.10: setpoints, and the pressures that hold them with both stiffnesses."""
    figure = new_figure(1, 2, (7.0, 3.9))
    left, right = figure.axes
    for row in points:
        theta, p_ab, pa_f, pb_f, pa_a, pb_a = (float(str(x)) for x in row[:6])
        fill = {"markerfacecolor": None if row[6] else "white"}
        there = float(str(row[7]))
        left.plot([theta, there], [p_ab, p_ab], color="0.1", linewidth=0.7)
        left.plot(theta, p_ab, "o", color=LOOK["fitted"], **fill)
        left.plot(there, p_ab, "s", color=LOOK["analytical"], **fill)
        if np.isnan(there):
            left.annotate("beyond 45 deg", (theta, p_ab), (0, 5), textcoords="offset points", ha="center", fontsize=7)
        right.plot([pa_f, pa_a], [pb_f, pb_a], color="0.1", linewidth=0.7)
        right.plot(pa_f, pb_f, "o", color=LOOK["fitted"], **fill)
        right.plot(pa_a, pb_a, "s", color=LOOK["analytical"], **fill)
    low, high = value("equilibria.pressure_low"), value("equilibria.pressure_high")
    right.add_patch(Rectangle((low, low), high - low, high - low, fill=False, edgecolor=QUIET, linestyle=":"))
    good = value("equilibria.model_good_angle")
    corner = (-good, value("equilibria.model_good_from"))
    box = Rectangle(corner, 2 * good, value("equilibria.model_good_to") - corner[1], color="0.92", zorder=0)
    left.add_patch(box)
    left.set(xlim=(-48, 48), ylim=(0.35, 2.0), xlabel="$\\theta_2$ [deg]", ylabel="$p_{AB}$ [bar]")
    right.set(xlim=(0.1, 1.25), ylim=(0.1, 1.25), xlabel="$p_A$ [bar]", ylabel="$p_B$ [bar]", aspect="equal")
    left.set_title("where the fitted arm's pressures lead")
    right.set_title("pressures that hold the setpoints")
    legend_points(figure)
    head(figure, "The 24 setpoints: fitted and analytical stiffness")
    return figure


def legend_points(figure: Figure) -> None:
    """What the marks mean."""
    marks = [
        Line2D([], [], marker="o", color=LOOK["fitted"], linestyle="none", label="fitted"),
        Line2D([], [], marker="s", color=LOOK["analytical"], linestyle="none", label="analytical"),
        Line2D([], [], marker="o", color="0.3", markerfacecolor="white", linestyle="none", label="above the supply"),
        Line2D([], [], color="0.85", linewidth=5, label="good range, by the text"),
        Line2D([], [], color=QUIET, linestyle=":", label="measured range, by the text"),
    ]
    figure.legend(handles=marks, loc="outside lower center", ncols=5, columnspacing=0.9, handlelength=1.4)


@styled()
def draw_parting(cuts: Mapping[str, Mapping[float, Array]], moves: Rows, s: dict) -> Figure:
    """Shifts over the angle: analytical against fitted, and what moves the fitted arm."""
    figure = new_figure(1, 2, (7.0, 3.7), sharey=True)
    left, right = figure.axes
    angles = cuts["angles"][0.0]
    for (p_ab, shift), colour in zip(cuts["analytical"].items(), shades(len(cuts["analytical"])), strict=True):
        left.plot(angles, shift, color=colour, label=f"{p_ab:g} bar")
        left.plot(angles, cuts["held"][p_ab], color=colour, linestyle="--", linewidth=0.8)
    good, half = value("equilibria.model_good_angle"), 0.5 * value("equilibria.angular_shift")
    left.add_patch(Rectangle((-good, -half), 2 * good, 2 * half, color="0.92", zorder=0))
    left.legend(title="$p_{AB}$", title_fontsize=8, loc="upper center")
    left.set_title("analytical (dashed: fitted, k of one length)")
    draw_moves(right, moves, s["sensitivity"])
    for ax in figure.axes:
        ax.set_xlim(-30, 30)
        ax.set_xlabel("$\\theta_2$ of the fitted arm [deg]")
    left.set_ylim(-17, 17)
    left.set_ylabel("shift at the same pressures [deg]")
    head(
        figure,
        "Where the stiffnesses part: it is the dependence on the length",
        "grey: the range that the text calls good, and half the shift that it reports elsewhere",
    )
    return figure


def draw_moves(ax: Axes, moves: Rows, s: dict) -> None:
    """What moves the fitted arm at one p_AB."""
    table = {str(row[0]): np.array(row[2:], dtype=float) for row in moves}
    angles = s["angles_deg"]
    length, slack = value("muscles.nominal_length_spread"), value("muscles.hysteresis")
    share = value("muscles.stiffness_spread")
    names = {
        "A longer by the spread of h0": f"A: h0 +{length:g} mm",
        "both shorter by the spread of h0": f"A and B: h0 -{length:g} mm",
        "A stiffer by the spread of k": f"A: k +{share:g} %",
        "A longer by the hysteresis of h0": f"A: h0 +{slack:g} mm",
    }
    for (name, label), colour in zip(names.items(), COLOURS[2:], strict=False):
        ax.plot(angles, table[name], "o-", color=colour, label=label)
    low, high = table["digits of table 4.1 (2.5 %)"], table["digits of table 4.1 (97.5 %)"]
    ax.fill_between(angles, low, high, color="0.6", alpha=0.8, label="digits of table 4.1, 95 %")
    ax.legend(loc="upper right", fontsize=7)
    ax.set_title(f"what moves the fitted arm at {s['p_ab_bar']:g} bar")


@styled()
def draw_stability(firm: Maps) -> Figure:
    """Stiffness of the joint over angle and p_AB."""
    figure = new_figure(1, 2, (7.0, 3.9), sharey=True)
    for ax, (name, (angles, sums, open_, shut, absolute)) in zip(figure.axes, firm.items(), strict=True):
        levels = [2.0, 5.0, 10.0, 15.0, 20.0, 25.0]
        lines = ax.contour(angles, sums, np.ma.masked_invalid(open_), levels, colors="0.45", linewidths=0.8)
        ax.clabel(lines, fmt="%g", fontsize=7)
        for z, colour, dash in ((open_, LIMIT, "-"), (shut, COLOURS[0], "--"), (absolute, COLOURS[2], "-.")):
            if np.nanmin(z) < 0.0:
                ax.contour(
                    angles, sums, np.ma.masked_invalid(z), [0.0], colors=[colour], linestyles=[dash], linewidths=1.4
                )
        if np.nanmin(open_) < 0.0:
            ax.contourf(angles, sums, np.ma.masked_invalid(open_), [-99.0, 0.0], colors=[LIMIT], alpha=0.15)
        ax.set_title(f"{name} stiffness")
        ax.set_xlabel("$\\theta_2$ [deg]")
    figure.axes[0].set_ylabel("$p_{AB}$ [bar]")
    handles = [
        Line2D([], [], color="0.45", linewidth=0.8, label="N m/rad at constant pressure"),
        Line2D([], [], color=LIMIT, label="0 at constant pressure"),
        Line2D([], [], color=COLOURS[0], linestyle="--", label="0, closed valves, gauge"),
        Line2D([], [], color=COLOURS[2], linestyle="-.", label="0, closed valves, absolute"),
    ]
    figure.legend(handles=handles, loc="outside lower center", ncols=2)
    head(
        figure,
        "How firmly the joint stands: the fitted arm falls at low pressure, the analytical one does not",
        "where contours end at the bottom, no pair of pressures holds the angle",
    )
    return figure


@styled()
def draw_decoupling(maps: Maps) -> Figure:
    """Figure 5.1: lines of theta2 and of p_AB in the plane of the pressures, and how far from square they cross."""
    figure = new_figure(1, 2, (7.0, 3.9))
    left, right = figure.axes
    for name, dash in (("analytical", "--"), ("fitted", "-")):
        grid, theta = maps[name][:2]
        z = np.ma.masked_invalid(theta)
        lines = left.contour(
            grid, grid, z, [-30, -15, 0, 15, 30], colors=[LOOK[name]], linestyles=[dash], linewidths=1.1
        )
        if name == "fitted":
            left.clabel(lines, fmt="%g", fontsize=7)
        angles = np.linspace(-30.0, 30.0, 31)
        for p_ab, width in ((0.8, 0.8), (1.2, 1.4)):
            off = [abs(off_square_deg(arm(MODELS[name]), t, p_ab)) for t in angles]
            right.plot(angles, off, color=LOOK[name], linestyle=dash, linewidth=width, label=f"{name}, {p_ab:g} bar")
    total = grid[:, None] + grid[None, :]
    left.contour(grid, grid, total, np.arange(0.8, 2.0, 0.2), colors=["0.7"], linewidths=0.8)
    left.set(xlabel="$p_A$ [bar]", ylabel="$p_B$ [bar]", aspect="equal")
    left.set_title("$\\theta_2$ (colours), $p_{AB}$ (grey)")
    right.set(xlabel="$\\theta_2$ [deg]", ylabel="off 90 deg [deg]", xlim=(-30, 30), ylim=(0, 45))
    right.set_title("how far from square they cross")
    right.legend(loc="upper center")
    head(figure, "Angle and summed pressure are perpendicular at 0 deg only, with both stiffnesses")
    return figure
