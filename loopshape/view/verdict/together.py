"""Pictures of several loops at once: characteristic loci, det(I + L), singular values, disk margins."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from loopshape.core.units import TWO_PI, Array, ComplexArray, db
from loopshape.data.requirement.requirements import Requirements
from loopshape.data.result.margins import Margins
from loopshape.identify.matrix.equivalent_plant import equivalent_plant
from loopshape.loop.loop import Loop, characteristic_loci
from loopshape.loop.matrix.matrix_margins import gauge_matrix
from loopshape.loop.matrix.structured import mu_bounds
from loopshape.view.key import place_notes
from loopshape.view.labels import number, point, symbol
from loopshape.view.plots.curves import draw_band, fit_decibels, frequency_axis
from loopshape.view.style import COLOURS, FULL_WIDTH_IN, LIMIT, QUIET, axes_or_new, head, new_figure, styled

_CIRCLE = np.exp(1j * np.linspace(0.0, TWO_PI, 361))


@styled()
def loci(loops: Loop, *, ax: Axes | None = None) -> Axes:
    """Eigenvalues of L near -1, each as a curve, with the unit circle; dots mark where a curve leaves the axes."""
    ax = axes_or_new(ax, (3.5, 3.4))
    curves = characteristic_loci(loops.L_i)
    for k, one in enumerate(curves.T):
        ax.plot(one.real, one.imag, color=COLOURS[k % len(COLOURS)], gid=f"locus {k + 1}")
    ax.plot(_CIRCLE.real, _CIRCLE.imag, color="0.6", linewidth=0.6, zorder=1.5)
    ax.plot([-1.0], [0.0], "+", color="black", markersize=8.0, zorder=2.7, gid="critical point")
    ax.set_xlim(-3.0, 1.5)
    ax.set_ylim(-2.5, 1.5)
    ax.set_aspect("equal")
    ax.set_xlabel("real part of eigenvalues of L")
    ax.set_ylabel("imaginary part")
    return ax


@styled()
def determinant(loops: Loop, *, ax: Axes | None = None) -> Axes:
    """det(I + L) around 0 for rising frequency, its size drawn as ln(1 + size); circles at 1, 10 and 100."""
    ax = axes_or_new(ax, (3.5, 3.4))
    drawn = _shrunk(loops.determinant)
    ax.plot(drawn.real, drawn.imag, color=COLOURS[0], gid="det(I + L)")
    ax.plot(drawn.real[:1], drawn.imag[:1], "o", color=COLOURS[0], markersize=3.5, gid="first line")
    levels = (1.0, 10.0, 100.0)
    for level in levels:
        circle = _shrunk(level * _CIRCLE)
        ax.plot(circle.real, circle.imag, color="0.6", linewidth=0.6, zorder=1.5, scalex=False, scaley=False)
        at = _shrunk(np.array([level * np.exp(0.25j * np.pi)]))[0]
        ax.annotate(number(level), (at.real, at.imag), color="0.45", fontsize=6.5, annotation_clip=True)
    ax.plot([0.0], [0.0], "+", color="black", markersize=8.0, zorder=2.7, gid="critical point")
    reach = 1.08 * max(float(np.abs(drawn).max()), float(np.log1p(2.0)))
    ax.set_xlim(-reach, reach)
    ax.set_ylim(-reach, reach)
    ax.set_aspect("equal")
    ax.set_xticks([])
    ax.set_yticks([])
    ax.set_xlabel("det(I + L), log scale about 0\ndot: lowest frequency")
    return ax


def _shrunk(values: ComplexArray) -> ComplexArray:
    return np.asarray(np.exp(1j * np.angle(values)) * np.log1p(np.abs(values)))


@styled()
def singular_values(loops: Loop, name: str, limit_db: float | None, *, scaled: bool, ax: Axes | None = None) -> Axes:
    """Largest and least singular value of S or T (`name`) in dB; `scaled`: the structured one, free of units."""
    ax = axes_or_new(ax, (3.5, 2.6))
    f, M = loops.frequency_hz, gauge_matrix(name, loops.P, loops.c)
    if scaled:
        ax.plot(f, db(mu_bounds(M).upper), color=COLOURS[0], gid="structured")
        ax.set_ylabel(f"µ({name}) [dB]")
    else:
        sizes = np.linalg.svd(M, compute_uv=False)
        draw_band(ax, f, db(sizes[:, -1]), db(sizes[:, 0]), color=COLOURS[0], alpha=0.15)
        ax.plot(f, db(sizes[:, 0]), color=COLOURS[0], gid="largest")
        ax.plot(f, db(sizes[:, -1]), color=COLOURS[0], linewidth=0.7, linestyle="--", gid="least")
        ax.set_ylabel(f"singular values of {name} [dB]")
    frequency_axis(ax, float(f[0]), float(f[-1]))
    if limit_db is not None:
        ax.axhline(limit_db, color=LIMIT, linewidth=1.1, gid="limit")
    fit_decibels(ax, span=60.0)
    return ax


@styled()
def disk_margins(loops: Loop, found: Margins, required: float | None, *, ax: Axes | None = None) -> Axes:
    """The disk margin that each frequency leaves: all loops at once, and each loop alone with the others closed."""
    ax = axes_or_new(ax, (3.5, 2.6))
    f = loops.frequency_hz
    for k, one in enumerate(_one_at_a_time(loops)):
        ax.plot(f, one, color=COLOURS[(k + 1) % len(COLOURS)], linewidth=0.9, gid=loops.names[k])
    together = 1.0 / mu_bounds(gauge_matrix("disk", loops.P, loops.c)).upper
    ax.plot(f, together, color="black", linewidth=1.4, gid="together")
    read = found["disk_margin"]
    reach = np.abs(np.array(read.ends)[:, None] - read.value)
    ax.errorbar([read.at_hz or np.nan], [read.value], yerr=reach, fmt="o", color="black", markersize=3.5)
    if required is not None:
        ax.axhline(required, color=LIMIT, linewidth=1.1, gid="limit")
    frequency_axis(ax, float(f[0]), float(f[-1]))
    ax.set_ylim(0.0, 2.5)
    ax.set_ylabel("disk margin left")
    return ax


def _one_at_a_time(loops: Loop) -> list[Array]:
    """Disk margin (nf,) of each loop with the others closed."""
    controllers = {own.loop: own for own in loops.controllers}
    named = dict(zip(loops.names, loops.controllers, strict=True)) | controllers
    out = []
    for k, name in enumerate(loops.names):
        L = equivalent_plant(loops.plant, loops.names, name, named).siso * loops.c[:, k]
        with np.errstate(divide="ignore"):
            out.append(np.abs(2.0 * (1.0 + L) / (1.0 - L)))
    return out


@styled()
def summary(each: Mapping[str, Margins], found: Margins, required: float | None, *, ax: Axes | None = None) -> Axes:
    """Disk margins with their 95 % intervals: each loop with the others closed, all at once, both ends at once."""
    ax = axes_or_new(ax, (3.5, 2.6))
    rows: list[tuple[str, float, tuple[float, float] | None, str]] = [
        (symbol(name), m.disk_margin, m["disk_margin"].interval, COLOURS[(k + 1) % len(COLOURS)])
        for k, (name, m) in enumerate(each.items())
    ]
    rows.append(("all at once", found.disk_margin, found["disk_margin"].interval, "black"))
    both = found["input_output_disk_margin"].interval
    rows.append(("in and out", found.input_output_disk_margin, both, QUIET))
    for k, (_, value, interval, colour) in enumerate(rows):
        low, high = interval or (value, value)
        ax.plot([low, high], [k, k], color=colour, linewidth=1.4)
        ax.plot([value], [k], "o", color=colour, markersize=4.5)
    if required is not None:
        ax.axvline(required, color=LIMIT, linewidth=1.1, gid="limit")
    ax.set_yticks(range(len(rows)), [row[0] for row in rows])
    ax.set_ylim(len(rows) - 0.5, -0.5)
    ax.set_xlim(0.0, max(1.05 * max(row[2][1] if row[2] else row[1] for row in rows), 1.0))
    ax.set_xlabel("disk margin")
    return ax


@styled()
def together_page(
    loops: Loop, found: Margins, each: Mapping[str, Margins], required: Requirements | None = None
) -> Figure:
    """All loops of one operating point: loci and det(I + L) above, S and T with limits, disk margins below."""
    required = required or Requirements()
    figure = new_figure(3, 2, (FULL_WIDTH_IN, 8.6))
    a, b, c, d, e, f = figure.axes
    scaled = bool(np.isnan(found.sensitivity_peak_db))
    loci(loops, ax=a)
    determinant(loops, ax=b)
    modulus_db = None if required.modulus_margin is None else -float(db(required.modulus_margin))
    singular_values(loops, "S", modulus_db if scaled else required.sensitivity_peak_db, scaled=scaled, ax=c)
    singular_values(loops, "T", None if scaled else required.complementary_peak_db, scaled=scaled, ax=d)
    disk_margins(loops, found, required.disk_margin, ax=e)
    summary(each, found, required.disk_margin, ax=f)
    e.set_xlabel("frequency [Hz]; colours as on the right")
    if any(line.get_gid() == "limit" for ax in figure.axes for line in ax.lines):
        place_notes(f, [("limit", {"color": LIMIT, "linewidth": 1.1})], "lower right")
    head(figure, _title(loops, found), point(loops.plant.operating_point), _details(found))
    return figure


def _title(loops: Loop, found: Margins) -> str:
    names = ", ".join(symbol(name) for name in loops.names)
    parts = ("Several loops at once", f"{names}: {found.stable}", loops.plant.recording)
    return "  ·  ".join(part for part in parts if part)


def _details(found: Margins) -> str:
    low, high = found["disk_margin"].ends
    text = f"disk margin {found.disk_margin:.3g} ({low:.3g} to {high:.3g}, 95 %) at"
    text = f"{text} {found.at_hz['disk_margin']:.3g} Hz, all loops at once"
    return f"{text}; {found.stability_reason}"
