"""Pictures of an FRF with several inputs and outputs: all elements in a grid, or an overview of many."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MultipleLocator

from loopshape.core.units import Array, db
from loopshape.data.algebra.propagation import pick
from loopshape.data.response.frf import FRF
from loopshape.view.labels import decibel, expression, point, ratio, symbol, unit_of
from loopshape.view.plots.curves import (
    draw_valid,
    fit_decibels,
    fit_degrees,
    frequency_axis,
    hide_inner,
    shown_band_hz,
    unwrapped_deg,
)
from loopshape.view.plots.frequency import magnitude, shade_band
from loopshape.view.style import COLOURS, FULL_WIDTH_IN, head, new_figure, styled

#: more elements than these are drawn as maps
GRID_ROWS, GRID_COLUMNS = 4, 4
_KNOWN = 1.92  # deviations below which an element may be zero: sqrt(-ln 0.025)


@styled()
def matrix_page(frf: FRF) -> Figure:
    """Every element of an FRF: magnitude with its 95 % band above phase, outputs down, inputs across.

    Elements of one row share their scales; dots of phase are lines at which the element may be zero. Of more than four
    inputs or outputs a map for each input instead.
    The layout is that of figure 5.8 of van den Brink, DCT 2007.002.
    """
    ny, nu = frf.response.shape[1:]
    if ny > GRID_ROWS or nu > GRID_COLUMNS:
        return matrix_overview(frf)
    heights = {"height_ratios": [1.5, 1.0] * ny}
    size = (FULL_WIDTH_IN, 0.9 + 2.3 * ny)
    figure = new_figure(2 * ny, nu, size, squeeze=False, sharex=True, gridspec_kw=heights)
    axes = np.array(figure.axes).reshape(2 * ny, nu)
    for i in range(ny):
        for j in range(nu):
            _element(frf, i, j, axes[2 * i, j], axes[2 * i + 1, j])
        _share(axes[2 * i], axes[2 * i + 1])
    hide_inner(*axes[:-1].ravel())
    head(
        figure,
        _title(frf),
        point(frf.operating_point),
        frf.method,
        "bands: 95 %, of each frequency by itself",
        *frf.notes,
    )
    return figure


def _element(frf: FRF, i: int, j: int, above: Axes, below: Axes) -> None:
    """Magnitude and phase of one element; dots where its phase is not known, for it may be zero."""
    one = pick(frf, [i], [j])
    magnitude(one, ax=above)
    known = np.abs(one.siso) > _KNOWN * np.sqrt(one.variance[:, 0, 0])
    _phase(one, one.valid & settled(known), below)
    frequency_axis(below, *shown_band_hz(frf))
    for ax in (above, below):
        shade_band(frf, ax=ax)
    above.set_ylabel(decibel("|P|", ratio(unit_of(one.outputs[0]), unit_of(one.inputs[0]))))
    above.set_title(f"{expression(one.outputs[0])} / {expression(one.inputs[0])}", loc="left", pad=3.0)


def _phase(one: FRF, known: np.ndarray, ax: Axes) -> None:
    """Phase in degrees, continuous; on (-270, 90] and broken where it jumps if noise would wind it up."""
    angle = unwrapped_deg(one.siso, known)
    wound_deg = 720.0  # a phase that turns by more is taken for one that noise has wound up
    if known.any() and np.ptp(angle[known]) > wound_deg:
        angle = angle - 360.0 * np.ceil((angle - 90.0) / 360.0)
        lines = np.flatnonzero(known)
        angle[lines[1:][np.abs(np.diff(angle[lines])) > 180.0]] = np.nan
    draw_valid(ax, one.frequency_hz, angle, known, color=COLOURS[0])
    fit_degrees(ax)
    ax.set_ylabel("phase [deg]")


def settled(known: np.ndarray) -> np.ndarray:
    """Of lines that are known (nf,) those with two known ones at least among four neighbours: no chance hits."""
    near = np.lib.stride_tricks.sliding_window_view(np.pad(known.astype(int), 2, mode="edge"), 5).sum(axis=1)
    return np.asarray(known & (near >= 3))


def _share(above: np.ndarray, below: np.ndarray) -> None:
    """One scale for a row of magnitudes where they share their unit; for phases always."""
    alike = len({ax.get_ylabel() for ax in above}) == 1
    for row, fit in ((above, fit_decibels), (below, fit_degrees)):
        if row is above and not alike:
            continue
        boxes = [ax.dataLim for ax in row if np.isfinite([ax.dataLim.y0, ax.dataLim.y1]).all()]
        for ax in row:
            ax.update_datalim([(box.x1, y) for box in boxes for y in (box.y0, box.y1)])
            fit(ax)
            if row is below and np.ptp(ax.get_ylim()) <= 540.0:
                ax.yaxis.set_major_locator(MultipleLocator(90.0))
            if ax is not row[0]:
                ax.set_ylabel("")
                ax.tick_params(labelleft=False)


@styled()
def matrix_overview(frf: FRF) -> Figure:
    """Magnitudes of many elements as maps, one for each input: frequency across, outputs down, colour in dB.

    Each output has its own unit; what is within its 95 % interval of zero, or outside the valid band, is white. Phase
    is not shown.
    """
    ny, nu = frf.response.shape[1:]
    columns = min(nu, 2 if ny > GRID_ROWS else GRID_COLUMNS)
    rows = int(np.ceil(nu / columns))
    figure = new_figure(rows, columns, (FULL_WIDTH_IN, 1.1 + rows * (0.8 + 0.13 * ny)), squeeze=False, sharey=True)
    level = _known_db(frf)
    top = float(np.nanmax(level)) if np.isfinite(level).any() else 0.0
    low = max(float(np.nanmin(level)) if np.isfinite(level).any() else -60.0, top - 80.0)
    mesh = None
    for j, ax in enumerate(figure.axes[:nu]):
        mesh = ax.pcolormesh(
            _edges(frf.frequency_hz), np.arange(ny + 1) - 0.5, level[:, :, j].T, vmin=low, vmax=top, cmap="viridis",
            rasterized=True,
        )  # fmt: skip
        ax.set_title(f"input {expression(frf.inputs[j])}", loc="left", pad=3.0)
        ax.grid(False)
        frequency_axis(ax, *shown_band_hz(frf))
    for ax in figure.axes[nu:]:
        ax.set_axis_off()
    for ax in figure.axes[:nu:columns]:
        ax.set_ylim(ny - 0.5, -0.5)
        ax.set_yticks(range(ny), [expression(name) for name in frf.outputs], fontsize=7.0)
    units = {ratio(unit_of(y), unit_of(u)) for y in frf.outputs for u in frf.inputs}
    label = decibel("|P|", units.pop()) if len(units) == 1 else "|P| [dB re each element's unit]"
    if mesh is not None:
        figure.colorbar(mesh, ax=figure.axes[:nu], label=label, fraction=0.04, pad=0.02)
    white = "white: within 95 % of zero, or outside the valid band"
    head(figure, _title(frf), point(frf.operating_point), frf.method, white)
    return figure


def _known_db(frf: FRF) -> Array:
    """Magnitude in dB (nf, ny, nu), nan where it may be zero or outside the valid band."""
    known = (np.abs(frf.response) > _KNOWN * np.sqrt(frf.variance)) & frf.valid[:, None, None]
    return np.where(known, db(np.where(known, frf.response, 1.0)), np.nan)


def _edges(f: Array) -> Array:
    """Edges (nf + 1,) half-way between lines, the outer ones as far out as in."""
    if f.size < 2:
        return np.array([f[0] / 1.1, f[0] * 1.1])
    middle = 0.5 * (f[1:] + f[:-1])
    return np.concatenate([[max(2.0 * f[0] - middle[0], 0.5 * f[0])], middle, [2.0 * f[-1] - middle[-1]]])


def _title(frf: FRF) -> str:
    ny, nu = frf.response.shape[1:]
    loops = ", ".join(symbol(name) for name in frf.loop.split("+")) if frf.loop else ""
    parts = (f"FRF matrix, {ny} x {nu}", f"loops {loops}" if loops else "", frf.recording)
    return "  ·  ".join(part for part in parts if part)
