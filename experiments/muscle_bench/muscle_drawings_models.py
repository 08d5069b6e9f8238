"""Figures of the parameters and the models: counterparts of figures 4.6, G.5 to G.7, and appendix E."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import muscle_models as models
import numpy as np
from matplotlib.axes import Axes
from muscle_findings import Found
from muscle_law import damping, printed, volume_slopes
from muscle_parameters import printed_box, reach

from loopshape.core.units import Array
from loopshape.io.files import write_bytes_whole
from loopshape.toolbox.arm.source import value
from loopshape.view.style import COLOURS, LIMIT, QUIET, head, new_figure, png, shades, styled


def draw_models(found: Found, words: Mapping[str, Any], folder: Path) -> None:
    """All of them."""
    surfaces(found, words, folder)
    misreading(found, words, folder)
    closed_air_beside(found, folder)
    rounding(found, folder)
    beside(words, folder)


def _table(found: Found, words: Mapping[str, Any], values: Array) -> Array:
    """Values of the measured points as a matrix, pressure by length; nan where nothing was measured."""
    lengths, pressures = words["grid"]["lengths_mm"], words["grid"]["pressures_bar"]
    out = np.full((len(pressures), len(lengths)), np.nan)
    for (p, h), v in zip(found.points, values, strict=True):
        out[pressures.index(p), lengths.index(round(1e3 * h))] = v
    return out


def _tiles(
    ax: Axes, words: Mapping[str, Any], table: Array, title: str, form: str, colours: str, limits: tuple
) -> None:
    lengths, pressures = words["grid"]["lengths_mm"], words["grid"]["pressures_bar"]
    ax.imshow(table, origin="lower", aspect="auto", cmap=colours, vmin=limits[0], vmax=limits[1])
    for (i, j), v in np.ndenumerate(table):
        if np.isfinite(v):
            place = (v - limits[0]) / (limits[1] - limits[0])
            dark = place < 0.6 if colours == "viridis" else abs(place - 0.5) > 0.36
            shade = "white" if dark else "black"
            ax.text(j, i, format(v, form), ha="center", va="center", fontsize=8.0, color=shade)
    ax.set_xticks(range(len(lengths)), [f"{h:.0f}" for h in lengths])
    ax.set_yticks(range(len(pressures)), [f"{p:g}" for p in pressures])
    ax.set_title(title)
    ax.grid(visible=False)


@styled()
def surfaces(found: Found, words: Mapping[str, Any], folder: Path) -> None:
    """What the bench measures and how far three models are from it, over the grid; the rest stands in `points.csv`."""
    p, h = found.columns
    bench = np.array([r.found.k for r in found.rows["gauge"]])
    d = np.array([r.found.d for r in found.rows["gauge"]])
    near, fit = found.nearest.stiffness(p, h), found.fits["gauge"].digits.stiffness(p, h)
    analytical = printed("analytical").stiffness(p, h)
    figure = new_figure(2, 2, (7.0, 5.6))
    heat, errors = ("viridis", (0.0, 28.0)), ("RdBu", (-70.0, 70.0))
    small = ("RdBu", (-25.0, 25.0))
    panels = (
        (1e-3 * bench, "bench, closed valves [kN/m]", ".1f", heat),
        (100.0 * (analytical / near - 1.0), "analytical over nearest [%]", ".0f", errors),
        (100.0 * (fit / bench - 1.0), "six parameters, error [%]", ".1f", small),
        (100.0 * (damping(p) / d - 1.0), "damping model, error [%]", ".1f", small),
    )
    for ax, (values, title, form, (colours, limits)) in zip(figure.axes, panels, strict=True):
        _tiles(ax, words, _table(found, words, values), title, form, colours, limits)
    for n in (0, 2):
        figure.axes[n].set_ylabel("p [bar]")
    for ax in figure.axes[2:]:
        ax.set_xlabel("length [mm]")
    note = "The bench is table 4.1's muscle, valves closed, gauge gas law; white points are not measured."
    head(figure, "Stiffness, damping and their models at the working points", note)
    write_bytes_whole(folder / "surfaces.png", png(figure))


@styled()
def misreading(found: Found, words: Mapping[str, Any], folder: Path) -> None:
    """Slope with closed valves over k, and what each reading says of the arm."""
    figure = new_figure(1, 3, (7.0, 3.6), width_ratios=(1, 1, 1.25))
    gauge, absolute, arm = figure.axes
    pressures = words["grid"]["pressures_bar"]
    for ax, law in ((gauge, "gauge"), (absolute, "absolute")):
        for p, colour in zip(pressures, shades(len(pressures)), strict=True):
            part = [r for r in found.rows[law] if r.p_bar == p]
            ax.plot(
                [1e3 * r.h_m for r in part], [r.found.k / r.k for r in part], ".-", color=colour, label=f"{p:g} bar"
            )
        ax.axhline(1.0, color="black", linewidth=0.7)
        ax.set(ylim=(0.8, 2.9), xlabel="length [mm]", title=f"{law} gas law")
    gauge.set_ylabel("measured slope over k(p, h)")
    gauge.legend(loc="upper left", fontsize=7.0)
    names = [_two_lines(r.what) for r in found.arm]
    y = np.arange(len(names))[::-1]
    colours = [COLOURS[6], QUIET, *[COLOURS[0]] * 4, COLOURS[1], *[COLOURS[4]] * 3]
    arm.barh(y, [r.numbers[0] for r in found.arm], color=colours, height=0.6)
    arm.axvline(value("figure_4_12.f"), color=LIMIT, linewidth=0.8)
    arm.set_yticks(y, names, fontsize=6.5)
    arm.set(xlim=(0, 9), xlabel="f [Hz]", title="arm at (0 deg, 1 bar)")
    arm.grid(visible=False, axis="y")
    note = "Right, section 4.3: red line measured; yellow: the bench's k_w taken as the slope that it physically is."
    head(figure, "With closed valves a bench measures the slope dF/dh, not k; what that means for the arm", note)
    write_bytes_whole(folder / "misreading.png", png(figure))


def _two_lines(text: str) -> str:
    for cut in (", ", " by "):
        if cut in text:
            first, last = text.split(cut, 1)
            return f"{first}{cut.rstrip()}\n{last}"
    return text


@styled()
def closed_air_beside(found: Found, folder: Path) -> None:
    """Figure G.3's stiffnesses beside slopes with closed valves: by first principles and by the source's force law."""
    p, h, k, _ = found.five
    line = np.linspace(0.148, 0.202, 55)
    figure = new_figure(1, 2, (7.0, 3.6), sharey=True)
    first, own = figure.axes
    slopes = models.closed_air(np.full(line.size, p[0]), line)
    for shape, colour in (("cylinder", COLOURS[0]), ("barrel", COLOURS[2])):
        low, high = (1e-3 * slopes[f"{shape}, {heat}"] for heat in ("isothermal", "adiabatic"))
        first.fill_between(1e3 * line, low, high, color=colour, alpha=0.25)
        first.plot(1e3 * line, low, color=colour, label=f"{shape}, closed air, tube")
    alone = models.slope(models.chou_hannaford, np.array(p[0]), line)
    first.plot(1e3 * line, 1e-3 * alone, "--", color=COLOURS[0], label="cylinder at constant pressure")
    first.set(xlabel="length [mm]", ylabel="k_w [kN/m]", title="first principles, nothing fitted", ylim=(0, 21))
    own.plot(1e3 * line, 1e-3 * found.nearest.stiffness(p[0], line), color=COLOURS[2], label="k by digits nearest G.3")
    for law, colour in (("gauge", COLOURS[1]), ("absolute", COLOURS[3])):
        rows = [r for r in found.rows[law] if r.p_bar == p[0]]
        own.plot(
            [1e3 * r.h_m for r in rows], [1e-3 * r.slope for r in rows], ".-", color=colour, label=f"{law} gas law"
        )
    own.set(xlabel="length [mm]", title="source's force law, valves closed, printed digits")
    for ax in figure.axes:
        ax.plot(1e3 * h, 1e-3 * k, "o", color="black", markerfacecolor="none", label="figure G.3")
        ax.legend(loc="upper left")
    note = (
        "Left: lines isothermal, bands up to adiabatic. Right: the source's own force law would be read as far stiffer."
    )
    head(figure, "Stiffness at 0.9 bar: printed, and what a bench with closed valves should find", note)
    write_bytes_whole(folder / "closed_air.png", png(figure))


@styled()
def rounding(found: Found, folder: Path) -> None:
    """What printed digits leave open, how many would be needed, and appendix E.4's Taylor series."""
    figure = new_figure(1, 3, (7.0, 3.2))
    left, middle, right = figure.axes
    p, h, k, _ = found.five
    line = np.linspace(0.145, 0.205, 121)
    low, high = reach(printed_box(), np.full(line.size, p[0]), line)
    left.fill_between(1e3 * line, 1e-3 * low, 1e-3 * high, color="0.88", label="any digits that\nround to table 4.1")
    left.plot(1e3 * line, 1e-3 * printed().stiffness(p[0], line), color=COLOURS[0], label="printed digits")
    left.plot(1e3 * line, 1e-3 * found.nearest.stiffness(p[0], line), color=COLOURS[2], label="digits nearest G.3")
    left.plot(1e3 * h, 1e-3 * k, "o", color="black", markerfacecolor="none", label="figure G.3")
    left.set(xlabel="length [mm]", ylabel="k [kN/m]", title="table 4.1 at 0.9 bar", ylim=(0, 19))
    left.legend(loc="upper left", fontsize=7.0)
    n = np.array([row[0] for row in found.digit_errors])
    for column, name, colour in ((1, "as in table 4.1", COLOURS[1]), (2, "centred", COLOURS[0])):
        middle.semilogy(n, [100.0 * row[column] for row in found.digit_errors], "o-", color=colour, label=name)
    middle.axhline(100.0 * found.about["good_share"], color=QUIET, linewidth=0.8)
    middle.set(
        xlabel="significant digits of each number", ylabel="largest error of k [%]", title="digits that would be needed"
    )
    middle.legend()
    _taylor(right)
    head(figure, "What the printed digits of the fitted stiffness are worth, and its series")
    write_bytes_whole(folder / "rounding.png", png(figure))


