"""How 1 + L runs between its lines: along the smoothed plant, its narrow resonances and the controller as it is.

Where several lie within a few lines of each other, all poles that these allow are followed.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from loopshape.core.kernels.loops.encirclements import turns
from loopshape.core.remembered import remembered
from loopshape.core.units import TWO_PI, Array, ComplexArray, hz
from loopshape.data.control.controller import Controller
from loopshape.data.response.frf import FRF
from loopshape.data.response.smoothed import Dense, Scatter
from loopshape.identify.smooth.pole_terms import PLACES
from loopshape.identify.smooth.smoothing import SEED, drawn_errors
from loopshape.loop.loop import Loop
from loopshape.loop.stability.mode_clusters import SHARPEST, ModeCluster
from loopshape.loop.tolerances import TOL

#: L is read between lines where it moves by so much of |1 + L| and is no smaller than this, on so many places at most
STEP, SMALL, MOST = 0.05, 0.05, 12
#: places along a path past a pole, in half widths of it: even on its circle, and on to where it is straight
_CIRCLE, _BEYOND = np.tan(np.linspace(-1.5, 1.5, 49)), np.geomspace(25.0, 4000.0, 8)
PATH_HALF_WIDTHS = np.concatenate([-_BEYOND[::-1], _CIRCLE, _BEYOND])
#: steps past crowded resonances are halved where 1 + L turns by more than this in rad, so many times
FAR, ROUNDS = 1.0, 8
#: resonances of the controller as wide as this many lines need no places of their own
WIDE = 16


@dataclass(frozen=True, eq=False)
class Path:
    """L (n,) at f (n,) in Hz, on lines and on places between them where 1 + L moves far.

    `std` (n,) is the deviation sqrt E|d|² of its error, `alike` (n - 1,) the correlation of neighbours' errors.
    `line` (n,) is true on lines.
    """

    f: Array
    L: ComplexArray
    std: Array
    alike: Array
    line: np.ndarray


def path_of(loop: Loop) -> Path:
    """L of a loop between its lines."""
    dense, C = interpolated(loop)
    f, (rms, _, alike) = dense.frequency_hz, dense.spread
    return Path(f, C * dense.response, np.abs(C) * rms, alike, np.isin(f, loop.frequency_hz))


@remembered
def interpolated(loop: Loop) -> tuple[Dense, ComplexArray]:
    """The plant with its draws, and the controller, on lines and on places between them where 1 + L moves far."""
    dense = between_lines(loop)
    own = _controller_places(loop.controller, dense.frequency_hz)
    if own.size:
        dense = dense.at(np.union1d(dense.frequency_hz, own))
    C = loop.controller.response(dense.frequency_hz)
    L = C * dense.response
    nearest = np.minimum(np.abs(1.0 + L[1:]), np.abs(1.0 + L[:-1]))
    small = np.maximum(np.abs(L[1:]), np.abs(L[:-1])) < SMALL
    more = dense.between(np.where(small, 0.0, np.abs(np.diff(L))), nearest, STEP, MOST)
    return more, C if more is dense else loop.controller.response(more.frequency_hz)


def between_lines(loop: Loop) -> Dense:
    """The plant where its smoothing tells it; on its lines as they are, with draws of their errors, without that."""
    f, P, scatter = loop.frequency_hz, loop.plant.siso, loop.scatter
    if scatter is not None:
        return scatter.dense or Dense(f, P, scatter.reference, scatter.deviations)
    variance = loop.plant.variance[:, 0, 0]
    if not variance.any():
        return Dense(f, P, P, np.zeros((1, f.size), dtype=complex))
    rng, overlap = np.random.default_rng(SEED), loop.plant.line_overlap
    return Dense(f, P, P, drawn_errors(rng, variance, overlap, TOL.deviation_draws))


def _controller_places(controller: Controller, f: Array) -> Array:
    """Frequencies in Hz over the narrow resonances of the controller as it runs, within lines f (nf,)."""
    places = [np.zeros(0)]
    for *_, a1, a2 in controller.biquads():
        square = a2 - 0.25 * a1**2
        if not square > 0.0:  # real poles
            continue
        s = controller.rate_hz * np.log(complex(-0.5 * a1, np.sqrt(square)))
        centre, width = hz(s.imag), max(hz(abs(s.real)), SHARPEST * hz(s.imag))
        k = int(np.searchsorted(f, centre))
        if 0 < k < f.size and width < WIDE * (f[k] - f[k - 1]):
            places.append(centre + width * PLACES)
    every = np.concatenate(places)
    return every[(every > f[0]) & (every < f[-1])]


def without_narrow(loop: Loop) -> ComplexArray:
    """The measured lines (nf,) without the resonances that the path follows."""
    return _rest(loop.measured, loop.scatter)


@remembered
def _rest(lines: FRF, scatter: Scatter | None) -> ComplexArray:
    if scatter is None or not scatter.pole_hz.size:
        return lines.siso
    return np.asarray(lines.siso - scatter.narrow(lines.frequency_hz))


def turns_past_cluster(cluster: ModeCluster, loop: Loop, path: Path) -> tuple[int, int, Array, bool]:
    """Least and most whole turns that 1 + L turns more than the path past resonances that stand close together.

    Of all the ways that the lines allow. And how near to -1 the likeliest comes in each gap, (last - first,); the last
    answer is False where L turns too fast about -1 to be followed.
    """
    own = cluster.window.around[0]
    here = slice(int(np.searchsorted(path.f, own[0])), int(np.searchsorted(path.f, own[-1])) + 1)
    at, P = _cluster_path(cluster)
    turns, ways, L = np.zeros(len(at)), np.arange(len(at)), loop.controller.response(at) * P
    near = np.minimum.reduceat(chords_to_minus_one(L[0])[0], np.searchsorted(at[0], own[:-1]))
    for k in range(ROUNDS):
        steps = _steps(1.0 + L)
        turns[ways] = steps.sum(axis=1)
        far = np.abs(steps) > FAR
        coarse = far.any(axis=1)
        if not coarse.any() or k == ROUNDS - 1:
            break
        ways, at, L, far = ways[coarse], at[coarse], L[coarse], far[coarse]
        most = int(far.sum(axis=1).max())
        middles = np.sort(np.where(far, 0.5 * (at[:, 1:] + at[:, :-1]), own[0]), axis=1)[:, -most:]
        at = np.concatenate([at, middles], axis=1)
        L = np.concatenate([L, loop.controller.response(middles) * cluster.response(middles, ways)], axis=1)
        rising = np.argsort(at, axis=1, kind="stable")
        at, L = np.take_along_axis(at, rising, axis=1), np.take_along_axis(L, rising, axis=1)
    more = np.rint((turns - turn(1.0 + path.L[here])) / TWO_PI).astype(int)
    return int(more.min()), int(more.max()), near, not coarse.any()


@lru_cache(maxsize=16)
def _cluster_path(cluster: ModeCluster) -> tuple[Array, ComplexArray]:
    """Frequencies (ways, n) in Hz along the lines of a crowd, dense about its poles, and P there: of no controller."""
    at = _places(cluster.window.around[0], cluster.pole_hz)
    P = cluster.response(at, np.arange(len(at)))
    for made in (at, P):
        made.setflags(write=False)
    return at, P


def _places(own: Array, z: ComplexArray) -> Array:
    """Frequencies (nz, n) in Hz along lines `own`, dense about each of the poles z (nz, m)."""
    even = np.concatenate([own, np.linspace(own[0], own[-1], 4 * own.size)])
    dense = (z.real[:, :, None] + np.abs(z.imag)[:, :, None] * PATH_HALF_WIDTHS).reshape(len(z), -1)
    every = np.concatenate([dense, np.broadcast_to(even, (len(z), even.size))], axis=1)
    return np.sort(np.clip(every, own[0], own[-1]), axis=1)


def turn(path: ComplexArray) -> Array:
    """Angle in rad that a path (..., n) turns about zero, at most half a turn a step."""
    rows = np.ascontiguousarray(path).reshape(-1, path.shape[-1])
    return np.asarray(turns(rows).reshape(path.shape[:-1]))


def _steps(path: ComplexArray) -> Array:
    """Angles in rad (..., n - 1) that each step of a path turns about zero; nothing where it meets it."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(np.nan_to_num(np.angle(path[..., 1:] / path[..., :-1])))


