"""Fitting a hypothesis to evidence: Gauss-Newton in a box, every cell weighted by what it leaves.

Each cell has a variance of its own that is not known (all forms are wrong): the concentrated likelihood
sum log(1 + ms) is lowered by weights 1/(1 + ms), with ms the cell's mean square relative to its noise floor's.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import lsq_linear

from loopshape.core.units import Array
from loopshape.toolbox.gap.diagnose.evidence import Cell, Evidence
from loopshape.toolbox.gap.diagnose.hypothesis import Hypothesis


@dataclass(frozen=True, eq=False)
class Fitted:
    """A hypothesis at its numbers phi (p,): residual (n,), mean squares (cells,), and the slopes (n, p) last known."""

    hypothesis: Hypothesis
    phi: Array
    residual: Array
    mean_squares: Array
    slopes: Array

    @property
    def cost(self) -> float:
        """Sum over cells of log(1 + ms)."""
        return cost(self.mean_squares)

    @property
    def magnitudes(self) -> list[float]:
        """One an effect, in its unit."""
        return self.hypothesis.magnitudes(self.phi)


def cost(mean_squares: Array) -> float:
    """Sum over cells of log(1 + ms); infinite where a model gave no number."""
    total = float(np.sum(np.log1p(mean_squares)))
    return total if np.isfinite(total) else float("inf")


def at(evidence: Evidence, hypothesis: Hypothesis, phi: Array, slopes: Array) -> Fitted:
    """The hypothesis at phi, with slopes from elsewhere."""
    (residual,) = evidence.residuals([hypothesis.moves(phi)])
    return Fitted(hypothesis, phi, residual, evidence.mean_squares(residual), slopes)


def with_slopes(evidence: Evidence, fitted: Fitted, which: range) -> Fitted:
    """Slopes of the numbers `which` anew, by differences."""
    steps = fitted.hypothesis.steps(fitted.phi)
    moved = []
    for k in which:
        phi = fitted.phi.copy()
        phi[k] += steps[k]
        moved.append(fitted.hypothesis.moves(phi))
    slopes = fitted.slopes.copy()
    for k, residual in zip(which, evidence.residuals(moved), strict=True):
        slopes[:, k] = np.nan_to_num((residual - fitted.residual) / steps[k], nan=0.0, posinf=0.0, neginf=0.0)
    return replace(fitted, slopes=slopes)


def weights(mean_squares: Array) -> Array:
    """Weight of each cell (cells,): it counts once, relative to its noise floor and what it leaves."""
    return np.asarray(1.0 / (1.0 + mean_squares))


@dataclass(frozen=True, eq=False)
class Normal:
    """Normal equations by cell, relative to its noise floor's square: squares (cells, p, p), products (cells, p)."""

    squares: Array
    products: Array


def normal(evidence: Evidence, slopes: Array, residual: Array) -> Normal:
    """The normal equations of slopes (n, p) and a residual (n,)."""
    squares = [_share(c) * (slopes[c.part].T @ slopes[c.part]) for c in evidence.cells]
    return Normal(np.array(squares), products(evidence, slopes, residual))


def products(evidence: Evidence, slopes: Array, residual: Array) -> Array:
    """Mean products (cells, p) of slopes (n, p) and a residual (n,), relative to the noise floor's square."""
    return np.array([_share(c) * (slopes[c.part].T @ residual[c.part]) for c in evidence.cells])


def _share(cell: Cell) -> float:
    return 1.0 / ((cell.stop - cell.start) * cell.floor**2)


def box_step(hypothesis: Hypothesis, phi: Array, equations: Normal, weight: Array, free: Array) -> Array:
    """The step of phi (p,) that lowers the weighted sum of squares most inside the box, numbers `free` only."""
    h = np.tensordot(weight, equations.squares, 1)[np.ix_(free, free)]
    g = -(weight @ equations.products)[free]
    spread = np.flatnonzero(free) >= hypothesis.n_free
    h[spread, spread] += _SPREAD
    g[spread] -= _SPREAD * phi[free][spread]
    return _solve(h, g, (hypothesis.low - phi)[free], (hypothesis.high - phi)[free], free)


def _factor(h: Array) -> Array:
    """The Cholesky factor of a scaled matrix, with as much on its diagonal as differences of sums took off it."""
    for ridge in (1e-9, 1e-7, 1e-5):
        try:
            return np.asarray(np.linalg.cholesky(h + ridge * np.eye(len(h))), dtype=float)
        except np.linalg.LinAlgError:
            continue
    return np.asarray(np.linalg.cholesky(h + 1e-3 * np.eye(len(h))), dtype=float)


def _solve(h: Array, g: Array, low: Array, high: Array, free: Array) -> Array:
    scale = np.sqrt(np.maximum(np.diag(h), 1e-300))
    factor = _factor(h / np.outer(scale, scale))
    solution = lsq_linear(
        factor.T, np.linalg.solve(factor, g / scale), (low * scale - 1e-12, high * scale + 1e-12), method="bvls"
    )
    step = np.zeros(free.size)
    step[free] = np.clip(solution.x / scale, low, high)
    return step


def improve(evidence: Evidence, fitted: Fitted, rounds: int, *, all_slopes: bool) -> Fitted:
    """Some rounds of Gauss-Newton with halved steps where one does not pay; slopes of the spread anew if asked."""
    p = fitted.phi.size
    enough = 0.08
    for _ in range(rounds):
        which = range(p) if all_slopes else range(fitted.hypothesis.n_free)
        fitted = with_slopes(evidence, fitted, which)
        free = np.any(fitted.slopes != 0.0, axis=0)
        if not free.any():
            return fitted
        equations = normal(evidence, fitted.slopes, fitted.residual)
        step = box_step(fitted.hypothesis, fitted.phi, equations, weights(fitted.mean_squares), free)
        better = None
        for share in (1.0, 0.4, 0.1):
            phi = np.clip(fitted.phi + share * step, fitted.hypothesis.low, fitted.hypothesis.high)
            trial = at(evidence, fitted.hypothesis, phi, fitted.slopes)
            if trial.cost < fitted.cost:
                better = trial
                break
        if better is None:
            return fitted
        gain, fitted = fitted.cost - better.cost, better
        if gain < enough:
            return fitted
    return fitted


_SPREAD = 0.05  # a light hold on the spread: it decides only what the data leave open
