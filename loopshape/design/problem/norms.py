"""Rows of the norm of the weighted loop, sqrt(sum of |W|² |response|²) at its peaks: a limit, or what is made small.

Peaks of all operating points stand in one epigraph: the largest is made small, and its neighbours are kept below it.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from loopshape.core.kernels.loops import tuning_rows as kernel
from loopshape.core.units import Array
from loopshape.design.problem.evaluation import Evaluation
from loopshape.design.problem.rows import Rows, of_kernel
from loopshape.design.problem.weighed import weighed

#: name of the limit and of its rows
NORM = "weighted_norm"
#: peaks this far below the largest (ln) are left out, save the highest of each operating point
FAR = 0.7
#: of lines this near to the largest every fourth counts too: where the optimum is flat, all of it is pushed down
PLATEAU, EVERY = 0.1, 4
#: above the last lines rows come from this close (ln) to the largest
_NEAR = 0.05


def norm_rows(e: Evaluation) -> tuple[Rows, ...]:
    """Rows of ln of one over the norm, where it is among the largest; none where the objective has no norm."""
    if not e.p.requirements.objective.weighted_norm:
        return ()
    level = np.full((1, e.p.points), max(float(e.ln_norm.max()), float(_above(e)[0].max(initial=-np.inf))))
    kinds, from_hz, none = np.array([kernel.NORM]), np.zeros(1), np.zeros((0, e.p.f.size))
    made = kernel.magnitude_rows(
        e.flat, kinds, level, from_hz, np.array([kernel.NOT]), none, np.array([-1]), FAR, FAR - PLATEAU, EVERY
    )
    places, value, ab = made
    lines = of_kernel((NORM,), places, value - level[0, 0], ab)
    return (*lines, *norm_above(e, np.zeros(e.p.points)))


def norm_above(e: Evaluation, level: Array) -> Iterator[Rows]:
    """Rows below a level (points,) in ln above the last lines, where |L| stays below its last value l.

    There |S| is at most 1/(1 - l), |T| and |CS| and |PS| that times l, |C| and l/|C|.
    """
    size, by_C, by_l = _above(e)
    if size.size and np.isfinite(size).any():
        point, k = np.nonzero(np.isfinite(size) & ((size >= size.max() - _NEAR) | _largest(size)))
        p, last = e.p, e.p.line[e.last[point]]
        a, b = (np.asarray(-slope[point, k], dtype=complex) for slope in (by_C, by_l))
        yield Rows(NORM, level[point] - size[point, k], p.f.size + k, point, p.above.start + k, a, last, b)


def _largest(size: Array) -> np.ndarray:
    return np.arange(size.shape[1]) == size.argmax(axis=1)[:, None]


def _above(e: Evaluation) -> tuple[Array, Array, Array]:
    """ln of the norm (points, above) above the last lines, -inf without weights, and its slopes by ln |C| and ln l."""
    s, t, cs, ps = np.moveaxis(weighed(e.p).above, 1, 0)
    c2, l2, room = np.exp(2.0 * e.ln_C[e.p.above]), e.share_above[:, None] ** 2, 1.0 - e.share_above[:, None]
    if not s.size:
        return s, s, s
    parts = np.stack([s, t * l2, cs * c2, ps * l2 / c2])
    total = parts.sum(axis=0)
    with np.errstate(divide="ignore"):
        size = 0.5 * np.log(total) - np.log(room)
    share = parts / np.maximum(total, 1e-300)
    return size, share[2] - share[3], share[1] + share[3] + e.share_above[:, None] / room
