"""Characteristic loci: the eigenvalues of L over frequency, each followed from line to line."""

from __future__ import annotations

import numpy as np
from scipy.optimize import linear_sum_assignment

from loopshape.core.units import ComplexArray


def characteristic_loci(L: ComplexArray) -> ComplexArray:
    """Eigenvalues (nf, n) of L (nf, n, n), joined to smooth curves as well as lines allow.

    Each line's eigenvalues go to where the two lines before lead, all at once at the least squared distance, relative
    to their size. Where two loci meet the names behind the meeting are arbitrary; their set is not.
    """
    loci = np.linalg.eigvals(L).astype(complex)
    n = loci.shape[1]
    if n == 1:
        return loci
    order = np.argsort(-np.abs(loci[0]))
    loci[0] = loci[0][order]
    for k in range(1, len(loci)):
        ahead = loci[k - 1] if k == 1 else 2.0 * loci[k - 1] - loci[k - 2]
        apart = np.minimum(_distance(ahead, loci[k]), _distance(loci[k - 1], loci[k]))
        _, columns = linear_sum_assignment(apart)
        loci[k] = loci[k][columns]
    return loci


def _distance(one: ComplexArray, two: ComplexArray) -> np.ndarray:
    size = np.maximum(np.abs(one)[:, None] + np.abs(two)[None, :], 1e-300)
    return np.asarray(np.abs(one[:, None] - two[None, :]) ** 2 / size**2)
