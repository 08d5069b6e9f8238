"""How likely the errors of the lines make a count of encirclements wrong."""

from __future__ import annotations

import numpy as np
from scipy.special import erfcx, ndtr

from loopshape.units import TWO_PI, Array, ComplexArray

#: lines this many deviations off -1 do not matter
_FAR = 4.5
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(24)
_NODES, _WEIGHTS = 0.5 * (_NODES + 1.0), 0.5 * _WEIGHTS


def reach_of(g: ComplexArray, std: Array, freedom: float = np.inf) -> Array:
    """|g| (nf,) in standard deviations sqrt E|d|² of a circular error, inf where there is none.

    A deviation that was itself estimated, with `freedom` degrees, counts for less: |d|² follows an F distribution with
    2 and `freedom` degrees, and the reach given is that of equal chance of a normal error.
    """
    with np.errstate(divide="ignore"):
        reach = np.abs(g) / np.where(std > 0.0, std, np.nan)
    reach = np.nan_to_num(reach, nan=np.inf)
    return np.asarray(np.sqrt(0.5 * freedom * np.log1p(2.0 * reach**2 / freedom)) if np.isfinite(freedom) else reach)


def chance_of_error(
    g: ComplexArray, reach: Array, before: complex, after: complex, overlap: float = 1.0
) -> tuple[float, Array]:
    """Chance that errors make the winding of g = 1 + L (nf,) about zero wrong, one at most, and each line's share.

    `reach` (nf,) is |g| in deviations, `before` and `after` are points of the path beyond both ends. Errors may move
    the whole path past zero, at its nearest, or each line alone; where `overlap` lines share an error their chances
    are one's.
    """
    alone = line_doubts(g, reach, before, after) / overlap
    together = ndtr(-np.sqrt(2.0) * reach)
    return min(float(alone.sum() + together.max()), 1.0), np.maximum(alone, together)


def line_doubts(g: ComplexArray, reach: Array, before: complex, after: complex) -> Array:
    """Chance (nf,) that each line's error alone changes how the path g (nf,) winds about zero.

    Between neighbours a and b a line changes the winding where its true value lies in the sector about zero between -a
    and -b that does not hold the measured one. The phase of a circular normal about g has a known density (Middleton,
    An Introduction to Statistical Communication Theory, 1960, section 9.2).
    """
    doubts = np.zeros(g.size)
    k = np.flatnonzero((reach < _FAR) & (g != 0.0))
    path = np.concatenate([[before], g, [after]])
    low, high = (np.mod(np.angle(-path[k + shift] / g[k]), TWO_PI) for shift in (0, 2))  # the measured value lies at 0
    width = np.abs(high - low)
    phase = np.minimum(low, high)[:, None] + width[:, None] * _NODES
    doubts[k] = width * (_density(phase, reach[k][:, None]) @ _WEIGHTS)
    doubts[g == 0.0] = 1.0
    return doubts


def _density(phase: Array, reach: Array) -> Array:
    """Density of the phase of `reach` + a circular normal of unit E|d|²."""
    x = reach * np.cos(phase)
    return np.asarray(np.exp(-(reach**2)) / TWO_PI * (1.0 + np.sqrt(np.pi) * x * erfcx(-x)))
