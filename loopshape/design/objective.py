"""Low-frequency disturbance rejection: the mean of ln 1/|S| over ln f on the lines up to a frequency.

S is the error with the loop over the error without it, wherever a disturbance enters, so that operating points with
large and small plants compare; |PS| would let the plant of largest gain speak for all. The mean is over ln f and not
over lines: it then hardly depends on how the lines are spaced.
"""

from __future__ import annotations

import numpy as np

from loopshape.core.units import Array
from loopshape.design.evaluation import Evaluation
from loopshape.design.problem import Problem


def rejection(e: Evaluation) -> Array:
    """Mean ln 1/|S| of each operating point (points,), zero where the objective asks for no disturbance's."""
    if e.p.requirements.objective.disturbance_below_hz is None:
        return np.zeros(e.p.points)
    return np.asarray(np.bincount(e.p.owner, weights=-e.ln_S * low_weights(e.p), minlength=e.p.points), dtype=float)


def rejection_slopes(e: Evaluation) -> Array:
    """d rejection/d x (points, n): d ln 1/|S| = Re(T d ln C)."""
    p = e.p
    if p.requirements.objective.disturbance_below_hz is None:
        return np.zeros((p.points, e.x.size))
    weights = low_weights(p)
    k = np.flatnonzero(weights)
    T = e.L[k] / (1.0 + e.L[k])
    columns, place = np.unique(p.line[k], return_inverse=True)
    each = np.real(weights[k] * T * p.slopes(e.blocks, columns)[:, place])
    return np.array([np.bincount(p.owner[k], weights=row, minlength=p.points) for row in each]).T


def low_weights(p: Problem) -> Array:
    """Weights of the flat lines up to `disturbance_below_hz`: trapezia in ln f, summing to one at each point."""
    below = p.requirements.objective.disturbance_below_hz
    weights = np.zeros(p.f.size)
    for a, b in zip(p.first[:-1] + p.led, p.first[1:], strict=True):
        low = p.ln_f[a:b][p.f[a:b] <= (below or 0.0)]
        span = np.diff(low)
        share = 0.5 * (np.append(span, 0.0) + np.append(0.0, span)) if low.size > 1 else np.ones(low.size)
        weights[a : a + low.size] = share / max(share.sum(), 1e-300)
    return weights
