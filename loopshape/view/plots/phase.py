"""Phases that noise does not turn round: continuous where they are known, on the branch that the poles at 0 tell."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from scipy.ndimage import median_filter

from loopshape.core.units import Array, ComplexArray, deg
from loopshape.data.control.controller import Controller
from loopshape.data.control.loop import Loop
from loopshape.data.response.frf import FRF
from loopshape.view.plots.curves import UNTRUSTED, nearest_branch

#: a phase is known where the error E|d|² of a line is below half its magnitude: a standard deviation of 20 degrees
KNOWN = 0.5
_NEIGHBOURS = np.array([1.0, 4.0, 6.0, 4.0, 1.0])  # binomial: no slope of phase below 180 degrees a line reads falsely
#: lines with a smaller relative error are all equally sure of their branch
SURE = 0.05


def known_lines(frf: FRF) -> np.ndarray:
    """Valid lines (nf,) of a 1 x 1 FRF whose phase is known, by their own error and the median of five lines'."""
    relative = frf.relative_std[:, 0, 0]
    return np.asarray(frf.trusted & (relative <= KNOWN) & (median_filter(relative, 5, mode="nearest") <= KNOWN))


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
    weight = 1.0 / np.maximum(relative, SURE) ** 2
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
    draw_dots(ax, x, y, ~known, **look)
    rows = np.flatnonzero(known)
    span = slice(rows[0], rows[-1] + 1) if rows.size else slice(0, 0)
    return ax.plot(x[span], np.where(known, y, np.nan)[span], **look)[0]


def draw_dots(ax: Axes, x: Array, y: Array, rows: np.ndarray, **look: Any) -> None:
    """Some points as faint dots that do not stretch the axes unless they are all there is."""
    if not np.any(rows):
        return
    size = 4.0 if np.all(rows) else 2.0
    style: dict[str, Any] = {"linestyle": "none", "marker": ".", "markersize": size, "markeredgewidth": 0.0}
    ax.add_artist(Line2D(x[rows], y[rows], color=look.get("color"), alpha=0.35, gid=UNTRUSTED, **style))
    seen = np.isfinite(x) & np.isfinite(y)
    if np.all(rows) and seen.any():
        ax.update_datalim(np.column_stack([x[seen], y[seen]]))
