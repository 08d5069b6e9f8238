"""Rational first guesses by linear least squares: Levy (1959), reweighted after Sanathanan and Koerner (1963)."""

from __future__ import annotations

import numpy as np

from loopshape.core.units import Array, ComplexArray, angular
from loopshape.data.model import TransferFunction


def levy(
    f: Array,
    response: ComplexArray,
    weight: Array,
    numerator: int,
    denominator: int,
    integrators: int = 0,
    iterations: int = 10,
) -> TransferFunction:
    """Rational model fitted to a response (nf,) by linear equations, weighted by `weight` (nf,) >= 0.

    The denominator is monic with `integrators` roots at zero. Each iteration divides the equation by the
    last denominator, and the iterate with the least weighted error is kept: the iteration need not converge.
    """
    w0 = float(np.exp(np.mean(np.log(angular(f)))))
    s = 1j * angular(f) / w0
    b_terms = np.stack([s**k for k in range(numerator, -1, -1)], axis=1)
    a_terms = s[:, None] ** np.arange(denominator - 1, integrators - 1, -1)
    top = s**denominator
    shape = 1.0 / np.abs(top)
    best, best_error = None, np.inf
    for _ in range(iterations):
        scale = weight * shape
        left = np.hstack([b_terms, -response[:, None] * a_terms]) * scale[:, None]
        right = response * top * scale
        x = np.linalg.lstsq(np.vstack([left.real, left.imag]), np.concatenate([right.real, right.imag]), rcond=None)[0]
        b, a = x[: numerator + 1], x[numerator + 1 :]
        den = top + a_terms @ a
        error = float(np.sum((weight * np.abs(b_terms @ b / den - response)) ** 2))
        if error < best_error:
            best, best_error = (b, a), error
        shape = 1.0 / np.abs(den)
    assert best is not None
    b, a = best
    num = b * w0 ** (denominator - np.arange(numerator, -1, -1.0))
    tail = a * w0 ** (denominator - np.arange(denominator - 1, integrators - 1, -1.0))
    return TransferFunction(num, np.concatenate([[1.0], tail, np.zeros(integrators)]))