def unit_crossings(f: Array, L: ComplexArray) -> Array:
    """Frequencies in Hz where |L| = 1; between lines ln |L| is taken as linear in ln f."""
    size = np.log(np.abs(L))
    k = np.flatnonzero(size[:-1] * size[1:] < 0.0)
    at = f[k] * (f[k + 1] / f[k]) ** (size[k] / (size[k] - size[k + 1]))
    return np.sort(np.concatenate([at, f[size == 0.0]]))


def axis_crossings(f: Array, L: ComplexArray) -> Array:
    """Frequencies in Hz where L crosses the negative real axis, along chords."""
    k = np.flatnonzero(L.imag[:-1] * L.imag[1:] < 0.0)
    share = L.imag[k] / (L.imag[k] - L.imag[k + 1])
    value = L.real[k] + share * (L.real[k + 1] - L.real[k])
    at = f[k] + share * (f[k + 1] - f[k])
    exact = np.flatnonzero(L.imag == 0.0)
    return np.sort(np.concatenate([at, f[exact]])[np.concatenate([value, L.real[exact]]) < 0.0])


def chords_to_minus_one(L: ComplexArray) -> tuple[Array, Array]:
    """Distance of each chord of L (..., n) from -1, and at which share of the chord it lies, (..., n - 1) each."""
    start, step = 1.0 + L[..., :-1], np.diff(L)
    with np.errstate(divide="ignore", invalid="ignore"):
        share = np.clip(-(start.real * step.real + start.imag * step.imag) / np.abs(step) ** 2, 0.0, 1.0)
    share = np.where(np.isfinite(share), share, 0.0)
    return np.abs(start + share * step), share
