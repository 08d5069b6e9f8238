"""Weighted nonlinear least squares on a complex response, and the tests on what it leaves."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.optimize import least_squares
from scipy.stats import chi2, norm

from loopshape.core.units import Array, ComplexArray

#: chi²/dof below which what is left is no noise of the stated variance, but rounding: its signs tell nothing
NO_NOISE = 1e-6
#: sums of squares that differ by less are those of one minimum
SAME = 1.01


@dataclass(frozen=True, eq=False)
class Solution:
    """Parameters, their covariance, residual statistics and outcome of one fit."""

    x: Array
    covariance: Array
    chi2_per_dof: float
    p_value: float
    runs_p_value: float
    outcome: str
    starts: int = 1
    agreeing: int = 1


@dataclass(frozen=True, eq=False)
class Data:
    """What is fitted: response (nf,), its variance E|d|² (nf,), and how sure and how independent that variance is.

    `overlap` lines carry one line's worth of independent error; `freedom` are the variance's degrees of freedom,
    and `pooled` neighbouring lines share one variance.
    """

    response: ComplexArray
    variance: Array
    overlap: float
    freedom: float
    pooled: int = 1


def solve(
    model: Callable[[Array], ComplexArray],
    starts: Sequence[Array],
    bounds: tuple[Array, Array],
    data: Data,
    weight_variance: Array,
    slopes: Callable[[Array], ComplexArray] | None = None,
) -> Solution:
    """Fit `model(x)` (nf,) to the data, weighted by 1/`weight_variance` (nf,), from the best of several starts.

    `slopes` are those of the model (nf, parameters), found by differences where they are not given. `agreeing` counts
    the starts that end within 1 % of the least sum of squares.
    The covariance is that of the linearised estimate under the data's own variance, whatever the weights
    (the sandwich A^-1 J' V J A^-1), widened where the residual exceeds the noise, and by the overlap where
    neighbouring lines share their error.
    """
    scale = np.sqrt(0.5 * weight_variance)

    def residual(x: Array) -> Array:
        r = (model(x) - data.response) / scale
        return np.concatenate([r.real, r.imag])

    def jacobian(x: Array) -> Array:
        J = slopes(x) / scale[:, None]  # type: ignore[misc]
        return np.concatenate([J.real, J.imag])

    def one(start: Array) -> Any:
        size = np.maximum(np.abs(start), 1e-3)
        return least_squares(
            residual, start, jacobian if slopes else "2-point", bounds=bounds, x_scale=size, xtol=1e-12, ftol=1e-12,
            gtol=1e-12,
        )  # fmt: skip

    ends = [one(start) for start in starts]
    found = min(ends, key=lambda result: result.cost)
    agreeing = sum(end.cost <= SAME * found.cost + data.response.size * NO_NOISE for end in ends)
    left = (model(found.x) - data.response) / np.sqrt(0.5 * data.variance)
    J, share = np.asarray(found.jac), np.tile(data.variance / weight_variance, 2)
    inverse = _inverse(J)
    freedom, stretch = _freedom(J, inverse, share)
    chi2_per_dof = float(np.sum(np.abs(left) ** 2)) / freedom
    covariance = inverse @ (J.T @ (share[:, None] * J)) @ inverse * max(chi2_per_dof, 1.0) * data.overlap
    outcome = "not_converged" if found.status <= 0 else ("at_bound" if np.any(found.active_mask) else "converged")
    p_value, runs = residual_tests(left, freedom, data, stretch)
    if chi2_per_dof < NO_NOISE:
        runs = 1.0
    return Solution(found.x, covariance, chi2_per_dof, p_value, runs, outcome, len(starts), agreeing)


def _freedom(J: Array, inverse: Array, share: Array) -> tuple[float, float]:
    """Mean of the sum of squares of what is left, if the model is right, and its variance over twice that mean.

    n - p and 1 where the weights are the data's own variances. Under other weights the fit takes less out
    of the well-known lines: with R = I - J A^-1 J' the residual in units of its noise is B = V^-1/2 R V^1/2
    times white noise, and the moments are the traces of B'B.
    """
    n, p = J.shape
    if np.all(share == share[0]):
        return float(max(n - p, 1)), 1.0
    root = np.sqrt(share)
    B = (np.eye(n) - J @ inverse @ J.T) * (root[None, :] / root[:, None])
    gram = B.T @ B
    mean = float(np.trace(gram))
    return mean, float(np.sum(gram * gram)) / mean


def residual_tests(left: ComplexArray, freedom: float, data: Data, stretch: float = 1.0) -> tuple[float, float]:
    """p-values that what is left (nf,), of unit variance in each part, is noise: by its size and by its signs.

    Size: chi² with `freedom` over independent lines, allowing for variances that are estimates themselves
    (each square is then F-distributed, with mean nu/(nu-2) and a wider spread, and lines that share a variance
    vary together). Signs: a runs test over lines far enough apart not to share error.
    """
    nu = max(data.freedom, 6.0)
    mean, spread = 1.0, stretch
    if np.isfinite(nu):
        mean, spread = nu / (nu - 2.0), stretch * (nu / (nu - 4.0) + 2.0 * (data.pooled - 1) / nu)
    scale = data.overlap * spread
    total = float(np.sum(np.abs(left) ** 2)) / (mean * scale)
    apart = left[:: 1 if data.overlap == 1.0 else int(np.ceil(data.overlap)) + 1]
    return float(chi2.sf(total, freedom / scale)), min(1.0, 2.0 * min(runs_test(apart.real), runs_test(apart.imag)))


def _inverse(jacobian: Array) -> Array:
    """(J^T J)^-1 with columns scaled first; directions that the data do not see come out very wide."""
    size = np.linalg.norm(jacobian, axis=0)
    size = np.where(size > 0.0, size, 1.0)
    u = jacobian / size
    return np.asarray(np.linalg.pinv(u.T @ u, rcond=1e-14) / np.outer(size, size))


def runs_test(residual: Array) -> float:
    """Two-sided p-value of Wald and Wolfowitz's test (1940) that signs along the lines are random."""
    positive = residual > 0.0
    n1, n2 = int(positive.sum()), int((~positive).sum())
    if min(n1, n2) < 2:
        return 1.0 if residual.size < 8 else 0.0
    runs = 1 + int(np.sum(positive[1:] != positive[:-1]))
    mean = 2.0 * n1 * n2 / (n1 + n2) + 1.0
    variance = (mean - 1.0) * (mean - 2.0) / (n1 + n2 - 1.0)
    return float(2.0 * norm.sf(abs(runs - mean) / np.sqrt(variance)))
