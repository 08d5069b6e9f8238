"""How good a controller is at first sight: all limits at all operating points, without slopes."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from loopshape.core.kernels.compiled import Array, ComplexArray, compiled
from loopshape.core.kernels.loops.flat_loops import all_stable
from loopshape.core.kernels.loops.margins import COLUMNS, LN_BANDWIDTH_HZ, LN_WEIGHTED, asked_of, lines_of, read_margins

#: a bound that is missed by more than this (ln or rad) is missed by so much
_WORST = 30.0


class QuickReadings(NamedTuple):
    """Plants on flat lines, and what is asked of their loops.

    `measured` (points,) are the first lines that were measured, `radius` (nf,) the radii of P's 95 % circles, `fitted`
    (points,) whether a fit leads below the first line. Of each column of `read_margins` the room is `sign` (found -
    `level`) `factor`, level (points, COLUMNS) being nan without a limit. `masks` (10, nf) and `masks_above` (points,
    10, above) weigh as there. `low` (nf,) are the weights of ln 1/|S| in the objective, `bandwidth`, `disturbance` and
    `weighted_norm` those of its terms, `penalty` that of a miss.
    """

    f: Array
    P: ComplexArray
    radius: Array
    first: np.ndarray
    measured: np.ndarray
    line: np.ndarray
    first_below: np.ndarray
    fitted: np.ndarray
    integrators: np.ndarray
    unstable: np.ndarray
    f_above: Array
    first_above: np.ndarray
    from_hz: float
    masks: Array
    masks_above: Array
    level: Array
    sign: Array
    factor: Array
    low: Array
    bandwidth: float
    disturbance: float
    weighted_norm: float
    penalty: float


@compiled
def quick_evaluate(
    q: QuickReadings, gain: float, C: ComplexArray, above: ComplexArray, below: ComplexArray, enough: float
) -> tuple[float, bool]:
    """-(objective) + penalty (worst miss) of `gain` C, inf where a loop is unstable, and whether all limits hold.

    `C` on the columns, `above` (f_above,) beyond the last lines, `below` L under the first ones without the gain. Inf
    too where some operating points alone miss a limit and make it no less than `enough`.
    """
    L = np.empty(q.P.size, dtype=np.complex128)
    for k in range(L.size):
        L[k] = gain * C[q.line[k]] * q.P[k]
    for p in range(q.first.size - 1):
        if abs(L[q.first[p + 1] - 1]) >= 1.0:
            return np.inf, False
    if not all_stable(L, q.first, gain * below, q.first_below, q.fitted, q.integrators, q.unstable):
        return np.inf, False
    room, slowest, least, largest, merit = np.inf, np.inf, np.inf, -np.inf, np.inf
    for p in range(q.first.size - 1):
        a, b, start = q.first[p], q.first[p + 1], q.first_above[p]
        mine, own = L[a:b], np.empty(b - a, dtype=np.complex128)
        for k in range(b - a):
            own[k] = gain * C[q.line[a + k]]
        masks, masks_above = q.masks[:, a:b].copy(), q.masks_above[p][:, start:].copy()
        lines = lines_of(q.f[a:b], own, q.f_above[start:], gain * above[start:])
        found, _ = read_margins(mine.reshape(1, b - a), lines, asked_of(q.from_hz, masks, masks_above, True, False))
        room = min(room, _room(q, p, found[0]), _sure(q, p, mine, own))
        slowest = min(slowest, _bandwidth(q, p, mine, found[0, LN_BANDWIDTH_HZ]))
        least = min(least, _rejection(q.low[a:b], mine))
        largest = max(largest, found[0, LN_WEIGHTED])
        merit = q.penalty * max(0.0, -room) - q.bandwidth * slowest - q.disturbance * least
        if q.weighted_norm > 0.0:
            merit += q.weighted_norm * largest
        if room < 0.0 and merit >= enough:
            return np.inf, False
    return merit, room >= 0.0


@compiled
def _room(q: QuickReadings, p: int, found: Array) -> float:
    """Least room of the limits at operating point p."""
    room = np.inf
    for c in range(COLUMNS):
        if not np.isnan(q.level[p, c]):
            room = min(room, max(q.sign[c] * (found[c] - q.level[p, c]) * q.factor[c], -_WORST))
    return room


@compiled
def _sure(q: QuickReadings, p: int, L: ComplexArray, C: ComplexArray) -> float:
    """Room of what keeps the count sure: -1 outside the 95 % circles, |L| above 1 at the first line."""
    a, largest = q.first[p], 0.0
    for k in range(L.size):
        largest = max(largest, abs(C[k]) * q.radius[a + k] / max(abs(1.0 + L[k]), 1e-300))
    room = -np.log(largest) if largest > 0.0 else np.inf
    return room if q.fitted[p] else min(room, np.log(max(abs(L[q.measured[p] - a]), 1e-300)))


@compiled
def _bandwidth(q: QuickReadings, p: int, L: ComplexArray, seen: float) -> float:
    """ln of the first 0 dB crossing; below the lowest line along the integrators' slope."""
    if seen > -np.inf:
        return seen
    return np.log(q.f[q.first[p]]) + np.log(max(abs(L[0]), 1e-300)) / max(q.integrators[p], 1)


@compiled
def _rejection(low: Array, L: ComplexArray) -> float:
    """Weighted sum of ln 1/|S|."""
    total = 0.0
    for k in range(L.size):
        if low[k] > 0.0:
            total += low[k] * np.log(max(abs(1.0 + L[k]), 1e-300))
    return total
