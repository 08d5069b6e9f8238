"""Intervals of magnitudes, and of products and quotients of magnitudes, hold where noise is as large as they are. The
magnitude of H + d with a circular error d of variance s² = E|d|² is not H plus something normal: where |H| is below s
it is mostly the noise's own. So each end is found apart. The lower end is the least |H| under which so large a
measurement is still likely (Rice's distribution); it is 0 below 1.92 s. The upper end is |H + d| + 1.39 s, which is too
far where noise rules, and right elsewhere. Both are of two-sided 95 %.

Products go through in logarithms with the correlation of the errors, each factor with its own distance to its own end
(MOVER: Zou and Donner, Statistics in Medicine 27, 2008). Where the errors are small that is the first-order interval.
"""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np
from scipy.special import chdtri, fdtri, stdtrit

from loopshape.core.units import Array, ComplexArray

#: probability beyond each end of a two-sided 95 % interval
TAIL = 0.025


class Reach(NamedTuple):
    """Lower and upper end, of any one shape."""

    low: Array
    high: Array


@lru_cache(maxsize=256)
def _rice_table(tail: float) -> tuple[Array, Array]:
    """Measured magnitudes that `tail` of all measurements exceed, and the true ones, both in deviations."""
    from scipy.stats import ncx2

    true = np.concatenate([np.linspace(0.0, 4.0, 81), np.geomspace(4.1, 40.0, 60)])  # normal from there on
    return np.sqrt(0.5 * ncx2.isf(tail, 2, 2.0 * true**2)), true


def _lower_end(ratio: Array, tail: float) -> Array:
    """Lower end of |H|/s from the measured |H + d|/s, where s is known."""
    measured, true = _rice_table(tail)
    far = np.maximum(ratio - (measured[-1] - true[-1]), 0.0)
    return np.where(ratio < measured[-1], np.interp(ratio, measured, true, left=0.0), far)


@lru_cache(maxsize=256)
def _widening(freedom: float, tail: float) -> tuple[float, float, float]:
    """How much wider an interval is whose deviation is itself estimated: far from zero, at the threshold, and there."""
    if not np.isfinite(freedom):
        return 1.0, 1.0, float(np.sqrt(-np.log(tail)))
    normal = np.sqrt(chdtri(1, 2.0 * tail))
    threshold = float(np.sqrt(fdtri(2, freedom, 1.0 - tail)))
    return float(-stdtrit(freedom, tail) / normal), threshold / float(np.sqrt(-np.log(tail))), threshold


def magnitude_bounds(size: Array, deviation: Array, freedom: float = np.inf, tail: float = TAIL) -> Reach:
    """Interval of |H| from its measurement `size` and `deviation` = sqrt(E|d|²), of one shape and unit.

    `freedom` are the degrees of freedom of the variance, `tail` the probability beyond each end. With a freedom below
    ten the lower end near its threshold is a blend of Student's and Fisher's quantiles, checked by simulation only.
    """
    size, deviation = np.broadcast_arrays(np.asarray(size, dtype=float), np.asarray(deviation, dtype=float))
    far, near, threshold = _widening(freedom, tail)
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        ratio = np.where(deviation > 0.0, size / deviation, np.inf)
        widen = far + (near - far) * np.minimum(1.0, threshold / np.maximum(ratio, 1e-300)) ** 2
        inside = np.where(np.isfinite(ratio), ratio, 0.0) / widen
        low = np.where(np.isfinite(ratio), widen * _lower_end(inside, tail) * deviation, size)
    half_width = far * np.sqrt(0.5 * chdtri(1, 2.0 * tail))
    return Reach(np.minimum(low, size), size + half_width * deviation)


def product_bounds(
    factors: ComplexArray, covariance: ComplexArray, signs: Array, freedom: float = np.inf, tail: float = TAIL
) -> Reach:
    """Interval (nf,) of |product of H_i ** s_i| from factors (nf, m), signs (m,) of +1 and -1, covariance (nf, m, m).

    0 from where a factor above the line may be zero, infinite to where one below it may.
    """
    size = np.abs(factors)
    deviation = np.sqrt(np.maximum(np.real(np.einsum("fii->fi", covariance)), 0.0))
    low, high = magnitude_bounds(size, deviation, freedom, tail)
    centre = np.maximum(size, deviation)
    with np.errstate(divide="ignore", invalid="ignore"):
        up = np.where(centre > 0.0, np.log(np.maximum(high, centre) / centre), 0.0)
        down = np.where(centre > 0.0, np.log(centre / np.minimum(low, centre)), 0.0)
        middle = centre[:, signs > 0].prod(axis=1) / centre[:, signs < 0].prod(axis=1)
    together = _correlation(factors, covariance, deviation, signs)
    above, below = np.where(signs > 0, up, down), np.where(signs > 0, down, up)
    with np.errstate(over="ignore", invalid="ignore"):
        top, bottom = middle * np.exp(_joined(above, together)), middle * np.exp(-_joined(below, together))
    return Reach(np.nan_to_num(bottom, nan=0.0, posinf=np.inf), np.where(np.isnan(top), np.inf, top))


def _correlation(factors: ComplexArray, covariance: ComplexArray, deviation: Array, signs: Array) -> Array:
    """Correlation (nf, m, m) of the factors' logarithms times their signs; the worst where a phase is not known."""
    known = np.abs(factors) > 4.0 * deviation  # nearer to zero a correlation counts as if it hurt
    turn = np.where(known, factors.conj() / np.maximum(np.abs(factors), 1e-300), 0.0)
    scale = np.where(deviation > 0.0, deviation, np.inf)
    shared = covariance / (scale[:, :, None] * scale[:, None, :])
    turned = np.real(shared * turn[:, :, None] * turn.conj()[:, None, :]) * signs[:, None] * signs[None, :]
    made = np.where(known[:, :, None] & known[:, None, :], turned, np.abs(shared))
    diagonal = np.einsum("fii->fi", made)
    diagonal[...] = 1.0
    return np.asarray(made)


def _joined(distances: Array, together: Array) -> Array:
    """Root of the sum of squared distances (nf, m) with their correlations; infinite where one is."""
    finite = np.where(np.isfinite(distances), distances, 0.0)
    total = np.sqrt(np.maximum(np.einsum("fi,fij,fj->f", finite, together, finite), 0.0))
    return np.where(np.isfinite(distances).all(axis=1), total, np.inf)
