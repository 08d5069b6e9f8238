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
    overlap: float,
) -> Solution:
    """Fit `model(x)` (nf,) to `measured` (nf,) with variance E|d|² (nf,), from `start`.

    The residual is scaled to unit variance in its real and imaginary part. The covariance is that of the
    linearised problem, widened where the residual exceeds the noise, and by `overlap` where neighbouring
    lines share their error (that many lines count as one); the tests count independent lines alike.
    """
    scale = np.sqrt(0.5 * variance)

    def residual(x: Array) -> Array:
        r = (model(x) - measured) / scale
        return np.concatenate([r.real, r.imag])

    size = np.maximum(np.abs(start), 1e-3)
    found = least_squares(residual, start, bounds=bounds, x_scale=size, xtol=1e-12, ftol=1e-12, gtol=1e-12)
    freedom = max(found.fun.size - start.size, 1)
    total = float(found.fun @ found.fun)
    covariance = _inverse(np.asarray(found.jac)) * max(total / freedom, 1.0) * overlap
    at_bound = np.any(found.active_mask != 0)
    outcome = "not_converged" if found.status <= 0 else ("at_bound" if at_bound else "converged")
    half = found.fun.size // 2
    p_value, runs = residual_tests(found.fun[:half] + 1j * found.fun[half:], start.size, overlap)
    return Solution(found.x, covariance, total / freedom, p_value, runs, outcome)


def residual_tests(residual: ComplexArray, parameters: int, overlap: float) -> tuple[float, float]:
    """p-values that a residual (nf,), of unit variance in each part, is noise: by its size and by its signs.

    Size: chi² over independent lines; signs: a runs test over lines far enough apart not to share error.
    """
    freedom = max(2 * residual.size - parameters, 1)
    size = float(chi2.sf(float(np.sum(np.abs(residual) ** 2)) / overlap, freedom / overlap))
    apart = residual[:: 1 if overlap == 1.0 else int(np.ceil(overlap)) + 1]
    return size, min(1.0, 2.0 * min(runs_test(apart.real), runs_test(apart.imag)))


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
