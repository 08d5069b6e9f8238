"""Curves over frequency: the valid band drawn, the rest hinted at, axes that read well.

Phases are those that noise does not turn round: continuous where they are known, on the branch that poles at 0 tell.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patches import Polygon
from matplotlib.ticker import FuncFormatter, LogLocator, MultipleLocator, NullFormatter
from scipy.ndimage import median_filter

from loopshape.core.units import Array, ComplexArray, db, deg
from loopshape.data.control.controller import Controller
from loopshape.data.response.frf import FRF
from loopshape.loop.loop import Loop

NORMAL_95 = 1.959964
FLOOR_DB = -400.0
#: points of a curve that a print needs: some for each of its columns of dots
MOST = 20_000
NOT_VALID = "not valid"  # mark of the faint dots


def unwrapped_deg(response: ComplexArray, valid: np.ndarray | None = None) -> Array:
    """Phase (nf,) in degrees, continuous over the valid band, the first of them in (-270, 90].

    That branch lets a plant with an integrator start at -90 and go down. Lines outside the valid band take the branch
    nearest to the valid phase around them, so noise there cannot shift the rest by a turn.
    """
    raw = deg(np.angle(response))
    use = np.ones(raw.size, dtype=bool) if valid is None or not np.any(valid) else np.asarray(valid, dtype=bool)
    if not raw.size:
        return raw
    smooth = np.unwrap(raw[use], period=360.0)
    smooth = smooth - 360.0 * np.ceil((smooth[0] - 90.0) / 360.0)
    return nearest_branch(raw, np.interp(np.arange(raw.size), np.flatnonzero(use), smooth))


def nearest_branch(phase_deg: Array, near_deg: Array | float) -> Array:
    """Phases moved by whole turns to lie within 180 degrees of `near_deg`."""
    return phase_deg - 360.0 * np.round((phase_deg - near_deg) / 360.0)


def magnitude_band_db(frf: FRF) -> tuple[Array, Array]:
    """95 % band (nf,) of |G| in dB for a circular error: |G| varies with sqrt(variance/2)."""
    size, half_width = np.abs(frf.siso), NORMAL_95 * np.sqrt(frf.variance[:, 0, 0] / 2.0)
    return np.maximum(db(np.maximum(size - half_width, 0.0)), FLOOR_DB), db(size + half_width)


def thinned(f: Array, curves: Sequence[Array], most: int) -> np.ndarray:
    """Rows of the lines to draw: all where there are at most `most`, else every curve's extremes in each stretch.

    Stretches are equally long in log f, as many as keep the rows within `most`. A peak that stands on one line is
    kept: nothing is averaged or moved.
    """
    if f.size <= most:
        return np.arange(f.size)
    count = max(2, most)
    while True:
        rows = _extremes(f, curves, count)
        if rows.size <= most or count == 2:
            return rows
        count = max(2, int(0.8 * count))


def shown(x: Array, *curves: Array) -> tuple[Array, ...]:
    """Frequencies x (nf,) and curves over them as a print draws them: thinned where they are more than `MOST`."""
    if x.size <= MOST:
        return (x, *curves)
    rows = thinned(x, curves, MOST)
    return (x[rows], *(curve[rows] for curve in curves))


def _extremes(f: Array, curves: Sequence[Array], count: int) -> np.ndarray:
    """Rows of the first and last line, and of every curve's least and greatest value in each of `count` stretches."""
    edges = np.geomspace(f[0], f[-1], count + 1)[1:-1]
    starts = np.unique(np.concatenate([[0], np.searchsorted(f, edges)]))
    rows = {0, int(f.size) - 1}
    for low, high in zip(starts, [*starts[1:], f.size], strict=True):
        for curve in curves:
            rows |= {int(low + np.argmin(curve[low:high])), int(low + np.argmax(curve[low:high]))}
    return np.array(sorted(row for row in rows if row < f.size))


def draw_valid(ax: Axes, x: Array, y: Array, valid: np.ndarray, **look: Any) -> Line2D:
    """Valid points as a line, the others as faint dots that do not stretch the axes unless they are all there is."""
    rest = np.asarray(~valid, dtype=bool)
    if rest.any():
        size = 2.0 if np.any(valid) else 4.0
        style: dict[str, Any] = {"linestyle": "none", "marker": ".", "markersize": size, "markeredgewidth": 0.0}
        ax.add_artist(Line2D(*shown(x[rest], y[rest]), color=look.get("color"), alpha=0.35, gid=NOT_VALID, **style))
    if rest.all():
        seen = np.isfinite(y)
        ax.update_datalim(np.column_stack([x[seen], y[seen]]))
    return ax.plot(*shown(x[valid], y[valid]), **look)[0]


