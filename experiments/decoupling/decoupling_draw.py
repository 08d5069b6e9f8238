"""Figures of the study: maps over the working range, k_I over frequency, and where the coupling comes from."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from decoupling_measure import LIMIT_DB, Found, bands, coefficient
from decoupling_static import behind, lines
from matplotlib.axes import Axes
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from loopshape.core.errors import WrongUseError
from loopshape.core.units import Array, db
from loopshape.toolbox.arm.dynamics.linear import linearise
from loopshape.toolbox.arm.parameters import ARM1_PARAMETERS, constants
from loopshape.view.plots.curves import draw_band, frequency_axis
from loopshape.view.style import COLOURS, LIMIT, QUIET, head, new_figure, shades, styled

SCALE = Normalize(-60.0, 0.0)
MAP = "viridis"
Maps = tuple[Array, Array, dict[str, Array]]
COLUMNS = {
    "none": "as the source has it",
    "own, linearised": "static, from linearising",
    "own, measured": "static, measured",
}
LEVELS_DB = np.arange(-60.0, 1.0, 5.0)


def linear_maps(settings: Mapping[str, Any]) -> tuple[Array, Array, dict[str, Array]]:
    """Largest linearised |k_I| in dB (n, m) in the bandwidth and at the mode, over theta2 (m,) and p_AB (n,)."""
    angles, sums = (np.linspace(a, b, int(n)) for a, b, n in (settings[f"map_{k}"] for k in ("theta2_deg", "p_ab_bar")))
    c = constants(ARM1_PARAMETERS.vector())
    out = {name: np.full((sums.size, angles.size), np.nan) for name in ("bandwidth", "mode")}
    for i, j in np.ndindex(sums.size, angles.size):
        try:
            lin = linearise(c, float(angles[j]), float(sums[i]))
        except WrongUseError:
            continue
        if not np.isfinite(lin.fill).all() or min(lin.fill) <= 0.0:
            continue  # a muscle above the supply's pressure
        where = bands(settings, lin.third_order()[1])
        for name, each in out.items():
            each[i, j] = db(coefficient(lin.response(np.linspace(*where[name], 21)))).max()
    return angles, sums, out


@styled()
def draw_maps(
    found: Sequence[Found], W: Mapping[str, Sequence[Array]], maps: tuple[Array, Array, dict[str, Array]]
) -> Figure:
    """|k_I| over the working range: linearised map, measured points, and measured behind static matrices."""
    figure = new_figure(2, 3, (7.2, 5.6), sharex=True, sharey=True)
    for k, band in enumerate(("bandwidth", "mode")):
        for j, (name, title) in enumerate(COLUMNS.items()):
            ax = figure.axes[3 * k + j]
            if name == "none":
                ax.contourf(*maps[:2], maps[2][band], levels=LEVELS_DB, cmap=MAP, norm=SCALE, extend="both", alpha=0.55)
            points = [behind(one, w)[band].estimate_db for one, w in zip(found, W[name], strict=True)]
            dots(ax, found, points)
            ax.set_title(title if k == 0 else "")
            if k == 1:
                ax.set_xlabel(r"$\theta_2$ [deg]")
        figure.axes[3 * k].set_ylabel(("1 to 3 Hz" if k == 0 else "at the mode") + "\n" + r"$p_{AB}$ [bar]")
    image = figure.axes[0].scatter([], [], c=[], cmap=MAP, norm=SCALE)
    figure.colorbar(image, ax=figure.axes, label="largest |$k_I$| [dB]", aspect=40, pad=0.01, extend="both")
    head(figure, r"Interaction of $\theta_2$ and $p_{AB}$ over the working range",
         f"points: measured, framed red where it is above {LIMIT_DB:g} dB;",
         "behind them at the left: linearised with averaged valves, supply 1 bar")  # fmt: skip
    return figure


def dots(ax: Axes, found: Sequence[Found], values_db: Sequence[float]) -> None:
    """A disc with its number for each equilibrium."""
    x, y = [one.theta2_deg for one in found], [one.p_ab_bar for one in found]
    colour = np.nan_to_num(np.array(values_db), nan=-100.0)
    edge = [LIMIT if v > LIMIT_DB else "white" for v in colour]
    ax.scatter(x, y, c=colour, cmap=MAP, norm=SCALE, s=210.0, edgecolors=edge, linewidths=1.4, zorder=3)
    for a, b, v in zip(x, y, colour, strict=True):
        ax.text(
            a, b, f"{v:.0f}", ha="center", va="center", fontsize=6.5, color="black" if v > -25.0 else "white", zorder=4
        )
    ax.set_xlim(-38.0, 38.0)
    ax.set_ylim(0.68, 1.92)
    ax.set_xticks([-30, -15, 0, 15, 30])


@styled()
def draw_curves(found: Sequence[Found]) -> Figure:
    """|k_I| over frequency by the size of the angle, coloured by p_AB; the other sign dotted."""
    figure = new_figure(1, 3, (7.2, 3.9), sharex=True, sharey=True)
    sums = sorted({one.p_ab_bar for one in found})
    colour = dict(zip(sums, shades(len(sums)), strict=True))
    for ax, size in zip(figure.axes, (0.0, 15.0, 30.0), strict=True):
        for one in (x for x in found if abs(x.theta2_deg) == size):
            curve(ax, one, colour[one.p_ab_bar])
        ax.axhline(LIMIT_DB, color=LIMIT, linestyle="--", linewidth=1.0)
        ax.set_title(f"{size:g} deg" if size == 0.0 else f"+{size:g} deg, and -{size:g} deg (dotted)")
        frequency_axis(ax, 0.4, 10.0)
    figure.axes[0].set_ylim(-110.0, 5.0)
    figure.axes[0].set_ylabel("|$k_I$| [dB]")
    keys = [Line2D([], [], color=c, label=f"{p:g} bar") for p, c in colour.items()]
    keys.append(Line2D([], [], color=QUIET, linestyle=(0, (4, 2)), linewidth=0.8, label="linearised"))
    keys.append(Line2D([], [], color=LIMIT, linestyle="--", label=f"{LIMIT_DB:g} dB (appendix H.7)"))
    figure.legend(handles=keys, loc="outside lower center", ncols=4)
    head(
        figure,
        r"$|k_I|$ of $\theta_2$ and $p_{AB}$ at all 24 equilibria, measured",
        "shaded: 95 % of each line (not where an element drowns in noise); linearised at 0 deg: below the axis",
    )
    return figure


def curve(ax: Axes, one: Found, colour: str) -> None:
    """One equilibrium on its valid lines; band and linearisation for angles that are not negative."""
    use = lines(one, (one.bands_hz["below"][0], one.bands_hz["above"][1]))
    c, f = one.met.coefficients[0], one.frf.frequency_hz[use]
    negative = one.theta2_deg < 0.0
    ax.semilogx(f, db(c.coefficient[use]), color=colour, linestyle=":" if negative else "-", linewidth=1.0)
    if negative:
        return
    seen = (c.low[use] > 0.0) | (one.theta2_deg == 0.0)  # elsewhere an element may be zero, and the band has no foot
    low, high = np.where(seen, np.maximum(c.low[use], 1e-7), np.nan), np.minimum(c.high[use], 1e3)
    draw_band(ax, f, db(low), db(high), color=colour, alpha=0.13)
    ax.semilogx(f, db(coefficient(one.bare)[use]), color=colour, linestyle=(0, (4, 2)), linewidth=0.7)


SHOWN = (("o", COLOURS[0], "measured"), ("x", COLOURS[1], "with the gains that u saw"), ("s", QUIET, "linearised"))


@styled()
def draw_cause(found: Sequence[Found], again: Sequence[Found]) -> Figure:
    """Both couplings over how unlike the pressures are, and k_I over the supply."""
    figure = new_figure(1, 3, (7.2, 3.2))
    titles = r"$P_{12}/P_{11}$: $z_p$ moves $\theta_2$", r"$P_{21}/P_{22}$: $z_\theta$ moves $p_{AB}$"
    for ax, element, title in zip(figure.axes, ((0, 1), (1, 0)), titles, strict=False):
        for one in found:
            ratios(ax, one, element)
        ax.set_title(title)
        ax.set_xlabel(r"$|p_A - p_B|$ [bar]")
    figure.axes[0].set_ylabel("ratio of gains, 1 to 3 Hz")
    keys = [dot(marker, colour, label) for marker, colour, label in SHOWN]
    figure.legend(handles=keys, loc="outside lower center", ncols=3)
    by_supply(figure.axes[2], again)
    head(figure, "Coupling grows with unlike pressures, and with a muscle near the supply's pressure")
    return figure


def dot(marker: str, colour: str, label: str) -> Line2D:
    """A marker of the legend."""
    face = "none" if marker == "s" else colour
    return Line2D([], [], color=colour, marker=marker, linestyle="", markerfacecolor=face, label=label)


def ratios(ax: Axes, one: Found, element: tuple[int, int]) -> None:
    """An element over the diagonal one of its row, measured and by both linear plants."""
    use, (i, j) = lines(one, one.bands_hz["bandwidth"]), element
    apart = abs(one.pressures_bar[0] - one.pressures_bar[1])
    for P, (marker, colour, _) in zip((one.frf.response, one.replay, one.bare), SHOWN, strict=True):
        ratio = float(np.median(np.abs(P[use, i, j] / P[use, i, i])))
        ax.plot(apart, ratio, marker, color=colour, markerfacecolor="none" if marker == "s" else colour)


def by_supply(ax: Axes, again: Sequence[Found]) -> None:
    """k_I in the bandwidth over the supply, with its bounds."""
    for k, where in enumerate(dict.fromkeys(one.where for one in again)):
        mine = [one for one in again if one.where == where]
        v = [dict(zip(one.bands_hz, one.met.verdicts, strict=True))["bandwidth"] for one in mine]
        y = np.array([x.estimate_db for x in v])
        reach = np.array([[x.estimate_db - max(x.low_db, -60.0) for x in v], [x.high_db - x.estimate_db for x in v]])
        ax.errorbar(
            [one.supply_bar for one in mine],
            y,
            reach,
            color=COLOURS[k],
            marker="o",
            capsize=2.0,
            label=f"{where[0]:g} deg, {where[1]:g} bar",
        )
    ax.axhline(LIMIT_DB, color=LIMIT, linestyle="--", linewidth=1.0)
    ax.set_xlabel("supply [bar]")
    ax.set_ylabel("largest |$k_I$|, 1 to 3 Hz [dB]")
    ax.set_title("worst points, other supplies")
    ax.legend()
