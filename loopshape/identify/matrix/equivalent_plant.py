"""The plant that a loop's controller meets while other loops are closed, and what closing them changes.

Intervals of magnitudes, and of products and quotients of magnitudes, hold where noise is as large as they are. The
magnitude of H + d with a circular error d of variance s² = E|d|² is not H plus something normal: where |H| is below s
it is mostly the noise's own. So each end is found apart. The lower end is the least |H| under which so large a
measurement is still likely (Rice's distribution); it is 0 below 1.92 s. The upper end is |H + d| + 1.39 s, which is too
far where noise rules, and right elsewhere. Both are of two-sided 95 %.

Products go through in logarithms with the correlation of the errors, each factor with its own distance to its own end
(MOVER: Zou and Donner, Statistics in Medicine 27, 2008). Where the errors are small that is the first-order interval.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from scipy.special import chdtri, fdtri, stdtrit

from loopshape.core.errors import WrongUseError
from loopshape.core.units import Array, ComplexArray, deg
from loopshape.data.algebra.propagation import invert, pick
from loopshape.data.control.controller import Controller
from loopshape.data.response.frf import FRF
from loopshape.data.response.interaction import EquivalentPlant
from loopshape.identify.tolerances import TOL


def equivalent_plant(
    frf: FRF, names: Sequence[str], loop: str, controllers: Mapping[str, Controller]
) -> EquivalentPlant:
    """P_ii - P_ij K (I + P_jj K)^-1 P_ji of a square FRF whose k-th loop is `names[k]`, with all others closed by K.

    For two loops closed/open = 1 - k_I T_j, with T_j what the other loop makes of its reference. To first order, which
    misleads where I + P_jj K is small beside its error; whether the inner loop is stable no line can say by itself.
    """
    if loop not in names:
        raise WrongUseError("a loop is not in the FRF", loop, f"it has {', '.join(names)}")
    i = list(names).index(loop)
    rest = [k for k in range(len(names)) if k != i]
    missing = [names[k] for k in rest if names[k] not in controllers]
    if missing:
        raise WrongUseError(
            f"the plant that {loop} meets needs the other loops' controllers", f"none of {', '.join(missing)}",
            "give them by loop",
        )  # fmt: skip
    own = replace(pick(frf, [i], [i]), loop=loop)
    K = _diagonal([controllers[names[k]] for k in rest], frf.frequency_hz)
    value, slope = _closure(frf.response, K, i, rest, frf.frequency_hz)
    changes: dict[str, Any] = {
        name: _spread(slope, C, slope)[:, None, None].astype(complex)
        for name in ("covariance", "noise_covariance")
        if (C := getattr(frf, name)) is not None
    }
    others = tuple(names[k] for k in rest)
    closed = replace(
        own,
        response=value[:, None, None],
        method=f"{frf.method}, with {', '.join(others)} closed",
        open_loop=False,
        **changes,
    )
    return _compared(frf, own, closed, slope, i, others)


def _diagonal(controllers: Sequence[Controller], f: Array) -> ComplexArray:
    K = np.zeros((f.size, len(controllers), len(controllers)), dtype=complex)
    for k, one in enumerate(controllers):
        K[:, k, k] = one.response(f)
    return K


def _closure(P: ComplexArray, K: ComplexArray, i: int, rest: Sequence[int], f: Array) -> tuple[ComplexArray, ...]:
    """Equivalent plant (nf,) and its slopes (nf, n²) by vec(P), columns stacked.

    dP_e = [1, -P_ij X] dP [1; -X P_ji] with X = K (I + P_jj K)^-1: from outside, z_i and what it makes of the others.
    """
    inner = P[:, rest][:, :, rest]
    X = K @ invert(np.eye(len(rest)) + inner @ K, f, "I + P K of the other loops")
    left, right = (np.zeros(P.shape[:2], dtype=complex) for _ in range(2))
    left[:, i] = right[:, i] = 1.0
    left[:, rest] = -np.einsum("fj,fjk->fk", P[:, i, rest], X)
    right[:, rest] = -np.einsum("fjk,fk->fj", X, P[:, rest, i])
    value = P[:, i, i] + np.einsum("fj,fj->f", left[:, rest], P[:, rest, i])
    return value, np.einsum("fl,fk->flk", right, left).reshape(P.shape[0], -1)


def _spread(one: ComplexArray, covariance: ComplexArray, two: ComplexArray) -> Array:
    """Real part of one C two^H at each line, not negative where both are one."""
    made = np.real(np.einsum("fi,fij,fj->f", one, covariance, two.conj(), optimize=True))
    return np.asarray(np.maximum(made, 0.0))


def _compared(frf: FRF, own: FRF, closed: FRF, slope: ComplexArray, i: int, others: tuple[str, ...]) -> EquivalentPlant:
    """Closed over open: both err by the same dP, so their relative errors are taken off each other first."""
    by_own = np.zeros_like(slope)
    by_own[:, i * len(frf.outputs) + i] = 1.0
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = closed.siso / own.siso
        # d(closed/open) = (d closed - ratio d open)/open: finite where the closed plant is zero
        deviation = np.sqrt(_spread(s := (slope - ratio[:, None] * by_own) / own.siso[:, None], frf.covariance, s))
        relative = deviation / np.abs(ratio)
    low, high = magnitude_bounds(np.abs(ratio), deviation, frf.variance_freedom)
    half_width = np.minimum(high / np.abs(ratio) - 1.0, 1.0)
    half_width_deg = np.where((low > 0.0) & (half_width < 1.0), deg(np.arcsin(half_width)), 180.0)
    return EquivalentPlant(own.loop, others, own, closed, ratio, relative, low, high, half_width_deg)


class Reach(NamedTuple):
    """Lower and upper end, of any one shape."""

    low: Array
    high: Array


@lru_cache(maxsize=256)
def _rice_table(tail: float) -> tuple[Array, Array]:
    """Measured magnitudes that `tail` of all measurements exceed, and the true ones, both in deviations."""
    from scipy.stats import ncx2

    true = np.concatenate([np.linspace(0.0, 4.0, 81), np.geomspace(4.1, TOL.normal_std, 60)])
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


def magnitude_bounds(size: Array, deviation: Array, freedom: float = np.inf, tail: float = TOL.tail) -> Reach:
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
    factors: ComplexArray, covariance: ComplexArray, signs: Array, freedom: float = np.inf, tail: float = TOL.tail
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
    known = np.abs(factors) > TOL.phase_known_std * deviation
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
