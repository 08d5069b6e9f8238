"""Figures of the bench: counterparts of figures 3.12, 4.4, 4.5 and G.1 to G.4."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from muscle_findings import Found
from muscle_law import diameter_m, nominal_length_m
from muscle_points import BAND, Measured

from loopshape.core.units import db, deg
from loopshape.data.response.frf import FRF
from loopshape.io.files import write_bytes_whole
from loopshape.toolbox.arm.source import value
from loopshape.view.style import COLOURS, LIMIT, MARKERS, QUIET, head, new_figure, png, shades, styled


def draw_bench(found: Found, words: Mapping[str, Any], folder: Path) -> None:
    """All of them."""
    nominal(found, words, folder)
    one_point(found, folder)
    all_points(found, words, folder)
    five_points(found, folder)
    stiffness_and_damping(found, words, folder)


@styled()
def nominal(found: Found, words: Mapping[str, Any], folder: Path) -> None:
    """Nominal length and diameter with spread and hysteresis, and the grid."""
    figure = new_figure(2, 2, (7.0, 5.2))
    length, wide, both, points = figure.axes
    p = np.linspace(0.05, 1.5, 200)
    h0 = 1e3 * nominal_length_m(p)
    half, hysteresis = 0.5 * value("muscles.nominal_length_spread"), 0.5 * value("muscles.hysteresis")
    touch = value("muscles.braid_touches")
    for ax, shown in ((length, lambda h: h), (wide, lambda h: 1e3 * diameter_m(1e-3 * h))):
        ax.fill_between(p, shown(h0 - half), shown(h0 + half), color="0.88", label="spread of five muscles")
        ax.plot(p, shown(h0 + hysteresis), "--", color=COLOURS[1], label="rising pressure")
        ax.plot(p, shown(h0 - hysteresis), ":", color=COLOURS[2], label="falling pressure")
        ax.plot(p, shown(h0), color=COLOURS[0], label="model")
        ax.axvline(touch, color=QUIET, linewidth=0.7)
        ax.set_xlim(0.0, 1.2)
        ax.set_xlabel("p [bar]")
    length.set(ylim=(140, 215), ylabel="nominal length [mm]", title="nominal length")
    wide.set(ylim=(36, 54), ylabel="nominal diameter [mm]", title="diameter by the braid's kinematics")
    length.legend(loc="upper right")
    both.plot(h0, 1e3 * diameter_m(1e-3 * h0), color=COLOURS[0])
    both.set(xlim=(140, 215), ylim=(36, 54), xlabel="nominal length [mm]", ylabel="nominal diameter [mm]")
    both.set_title("diameter over length")
    _grid(points, found, words)
    note = "Spread and hysteresis have their published sizes; right of the grey line tube and braid touch."
    head(figure, "Nominal length, and where the muscles are measured", note)
    write_bytes_whole(folder / "nominal_length.png", png(figure))


def _grid(ax: Axes, found: Found, words: Mapping[str, Any]) -> None:
    p, h = found.columns
    line = np.linspace(0.3, 1.5, 100)
    reference = np.array(words["muscles"]["points_mm_bar"])
    ax.plot(line, 1e3 * nominal_length_m(line), color=COLOURS[0], label="nominal length")
    ax.plot(p, 1e3 * h, "o", color=COLOURS[2], markerfacecolor="none", label="muscle 4")
    ax.plot(reference[:, 1], reference[:, 0], ".", color=LIMIT, label="muscles 1, 2, 3, 5")
    left = np.array(found.left)
    ax.plot(left[:, 0], 1e3 * left[:, 1], "x", color=QUIET, label="left out here")
    ax.set(xlim=(0.25, 1.5), ylim=(140, 232), xlabel="p [bar]", ylabel="length [mm]", title="working points")
    ax.legend(loc="upper right", ncols=2)


@styled()
def one_point(found: Found, folder: Path) -> None:
    """H1, H2, spectra and coherence at one point, with good and with poor sensors."""
    one = next(r for r in found.rows["gauge"] if r.p_bar == 0.8 and round(1e3 * r.h_m) == 170)
    figure = new_figure(2, 2, (7.0, 5.0))
    size, spectra, angle, coherence = figure.axes
    limit = value("bench.noise_limit")
    looks = (
        ("H1", one.both.h1, COLOURS[0], "-"),
        ("H2", one.both.h2, COLOURS[1], "-"),
        ("H1, poor sensors", found.noisy.h1, COLOURS[5], "--"),
        ("H2, poor sensors", found.noisy.h2, COLOURS[4], "--"),
    )
    for name, frf, colour, style in looks:
        look = {"color": colour, "linestyle": style, "linewidth": 0.9}
        for low, high, alpha in ((0.5, limit, 1.0), (limit, 99.0, 0.25)):
            part = frf.between(low, high)
            shown = name if alpha == 1.0 else None
            size.semilogx(part.frequency_hz, db(1e-3 * part.siso), label=shown, alpha=alpha, **look)
            angle.semilogx(part.frequency_hz, deg(np.angle(part.siso)), alpha=alpha, **look)
    f = one.both.h1.frequency_hz
    model = one.found.response(f)
    size.semilogx(f, db(1e-3 * model), color="black", linewidth=0.7, label="fit to 10 Hz")
    angle.semilogx(f, deg(np.angle(model)), color="black", linewidth=0.7)
    _spectra(spectra, one.both.h1)
    for both, name, colour in ((one.both, "sensors as assumed", COLOURS[0]), (found.noisy, "poor sensors", COLOURS[4])):
        coherence.semilogx(both.h1.frequency_hz, both.coherence, color=colour, label=name)
    size.set(ylim=(0, 42), ylabel="magnitude [dB re 1 kN/m]", title="magnitude")
    angle.set(ylim=(-190, 190), yticks=(-180, -90, 0, 90, 180), ylabel="phase [deg]", title="phase")
    spectra.set(ylim=(-165, 5), ylabel="power [dB]", title="power spectra")
    coherence.set(ylim=(0, 1.05), ylabel="coherence", title="coherence, H1 over H2")
    for ax in figure.axes:
        ax.axvline(limit, color=QUIET, linewidth=0.7)
        ax.set(xlim=(0.5, 100), xlabel="f [Hz]")
    for ax, place in ((size, "upper left"), (spectra, "lower left"), (coherence, "lower left")):
        ax.legend(loc=place)
    note = f"The noise on the length ends at {limit:g} Hz (grey line); beyond it only the sensors are seen."
    head(figure, "One working point: 170 mm, 0.8 bar, closed valves (gauge gas law)", note)
    write_bytes_whole(folder / "one_point.png", png(figure))


def _spectra(ax: Axes, frf: FRF) -> None:
    """Powers of length and pull, and between them."""
    powers = {"length [m²/Hz]": frf.input_power, "pull [N²/Hz]": frf.output_power, "cross [N m/Hz]": frf.cross_power}
    for (name, power), colour in zip(powers.items(), COLOURS, strict=False):
        ax.semilogx(frf.frequency_hz, 0.5 * db(np.abs(power)), color=colour, label=name)


@styled()
def all_points(found: Found, words: Mapping[str, Any], folder: Path) -> None:
    """The FRFs of all working points, a column for each length."""
    lengths, pressures = words["grid"]["lengths_mm"], words["grid"]["pressures_bar"]
    figure = new_figure(2, len(lengths), (7.0, 4.4), sharex=True, sharey="row")
    colours = dict(zip(pressures, shades(len(pressures)), strict=True))
    for row in found.rows["gauge"]:
        n, frf = lengths.index(round(1e3 * row.h_m)), row.both.h1.between(0.5, 20.0)
        look = {"color": colours[row.p_bar], "linewidth": 0.8}
        figure.axes[n].plot(frf.frequency_hz, db(1e-3 * frf.siso), label=f"{row.p_bar:g} bar", **look)
        figure.axes[len(lengths) + n].plot(frf.frequency_hz, deg(np.angle(frf.siso)), **look)
    for n, h in enumerate(lengths):
        figure.axes[n].set_title(f"{h:.0f} mm")
        figure.axes[len(lengths) + n].set(xlabel="f [Hz]", xlim=(0, 20), xticks=(0, 10, 20), ylim=(0, 30))
    figure.axes[0].set(ylabel="magnitude [dB re 1 kN/m]", ylim=(8, 32))
    figure.axes[len(lengths)].set_ylabel("phase [deg]")
    handles = {label: line for ax in figure.axes for line, label in zip(*ax.get_legend_handles_labels(), strict=True)}
    order = [f"{p:g} bar" for p in pressures]
    figure.legend([handles[k] for k in order], order, loc="outside lower center", ncols=8, columnspacing=1.0)
    head(figure, f"Responses at the {len(found.points)} working points, closed valves (gauge gas law)")
    write_bytes_whole(folder / "all_points.png", png(figure))


@styled()
def five_points(found: Found, folder: Path) -> None:
    """The five points that the source prints: what each law gives, and what was printed."""
    p, h, k, d = found.five
    figure = new_figure(2, 5, (7.0, 4.4), sharex=True)
    for law, colour in zip(found.rows, COLOURS, strict=False):
        for row in found.rows[law]:
            if row.p_bar == p[0] and round(1e3 * row.h_m) <= 190:
                _one_of_five(figure.axes, int(np.argmin(np.abs(h - row.h_m))), row, colour, law)
    f = np.linspace(0.5, 20.0, 100)
    for n in range(5):
        source = k[n] + 2j * np.pi * f * d[n]
        figure.axes[n].plot(f, 1e-3 * np.abs(source), "--", color="black", linewidth=1.0, label="printed k and d")
        figure.axes[5 + n].plot(f, deg(np.angle(source)), "--", color="black", linewidth=1.0)
        figure.axes[n].set(title=f"{1e3 * h[n]:.0f} mm", ylim=(0.6 * 1e-3 * k[n], None))
        figure.axes[5 + n].set(xlabel="f [Hz]", xlim=(0, 20), xticks=(0, 10, 20), ylim=(0, 24))
        if n:
            figure.axes[5 + n].set_yticklabels([])
    figure.axes[0].set_ylabel("magnitude [kN/m]")
    figure.axes[5].set_ylabel("phase [deg]")
    figure.legend(*figure.axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=4)
    note = "Table 4.1's muscle on a bench that measures k, and with closed valves; dashed: what the source prints."
    head(figure, "Five lengths at 0.9 bar, with k + j 2π f d fitted to 10 Hz (thin)", note)
    write_bytes_whole(folder / "five_points.png", png(figure))


def _one_of_five(axes: list[Axes], n: int, row: Measured, colour: str, law: str) -> None:
    frf: FRF = row.both.h1.between(0.5, 20.0)
    model = row.found.response(frf.frequency_hz)
    axes[n].plot(frf.frequency_hz, 1e-3 * np.abs(frf.siso), color=colour, alpha=0.6, label=law)
    axes[5 + n].plot(frf.frequency_hz, deg(np.angle(frf.siso)), color=colour, alpha=0.6)
    axes[n].plot(frf.frequency_hz, 1e-3 * np.abs(model), color=colour, linewidth=0.6)
    axes[5 + n].plot(frf.frequency_hz, deg(np.angle(model)), color=colour, linewidth=0.6)


@styled()
def stiffness_and_damping(found: Found, words: Mapping[str, Any], folder: Path) -> None:
    """k_w and d_w over length and over pressure, with the other muscles."""
    figure = new_figure(2, 2, (7.0, 6.0), sharey="row")
    rows, lengths, pressures = found.rows["gauge"], words["grid"]["lengths_mm"], words["grid"]["pressures_bar"]
    k_h, k_p, d_h, d_p = figure.axes
    for p, colour in zip(pressures, shades(len(pressures)), strict=True):
        part = [r for r in rows if r.p_bar == p]
        _two_curves(k_h, d_h, [1e3 * r.h_m for r in part], part, f"{p:g} bar", colour)
    for h, colour in zip(lengths, shades(len(lengths)), strict=True):
        part = [r for r in rows if round(1e3 * r.h_m) == h]
        _two_curves(k_p, d_p, [r.p_bar for r in part], part, f"{h:.0f} mm", colour)
    for marker, others in zip(MARKERS, found.others, strict=False):
        look = {"marker": marker, "color": "black", "markerfacecolor": "none", "linestyle": "none"}
        for ax, x in ((k_h, [1e3 * r.h_m for r in others]), (k_p, [r.p_bar for r in others])):
            name = f"muscle {others[0].muscle.name}" if ax is k_p else None
            ax.plot(x, [1e-3 * r.found.k for r in others], label=name, **look)
        d_h.plot([1e3 * r.h_m for r in others], [r.found.d for r in others], **look)
        d_p.plot([r.p_bar for r in others], [r.found.d for r in others], **look)
    k_h.set(ylabel="k_w [kN/m]", title="stiffness over length", ylim=(0, 42))
    k_p.set(title="stiffness over pressure")
    d_h.set(ylabel="d_w [N s/m]", xlabel="length [mm]", title="damping over length (95 % bars)")
    d_p.set(xlabel="p [bar]", title="damping over pressure (95 % bars)")
    k_h.legend(loc="upper left", ncols=2)
    marks = [(h, n) for h, n in zip(*k_p.get_legend_handles_labels(), strict=True) if n.startswith("muscle")]
    k_p.legend(*zip(*marks, strict=True), loc="upper left", ncols=2)
    d_p.legend(loc="lower right", ncols=2)
    note = "Muscle 4 is table 4.1's; the others (black) are stiffer and longer or shorter within the published spread."
    head(figure, "What the simulated bench finds with closed valves (gauge gas law)", note)
    write_bytes_whole(folder / "stiffness_and_damping.png", png(figure))


def _two_curves(top: Axes, low: Axes, x: list[float], rows: list[Measured], label: str, colour: str) -> None:
    look = {"color": colour, "linewidth": 0.9, "marker": ".", "markersize": 3, "label": label}
    top.errorbar(x, [1e-3 * r.found.k for r in rows], [1e-3 * BAND * r.found.k_std for r in rows], **look)
    low.errorbar(x, [r.found.d for r in rows], [BAND * r.found.d_std for r in rows], **look)
