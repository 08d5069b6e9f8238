"""Figures: what the supply changes, and tracking with and without feedforward."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from beyond_feedforward import RATE_HZ, Path
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from loopshape.core.units import deg
from loopshape.data.signal.recording import Recording
from loopshape.view.style import COLOURS, MARKERS, head, new_figure, styled

Tables = Mapping[str, Sequence[Mapping]]


@styled()
def draw_supply(tables: Tables) -> Figure:
    """Bandwidths, flows and settling over the supply and over the points."""
    figure = new_figure(2, 2, (7.2, 5.6))
    rows = tables["supply"]
    bars = [r["supply_bar"] for r in rows]
    bandwidths(figure.axes[0], rows, bars)
    prices(figure.axes[1], rows, bars)
    by_point(figure.axes[2], tables)
    settling(figure.axes[3], tables)
    head(figure, "Higher supply and scheduling: what they change at nine equilibria, same margins")
    return figure


def bandwidths(ax: Axes, rows: Sequence[Mapping], bars: Sequence[float]) -> None:
    """Lowest and mean bandwidth."""
    for k, (key, label) in enumerate({
        "own_mean_hz": "own, mean", "own_lowest_hz": "own, lowest", "robust_mean_hz": "one for all, mean",
        "robust_lowest_hz": "one for all, lowest",
    }.items()):  # fmt: skip
        ax.plot(bars, [r[key] for r in rows], marker=MARKERS[k], color=COLOURS[k], label=label)
    ax.set(xlabel="supply [bar]", ylabel="first 0 dB crossing [Hz]", title="bandwidth", yscale="log", ylim=(0.4, 40.0))
    ax.yaxis.set_major_formatter("{x:g}")
    ax.legend(ncols=2, loc="upper left")


def prices(ax: Axes, rows: Sequence[Mapping], bars: Sequence[float]) -> None:
    """Asymmetry of the valves, spread of kappa."""
    for k, (key, label) in enumerate({
        "exhaust_over_fill_most": "exhaust/filling, largest", "exhaust_over_fill_least": "exhaust/filling, least",
        "kappa_ratio": r"$\kappa$, largest/least",
    }.items()):  # fmt: skip
        ax.semilogy(bars, [r[key] for r in rows], marker=MARKERS[k], color=COLOURS[k], label=label)
    ax.set(xlabel="supply [bar]", ylabel="ratio", title="how unlike the valves and the points are")
    ax.legend()


def by_point(ax: Axes, tables: Tables) -> None:
    """Own bandwidth of each point by supply."""
    points = list(dict.fromkeys((r["theta2_deg"], r["p_ab_bar"]) for r in tables["points"]))
    for k, bar in enumerate(dict.fromkeys(r["supply_bar"] for r in tables["points"])):
        own = [r["own_hz"] for r in tables["points"] if r["supply_bar"] == bar]
        ax.plot(range(len(points)), own, marker=MARKERS[k], linestyle="", color=COLOURS[k], label=f"{bar:g} bar")
    names(ax, points)
    ax.set(ylabel="own bandwidth [Hz]", title="own controllers by supply", yscale="log", ylim=(1.0, 60.0))
    ax.yaxis.set_major_formatter("{x:g}")
    ax.legend(ncols=4, loc="upper left", columnspacing=1.0, handletextpad=0.2)


def settling(ax: Axes, tables: Tables) -> None:
    """Settling of small steps at the lowest supply by controller."""
    rows = [r for r in tables["small_steps"] if r["supply_bar"] == 1.0]
    points = list(dict.fromkeys((r["theta2_deg"], r["p_ab_bar"]) for r in rows))
    for k, word in enumerate(dict.fromkeys(r["controller"] for r in rows)):
        y = [r.get("settling_5_s", np.nan) for r in rows if r["controller"] == word]
        label = word.replace("robust", "one for all").replace("low lines", "error below 1 Hz")
        ax.plot(range(len(points)), y, marker=MARKERS[k], linestyle="", color=COLOURS[k], label=label)
    names(ax, points)
    ax.set(ylabel="settling, 5 % [s]", title="steps of 3 deg, supply 1 bar", ylim=(0.0, 4.2))
    ax.legend(ncols=2, loc="upper left", columnspacing=1.0, handletextpad=0.2)


def names(ax: Axes, points: Sequence[tuple[float, float]]) -> None:
    """Points under the axis."""
    ax.set_xticks(range(len(points)), [f"{a:g}\n{b:g}" for a, b in points])
    ax.set_xlabel(r"$\theta_2$ [deg] over $p_{AB}$ [bar]")


@styled()
def draw_tracking(way: Path, recordings: Mapping[str, Recording], tables: Tables) -> Figure:
    """The profile with and without feedforward, its error, and what errors of the parameters do."""
    figure = new_figure(3, 1, (7.2, 8.4))
    t = np.arange(way.derivative[0].size) / RATE_HZ
    figure.axes[0].plot(
        t, deg(way.derivative[0]), color="black", linestyle="--", linewidth=0.9, label="reference", zorder=5
    )
    for k, (name, r) in enumerate(recordings.items()):
        angle, n = deg(r.column("true_theta2_rad")), r.column("t_s").size
        if name in ("none", "inverted model"):
            figure.axes[0].plot(t[:n], angle, color=COLOURS[k], linewidth=2.0, label=f"feedforward: {name}")
        figure.axes[1].plot(t[:n], deg(way.derivative[0])[:n] - angle, color=COLOURS[k], label=name, linewidth=0.9)
    figure.axes[0].set(
        ylabel=r"$\theta_2$ [deg]",
        title="figure 5.7: a third-order profile at $p_{AB}$ = 1 bar",
    )
    figure.axes[1].set(xlabel="time [s]", ylabel="error [deg]", title="tracking error by feedforward, same feedback")
    figure.axes[1].set_ylim(-3.5, 8.0)
    for ax, place in zip(figure.axes[:2], ("lower left", "upper right"), strict=True):
        ax.set_xlim(0.5, 9.0)
        ax.legend(loc=place, ncols=2 if place == "upper right" else 1)
    wrong_numbers(figure.axes[2], tables)
    head(figure, "Feedforward takes most of the tracking error away at unchanged margins")
    return figure


def wrong_numbers(ax: Axes, tables: Tables) -> None:
    """rms error over how far a parameter of the feedforward is off."""
    rows = tables["errors"]
    for k, key in enumerate(dict.fromkeys((r["feedforward"], r["off"]) for r in rows)):
        mine = sorted((r["by"], r["rms_deg"]) for r in rows if (r["feedforward"], r["off"]) == key)
        ax.plot(
            *zip(*[(100.0 * a, b) for a, b in mine], strict=True),
            marker=MARKERS[k],
            color=COLOURS[k % 7],
            label=f"{key[0]}: {key[1]}",
        )
    ax.set(xlabel="the number in the feedforward is off by [%]", ylabel="rms error [deg]", title="with wrong numbers")
    ax.set_ylim(0.0, None)
    ax.figure.legend(*ax.get_legend_handles_labels(), loc="outside lower center", ncols=2)
