"""A plant's matrix with what neighbouring lines have in common taken together, and draws of the error that is left.

Each element is smoothed as `loopshape.estimate.smoothing` smooths a single response, with windows of its own; the
errors of all elements are drawn together, by the covariance of their line.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from loopshape.algebra.propagation import pick
from loopshape.estimate.pooling import pooled_variance
from loopshape.estimate.smoothing import DRAWS, SEED, drawn_errors, smoother_of
from loopshape.frf import FRF
from loopshape.units import Array, ComplexArray


class MatrixScatter(NamedTuple):
    """Smoothed response (nf, ny, nu), the same smoothed again, and draws of its error (draws, nf, ny, nu).

    As in `loopshape.smoothed.Scatter`: reading `reference` + each of `deviations` against reading `reference` shows
    what noise does to a nonlinear reading of `response`.
    """

    response: ComplexArray
    reference: ComplexArray
    deviations: ComplexArray


def smoothed_matrix(frf: FRF, *, seed: int = SEED) -> MatrixScatter | None:
    """Smoothed lines of a matrix FRF and their scatter; None where the FRF has no covariance.

    The covariance is believed; the correlations between a line's elements are that line's own, their variances pooled
    with those of neighbours where few degrees of freedom know them.
    """
    if not frf.covariance.any():
        return None
    ny, nu = frf.response.shape[1:]
    elements = [pick(frf, [i], [j]) for j in range(nu) for i in range(ny)]
    variance = np.stack([pooled_variance(one) for one in elements], axis=1)
    errors = _drawn(frf, variance, seed)
    response, reference = np.empty_like(frf.response), np.empty_like(frf.response)
    deviations = np.empty((DRAWS, *frf.response.shape), dtype=complex)
    for k, one in enumerate(elements):
        j, i = divmod(k, ny)
        floor = np.maximum(variance[:, k], 1e-20 * np.abs(one.siso) ** 2 + 1e-300)
        smoother = smoother_of(one, one.siso, floor)
        response[:, i, j] = np.asarray(smoother @ one.siso)
        reference[:, i, j] = np.asarray(smoother @ response[:, i, j])
        deviations[:, :, i, j] = np.asarray((smoother @ errors[:, :, k].T).T)
    return MatrixScatter(response, reference, deviations)


def _drawn(frf: FRF, variance: Array, seed: int) -> ComplexArray:
    """Errors (draws, nf, ny nu) of vec(response), neighbours correlated as they overlap."""
    rng, ones = np.random.default_rng(seed), np.ones(frf.frequency_hz.size)
    white = np.stack([drawn_errors(rng, ones, frf.line_overlap) for _ in variance.T], axis=2)
    return np.asarray(np.einsum("fij,dfj->dfi", _root(frf.covariance, variance), white))


def _root(covariance: ComplexArray, variance: Array) -> ComplexArray:
    """A root (nf, m, m) of covariances that have been given other variances (nf, m), their correlations kept."""
    own = np.sqrt(np.maximum(np.real(np.einsum("fii->fi", covariance)), 1e-300))
    values, vectors = np.linalg.eigh(covariance / own[:, :, None] / own[:, None, :])
    root = vectors * np.sqrt(np.maximum(values, 0.0))[:, None, :]
    return np.asarray(np.sqrt(variance)[:, :, None] * root)
