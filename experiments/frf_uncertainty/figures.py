"""Figures of the study: accuracy over the grid, one example, and coverage."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from accuracy import DAMPINGS, SECONDS, SNRS_DB, Case, best_welch, welch_response
from known import LOOP, Plant
from matplotlib.axes import Axes
from matplotlib.colors import TwoSlopeNorm
from matplotlib.figure import Figure
from scipy.stats import f as f_distribution

from loopshape.core.units import Array, ComplexArray, db
from loopshape.data.response.frf import FRF
from loopshape.identify.frequency_response import estimate_frf
from loopshape.identify.settings import Settings
from loopshape.io.files import write_bytes_whole
from loopshape.view.plots.curves import frequency_axis
from loopshape.view.style import COLOURS, LIMIT, QUIET, head, new_figure, png, styled

FIGURES = Path(__file__).parent.parent.parent / "figures" / Path(__file__).parent.name
GRIDS = {("one", "open"): "one resonance, open loop", ("two", "closed"): "two resonances and a delay, closed loop"}


@styled()
def draw_ratios(rows: Sequence[dict]) -> None:
    """Local fits' error over that of Welch's best setting: damping down, signal to noise across, a panel a length."""
    figure = new_figure(2, 3, (7.0, 4.9), sharex=True, sharey=True)
    images = []
    for k, (plant, loop) in enumerate(GRIDS):
        for j, seconds in enumerate(SECONDS):
            some = [
                r
                for r in rows
                if r["measure"] == "relative" and (r["plant"], r["loop"], r["noise"]) == (plant, loop, "white")
            ]
            images.append(ratio_panel(figure.axes[3 * k + j], [r for r in some if float(r["seconds"]) == seconds]))
            figure.axes[3 * k + j].set_title(
                f"{seconds:.0f} s" if k else f"{GRIDS[plant, loop] if j == 1 else ''}\n{seconds:.0f} s"
            )
    for ax in figure.axes[3:6]:
        ax.set_xlabel("signal to noise [dB]")
    figure.axes[4].set_title(f"{GRIDS['two', 'closed']}\n{SECONDS[1]:.0f} s")
    for k in (0, 3):
        figure.axes[k].set_ylabel("damping ratio")
    bar = figure.colorbar(
        images[0],
        ax=figure.axes[:6],
        shrink=0.7,
        label="error over best Welch",
        ticks=[0.1, 0.25, 0.5, 0.75, 1.0, 1.25],
    )
    bar.outline.set_visible(False)
    head(
        figure,
        "Local fits against the best segment length of Welch's method",
        "rms relative error from 1 to 15 Hz; below 1 the local fits are better; bold: more than 10 % worse",
    )
    write_bytes_whole(FIGURES / "accuracy.png", png(figure))


def ratio_panel(ax: Axes, rows: Sequence[dict]) -> object:
    """A heat map with its numbers."""
    at = {(float(r["damping"]), float(r["snr_db"])): float(r["local_over_best"]) for r in rows}
    ratio = np.array([[at.get((z, s), np.nan) for s in SNRS_DB] for z in DAMPINGS])
    image = ax.imshow(ratio, cmap="RdBu_r", norm=TwoSlopeNorm(1.0, 0.0, 1.5), aspect="auto", alpha=0.85)
    for (i, j), value in np.ndenumerate(ratio):
        weight, colour = "bold" if value > 1.1 else "normal", "white" if value < 0.25 or value > 1.4 else "black"
        ax.text(j, i, f"{value:.2f}", ha="center", va="center", fontsize=7.5, weight=weight, color=colour)
    ax.set_xticks(range(len(SNRS_DB)), [f"{s:.0f}" for s in SNRS_DB])
    ax.set_yticks(range(len(DAMPINGS)), [f"{z:g}" for z in DAMPINGS])
    ax.grid(visible=False)
    return image


@styled()
def draw_example() -> None:
    """One record of 20 s: the truth, Welch's best setting, local fits with their band, and both errors."""
    case = Case("one", "open", "white", 0.02, 20.0, 40.0, 3)
    truth, record = case.truth(), case.recordings()[0]
    length = float(best_welch([record], truth, case.seconds)[1][0])
    f, G = welch_response(record, length)
    local = estimate_frf(record, LOOP, Settings(method="local")).between(0.9, 16.0)
    figure = new_figure(1, 3, (7.0, 3.1))
    for ax, low, high in zip(figure.axes[:2], (1.0, 4.3), (15.0, 5.7), strict=True):
        fine = np.geomspace(low, high, 1000)
        ax.plot(f, db(G), color=COLOURS[1], label=f"Welch, best segments ({length:.2g} s)")
        ax.plot(local.frequency_hz, db(local.siso), color=COLOURS[0], label="local fits")
        ax.plot(fine, db(truth.response(fine)), "--", color="black", linewidth=0.8, label="truth")
        frequency_axis(ax, low, high)
    figure.axes[0].set(ylabel="magnitude [dB]", ylim=(-28.0, 32.0))
    figure.axes[1].set(ylim=(8.0, 32.0), xscale="linear", xlim=(4.3, 5.7), xticks=[4.4, 4.7, 5.0, 5.3, 5.6])
    figure.axes[1].xaxis.set_major_formatter("{x:.1f}")
    relative_errors(figure.axes[2], truth, f, G, local)
    handles = dict(zip(*reversed(figure.axes[2].get_legend_handles_labels()), strict=True))
    handles |= dict(zip(*reversed(figure.axes[0].get_legend_handles_labels()), strict=True))
    figure.legend(handles.values(), handles.keys(), loc="outside lower center", ncols=4)
    head(
        figure,
        "A resonance of damping 0.02 from 20 s of noise at 40 dB",
        "one record, open loop; right: distance to the truth",
    )
    write_bytes_whole(FIGURES / "example.png", png(figure))