def _taylor(ax: Axes) -> None:
    """Exact second derivative of the volume, the series that E.24 prints, and a cylinder's."""
    line, at = np.linspace(0.12, 0.235, 116), value("e_4.reference_length")
    exact = [-volume_slopes(float(x))[2] for x in line]
    k0, k1, k2 = (value(f"e_24.k{n}") for n in range(3))
    ax.plot(1e3 * line, exact, color=COLOURS[0], label="barrel, exact (E.22)")
    ax.plot(
        1e3 * line, k0 + k1 * (line - at) + k2 * (line - at) ** 2, "--", color=COLOURS[1], label="printed series (E.24)"
    )
    ax.plot(1e3 * line, 6.0 * line / models.TURNS, color=COLOURS[2], label="cylinder (E.7)")
    ax.plot(1e3 * at, k0, "o", color="black", markerfacecolor="none")
    ax.set(xlabel="length [mm]", ylabel="−d²V/dh² [m]", title="appendix E.4", ylim=(0, 0.1))
    ax.legend(loc="upper left", fontsize=7.0)


@styled()
def beside(words: Mapping[str, Any], folder: Path) -> None:
    """Pull and slope of five models over length and over pressure."""
    one = words["models"]
    pulls = {"source, fitted": models.fitted, **models.model_pulls(one)}
    pulls.pop("Petrovic")
    figure = new_figure(2, 2, (7.0, 5.6))
    h = 1e-3 * np.linspace(*one["lengths_mm"], 100)
    p = np.linspace(*one["pressures_bar"], 200)
    styles = ("-", "--", "-.", ":", (0, (3, 1, 1, 1)))
    for (name, pull), style, colour in zip(pulls.items(), styles, COLOURS, strict=False):
        look = {"linestyle": style, "color": colour}
        label = "Chou-Hannaford = Petrovic" if name.startswith("Chou") else name
        figure.axes[0].plot(1e3 * h, pull(np.array(1.0), h), label=label, **look)
        figure.axes[1].plot(p, pull(p, np.array(0.19)), **look)
        figure.axes[2].plot(1e3 * h, 1e-3 * models.slope(pull, np.array(1.0), h), **look)
        figure.axes[3].plot(p, 1e-3 * models.slope(pull, p, np.array(0.19)), **look)
    for ax in figure.axes[1::2]:
        ax.axvspan(0.5, 1.4, color="0.92")
        ax.axvline(value("existing_models_above"), color=QUIET, linewidth=0.8)
        ax.set(xlim=(0, 4), xlabel="p [bar]")
    for ax in figure.axes[::2]:
        ax.set(xlabel="length [mm]", xlim=tuple(one["lengths_mm"]))
    for ax, title in zip(
        figure.axes, ("pull at 1 bar", "pull at 190 mm", "slope at 1 bar", "slope at 190 mm"), strict=True
    ):
        ax.set(title=title, ylabel="pull [N]" if title.startswith("pull") else "dF/dh [kN/m]", ylim=(0, None))
    figure.axes[0].legend(loc="upper left")
    note = (
        "Grey: where the source measured; right of the line existing models hold, it says, and its own is extrapolated."
    )
    head(figure, "Models of the muscle beside each other, slopes at constant pressure", note)
    write_bytes_whole(folder / "models_beside.png", png(figure))
