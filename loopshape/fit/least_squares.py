"""Weighted nonlinear least squares on a complex response, and the tests on what it leaves."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares
from scipy.stats import chi2, norm

from loopshape.units import Array, ComplexArray


@dataclass(frozen=True, eq=False)
class Solution:
    """Parameters, their covariance, residual statistics and outcome of one fit."""

    x: Array
    covariance: Array
    chi2_per_dof: float
    p_value: float
    runs_p_value: float
    outcome: str


def solve(
    model: Callable[[Array], ComplexArray],
    start: Array,
    bounds: tuple[Array, Array],
    measured: ComplexArray,
    variance: Array,
) -> Solution:
    """Fit `model(x)` (nf,) to `measured` (nf,) with variance E|d|² (nf,), from `start`.

    The residual is scaled to unit variance in its real and imaginary part. The covariance is that of the
    linearised problem, widened where the residual exceeds the noise.
    """
    scale = np.sqrt(0.5 * variance)

    def residual(x: Array) -> Array:
        r = (model(x) - measured) / scale
        return np.concatenate([r.real, r.imag])

    size = np.maximum(np.abs(start), 1e-3)
    found = least_squares(residual, start, bounds=bounds, x_scale=size, xtol=1e-12, ftol=1e-12, gtol=1e-12)
    freedom = max(found.fun.size - start.size, 1)
    total = float(found.fun @ found.fun)
    covariance = _inverse(np.asarray(found.jac)) * max(total / freedom, 1.0)
    at_bound = np.any(found.active_mask != 0)
    outcome = "not_converged" if found.status <= 0 else ("at_bound" if at_bound else "converged")
    half = found.fun.size // 2
    runs = min(runs_test(found.fun[:half]), runs_test(found.fun[half:]))
    p_value = float(chi2.sf(total, freedom))
    return Solution(found.x, covariance, total / freedom, p_value, min(1.0, 2.0 * runs), outcome)


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