def relative_errors(ax: Axes, truth: Plant, f: Array, G: ComplexArray, local: FRF) -> None:
    """|d|/|G| of both in per cent, and the 95 % circle that local fits state."""
    size = np.abs(truth.response(local.frequency_hz))
    reach = np.sqrt(f_distribution.ppf(0.95, 2, local.variance_freedom) * local.variance[:, 0, 0]) / size
    ax.fill_between(
        local.frequency_hz, 1e-3, 100.0 * reach, color=COLOURS[0], alpha=0.2, linewidth=0.0, label="its 95 %"
    )
    ax.loglog(f, 100.0 * np.abs(G / truth.response(f) - 1.0), color=COLOURS[1])
    error = np.abs(local.siso - truth.response(local.frequency_hz)) / size
    ax.loglog(local.frequency_hz, 100.0 * error, color=COLOURS[0])
    frequency_axis(ax, 1.0, 15.0)
    ax.set(ylabel="relative error [%]", ylim=(0.05, 100.0))


@styled()
def draw_coverage(rows: Sequence[dict]) -> None:
    """Share of errors within the 95 % region, with two standard errors, and the band that is asked for."""
    rows = [r for r in rows if r["test"] in ("element", "joint") and not r["estimator"].startswith("auto")]
    groups = list(dict.fromkeys(_group(r) for r in rows))
    figure = new_figure(1, 1, (7.0, 1.2 + 0.21 * len(groups)))
    ax = figure.axes[0]
    ax.axvspan(93.0, 97.0, color="0.9", zorder=0)
    ax.axvline(95.0, color=QUIET, linewidth=0.7)
    for r in rows:
        covered(ax, r, groups.index(_group(r)))
    ax.set_yticks(range(len(groups)), groups)
    ax.set(
        ylim=(len(groups) - 0.4, -0.6),
        xlim=(LEAST, 100.6),
        xticks=range(80, 101, 5),
        xlabel="errors within the stated 95 % region [%]",
    )
    _key(figure, ax)
    head(
        figure, "Coverage of 95 % regions",
        "bars: two standard errors over records; red: outside 93 to 97 % by more than chance; numbers: off the axis",
    )  # fmt: skip
    write_bytes_whole(FIGURES / "coverage.png", png(figure))


#: per cent at the left end of the figure of coverage
LEAST = 80.0
LOOKS = {"open": "o", "closed, n at the controller": "s", "closed, n at the plant": "^"}


def covered(ax: Axes, r: dict, place: float) -> None:
    """One case: filled for low noise, open for high; a number where it lies off the axis."""
    quiet, share = float(r["snr_db"]) > 30.0, 100.0 * float(r["coverage"])
    colour = COLOURS[0] if r["verdict"] != "outside" else LIMIT
    order = list(LOOKS).index(r["loop"])
    place += 0.26 * (order - 1) + (-0.06 if quiet else 0.06)
    if share < LEAST:
        ax.text(LEAST + 0.3 + 1.3 * order, round(place), f"{share:.0f}", color=colour, va="center", fontsize=7.0)
        return
    look = {"fmt": LOOKS[r["loop"]], "color": colour, "markerfacecolor": colour if quiet else "white"}
    reach = 200.0 * float(r["standard_error"])
    ax.errorbar(share, place, xerr=reach, markersize=3.2, linewidth=0.7, markeredgewidth=0.7, **look)


def _group(r: dict) -> str:
    words = f"{r['estimator']}, {r['plant']}"
    return words + (", jointly" if r["test"] == "joint" else "")


def _key(figure: Figure, ax: Axes) -> None:
    for word, marker in LOOKS.items():
        ax.plot([], [], marker, color=COLOURS[0], markersize=4.0, label=word)
    ax.plot([], [], "o", color=QUIET, markersize=4.0, label="low noise")
    ax.plot([], [], "o", color=QUIET, markerfacecolor="white", markersize=4.0, label="high noise")
    figure.legend(*ax.get_legend_handles_labels(), loc="outside lower center", ncols=5)