def draw_band(ax: Axes, x: Array, low: Array, high: Array, **look: Any) -> Polygon:
    """A filled band between two curves that does not stretch the axes."""
    x, low, high = shown(x, low, high)
    outline = np.concatenate([np.column_stack([x, low]), np.column_stack([x, high])[::-1]])
    patch = Polygon(outline, closed=True, linewidth=0.0, **look)
    ax.add_artist(patch)
    return patch


def frequency_axis(ax: Axes, low_hz: float, high_hz: float, *, label: bool = True) -> None:
    """Logarithmic Hz with plain numbers."""
    ax.set_xscale("log")
    ax.set_xlim(low_hz, high_hz)
    short = high_hz / low_hz < 300.0
    ax.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0) if short else (1.0,)))
    ax.xaxis.set_major_formatter(FuncFormatter(lambda f, _: f"{f:g}"))
    ax.xaxis.set_minor_locator(LogLocator(subs=tuple(range(1, 10))))
    ax.xaxis.set_minor_formatter(NullFormatter())
    if label:
        ax.set_xlabel("frequency [Hz]")


def hide_inner(*axes: Axes) -> None:
    """No frequency labels on axes that share those of the ones below."""
    for ax in axes:
        ax.set_xlabel("")
        ax.tick_params(labelbottom=False)
        ax.xaxis.set_in_layout(False)  # nothing of it stands outside the axes


def shown_band_hz(*frfs: FRF) -> tuple[float, float]:
    """Band to show: all valid bands, and the frequencies within a factor 1.6 around them."""
    low, high = frfs[0].frequency_hz[[0, -1]]
    bands = np.array([frf.valid_band_hz for frf in frfs])
    positive = min(float(frf.frequency_hz[frf.frequency_hz > 0.0][0]) for frf in frfs)
    low, high = max(low, positive), max(float(frf.frequency_hz[-1]) for frf in frfs)
    if np.isfinite(bands).any():
        low, high = max(low, np.nanmin(bands) / 1.6), min(high, np.nanmax(bands) * 1.6)
    return (float(low), float(high)) if low < high else (float(low) / 1.6, float(high) * 1.6)


def fit_decibels(ax: Axes, step: float = 10.0, span: float = 100.0, room: float = 1.0) -> None:
    """Whole steps of dB around what is plotted, at most `span` below the top."""
    low, high = _plotted(ax)
    top = step * np.ceil((high + room) / step)
    ax.set_ylim(max(step * np.floor((low - room) / step), top - span), top)


def fit_degrees(ax: Axes) -> None:
    """Whole steps of 45 degrees around what is plotted, at most seven ticks."""
    low, high = _plotted(ax)
    low, high = 45.0 * np.floor((low - 5.0) / 45.0), 45.0 * np.ceil((high + 5.0) / 45.0)
    ax.set_ylim(low, high)
    doublings = max(0.0, np.ceil(np.log2((high - low) / 270.0)))
    ax.yaxis.set_major_locator(MultipleLocator(45.0 * 2.0**doublings))


def _plotted(ax: Axes) -> tuple[float, float]:
    low, high = float(ax.dataLim.y0), float(ax.dataLim.y1)
    return (low, high) if np.isfinite(low) and np.isfinite(high) else (-1.0, 1.0)


#: a phase is known where the error E|d|² of a line is below half its magnitude: a standard deviation of 20 degrees
_KNOWN = 0.5
_NEIGHBOURS = np.array([1.0, 4.0, 6.0, 4.0, 1.0])  # binomial: no slope of phase below 180 degrees a line reads falsely


def known_lines(frf: FRF) -> np.ndarray:
    """Valid lines (nf,) of a 1 x 1 FRF whose phase is known, by their own error and the median of five lines'."""
    relative = frf.relative_std[:, 0, 0]
    return np.asarray(frf.valid & (relative <= _KNOWN) & (median_filter(relative, 5, mode="nearest") <= _KNOWN))


