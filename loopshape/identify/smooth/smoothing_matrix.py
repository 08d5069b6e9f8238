"""A plant's matrix with what neighbouring lines have in common taken together, and draws of the error that is left.

Each element is smoothed as `identify.smooth.smoothing` smooths a single response, with windows of its own; the
errors of all elements are drawn together, by the covariance of their line.
"""

from __future__ import annotations

from weakref import WeakKeyDictionary

import numpy as np

from loopshape.core.units import Array, ComplexArray
from loopshape.data.algebra.propagation import pick
from loopshape.data.response.frf import FRF
from loopshape.data.response.smoothed import Dense
from loopshape.identify.smooth.pole_terms import common_poles
from loopshape.identify.smooth.smoothing import SEED, drawn_errors, smoother_of
from loopshape.identify.spectra.pooling import pooled_variance

_DONE: WeakKeyDictionary[FRF, tuple[Dense, ComplexArray] | None] = WeakKeyDictionary()


def smoothed_matrix(frf: FRF) -> tuple[Dense, ComplexArray] | None:
    """Smoothed lines of a matrix FRF (n, ny, nu) with draws of their error, and what its narrow resonances add to them.

    None where the FRF has no covariance. The same FRF, the same answer.

    The covariance is used unchanged; the correlations between a line's elements are that line's own, their variances
    pooled with those of neighbours where few degrees of freedom know them. Narrow resonances, which all elements share,
    are taken out before and put back after, between the lines too.
    """
    if frf not in _DONE:
        _DONE[frf] = _smoothed(frf) if frf.covariance.any() else None
    return _DONE[frf]


def _smoothed(frf: FRF) -> tuple[Dense, ComplexArray]:
    ny, nu = frf.response.shape[1:]
    f, elements = frf.frequency_hz, [pick(frf, [i], [j]) for j in range(nu) for i in range(ny)]
    variance = np.stack([pooled_variance(one) for one in elements], axis=1)
    errors, poles = _drawn(frf, variance, SEED), common_poles(elements, variance)
    at = np.unique(np.concatenate([f, *(one.places_hz for one in poles)]))
    at = at[(at >= f[0]) & (at <= f[-1])]
    drawn = [one.drawn(errors) for one in poles]
    response, narrow = np.empty((at.size, ny, nu), dtype=complex), np.empty_like(frf.response, dtype=complex)
    reference, deviations = np.empty_like(response), np.empty((len(errors), at.size, ny, nu), dtype=complex)
    for k, one in enumerate(elements):
        j, i = divmod(k, ny)

        def put_back(places: Array, k: int = k) -> tuple[ComplexArray, ComplexArray]:
            still = sum((pole.response(places)[:, k] for pole in poles), np.zeros(places.size, dtype=complex))
            moved = [pole.deviations(places, own, k) for pole, own in zip(poles, drawn, strict=True)]
            return still, np.asarray(sum(moved, np.zeros((1, 1), dtype=complex)))

        still, moved = put_back(f)
        narrow[:, i, j] = still
        found = _smooth(one, still, errors[:, :, k] - moved, variance[:, k])
        if poles:
            found, (still, moved) = found.at(at), put_back(at)
        response[:, i, j], reference[:, i, j] = found.response + still, found.reference + still
        deviations[:, :, i, j] = found.deviations + moved
    return Dense(at, response, reference, deviations), narrow


def _smooth(one: FRF, poles: ComplexArray, errors: ComplexArray, variance: Array) -> Dense:
    """An element without its poles (nf,), smoothed, with errors (draws, nf) of what is left."""
    rest = one.siso - poles
    floor = np.maximum(variance, 1e-20 * np.abs(one.siso) ** 2 + 1e-300)
    smoother = smoother_of(one, rest, floor)
    response = np.asarray(smoother @ rest)
    return Dense(one.frequency_hz, response, np.asarray(smoother @ response), np.asarray((smoother @ errors.T).T))


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
