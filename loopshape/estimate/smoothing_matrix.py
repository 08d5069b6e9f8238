"""A plant's matrix with what neighbouring lines have in common taken together, and draws of the error that is left.

Each element is smoothed as `loopshape.estimate.smoothing` smooths a single response, with windows of its own; the
errors of all elements are drawn together, by the covariance of their line.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from loopshape.algebra.propagation import pick
from loopshape.estimate.pole_terms import common_poles
from loopshape.estimate.pooling import pooled_variance
from loopshape.estimate.smoothing import SEED, drawn_errors, smoother_of
from loopshape.frf import FRF
from loopshape.smoothed import Dense
from loopshape.units import Array, ComplexArray


def smoothed_matrix(frf: FRF, *, seed: int = SEED) -> Dense | None:
    """Smoothed lines of a matrix FRF (n, ny, nu) with draws of their error; None where the FRF has no covariance.

    The covariance is believed; the correlations between a line's elements are that line's own, their variances pooled
    with those of neighbours where few degrees of freedom know them. Narrow resonances, which all elements share, are
    taken out before and put back after, between the lines too.
    """
    if not frf.covariance.any():
        return None
    ny, nu = frf.response.shape[1:]
    f, elements = frf.frequency_hz, [pick(frf, [i], [j]) for j in range(nu) for i in range(ny)]
    variance = np.stack([pooled_variance(one) for one in elements], axis=1)
    errors, poles = _drawn(frf, variance, seed), common_poles(elements, variance)
    at = np.unique(np.concatenate([f, *(one.places_hz for one in poles)]))
    at = at[(at >= f[0]) & (at <= f[-1])]
    whole = np.zeros((f.size, len(elements)), dtype=complex) + sum(one.response(f) for one in poles)
    moved = np.zeros(errors.shape, dtype=complex) + sum(one.deviations(f, errors) for one in poles)
    found = [
        _smooth(one, whole[:, k], moved[:, :, k], errors[:, :, k], variance[:, k]) for k, one in enumerate(elements)
    ]
    dense = [one.at(at) for one in found] if poles else found

    def matrix(values: Sequence[np.ndarray], more: np.ndarray | int) -> np.ndarray:
        stacked = np.stack(values, axis=-1) + more
        return stacked.reshape(*stacked.shape[:-1], nu, ny).swapaxes(-1, -2)

    back, strays = sum(one.response(at) for one in poles), sum(one.deviations(at, errors) for one in poles)
    return Dense(
        at,
        matrix([one.response for one in dense], back),
        matrix([one.reference for one in dense], back),
        matrix([one.deviations for one in dense], strays),
    )


def _smooth(one: FRF, poles: ComplexArray, moved: ComplexArray, errors: ComplexArray, variance: Array) -> Dense:
    """An element without its poles (nf,), smoothed; `moved` (draws, nf) is what errors do to the poles."""
    rest = one.siso - poles
    floor = np.maximum(variance, 1e-20 * np.abs(one.siso) ** 2 + 1e-300)
    smoother = smoother_of(one, rest, floor)
    response = np.asarray(smoother @ rest)
    return Dense(
        one.frequency_hz, response, np.asarray(smoother @ response), np.asarray((smoother @ (errors - moved).T).T)
    )


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