def continuous_deg(response: ComplexArray, relative: Array, known: np.ndarray) -> Array:
    """Phase (nf,) in degrees without jumps from noise, up to whole turns.

    `relative` (nf,) is the standard deviation of the response over its magnitude. The phase follows the mean direction
    of five neighbouring lines, each weighing as it is sure; every line then takes the branch nearest to that, so one
    bad line turns nothing round. Lines that are not `known` take the branch of those around them.
    """
    own = deg(np.angle(response))
    use = known if np.any(known) else np.ones(own.size, dtype=bool)
    course = np.unwrap(_directions_deg(np.exp(1j * np.angle(response)), relative)[use], period=360.0)
    return nearest_branch(own, np.interp(np.arange(own.size), np.flatnonzero(use), course))


def _directions_deg(unit: ComplexArray, relative: Array) -> Array:
    """Mean direction (nf,) of five lines about each; beyond both ends the phase goes on as it came."""
    sure = 0.05  # lines with a smaller relative error are all equally sure of their branch
    weight = 1.0 / np.maximum(relative, sure) ** 2
    edge = min(2, unit.size - 1)
    before, after = slice(edge, 0, -1), slice(-2, -2 - edge, -1)
    directions = [
        unit[0] ** 2 / unit[before] * weight[before],
        unit * weight,
        unit[-1] ** 2 / unit[after] * weight[after],
    ]
    mean = np.convolve(np.concatenate(directions), _NEIGHBOURS, mode="full")
    return deg(np.angle(mean[2 + edge : 2 + edge + unit.size]))


def plant_phase_deg(loop: Loop) -> tuple[Array, np.ndarray]:
    """Phase (nf,) of the plant in degrees and where it is known.

    With n integrators it starts within 180 degrees of -90 n - 45, a plant lags rather than leads; where their number
    is not known in (-270, 90].
    """
    known = known_lines(loop.plant)
    phase = continuous_deg(loop.plant.siso, loop.plant.relative_std[:, 0, 0], known)
    first = phase[np.flatnonzero(known)[0]] if known.any() else phase[0]
    about = -90.0 if loop.integrators is None else -90.0 * loop.integrators - 45.0
    return np.asarray(phase + (float(nearest_branch(first, about)) - first)), known


def controller_phase_deg(controller: Controller, frequency_hz: Array) -> Array:
    """Phase (nf,) of the controller as it runs, followed from far below the lines, where its integrators speak."""
    below = np.geomspace(1e-4 * frequency_hz[0], frequency_hz[0], 400, endpoint=False)
    phase = deg(np.unwrap(np.angle(controller.response(np.concatenate([below, frequency_hz])))))
    start = float(nearest_branch(phase[0], -90.0 * controller.integrators() - 1.0))
    return np.asarray(phase + (start - phase[0]))[below.size :]


def loop_phase_deg(loop: Loop) -> tuple[Array, np.ndarray]:
    """Phase (nf,) of L = C P in degrees, and where it is known: the plant's, and the controller's added to it."""
    phase, known = plant_phase_deg(loop)
    return phase + controller_phase_deg(loop.controller, loop.frequency_hz), known


def draw_known(ax: Axes, x: Array, y: Array, known: np.ndarray, **look: Any) -> Line2D:
    """Known points as a line that breaks where others lie between them; these are faint dots."""
    _draw_dots(ax, x, y, ~known, **look)
    rows = np.flatnonzero(known)
    span = slice(rows[0], rows[-1] + 1) if rows.size else slice(0, 0)
    return ax.plot(x[span], np.where(known, y, np.nan)[span], **look)[0]


def _draw_dots(ax: Axes, x: Array, y: Array, rows: np.ndarray, **look: Any) -> None:
    """Some points as faint dots that do not stretch the axes unless they are all there is."""
    if not np.any(rows):
        return
    size = 4.0 if np.all(rows) else 2.0
    style: dict[str, Any] = {"linestyle": "none", "marker": ".", "markersize": size, "markeredgewidth": 0.0}
    ax.add_artist(Line2D(x[rows], y[rows], color=look.get("color"), alpha=0.35, gid=NOT_VALID, **style))
    seen = np.isfinite(x) & np.isfinite(y)
    if np.all(rows) and seen.any():
        ax.update_datalim(np.column_stack([x[seen], y[seen]]))
