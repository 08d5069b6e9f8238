"""Multiple and partial coherence: how much of an output all inputs explain, and each one beyond the others.

With few averages both are too high: where nothing is explained, the multiple coherence of q inputs is q/K in the mean
over K averages, the partial one 1/(K - q + 1) (Bendat and Piersol, Random Data, 4th ed. 2010, 9.2).
"""

from __future__ import annotations

import numpy as np

from loopshape.core.units import Array, ComplexArray


def coherences(power: ComplexArray, outputs: int, averages: float) -> tuple[Array | None, Array | None]:
    """Multiple (nf, ny) and partial (nf, ny, nu) coherence from cross-powers (nf, s, s) of outputs, then inputs.

    None where the inputs are not among the signals, or `averages` are no more than inputs: both are then 1, always.
    """
    inputs = power.shape[1] - outputs
    if inputs < 1 or averages <= inputs + 1e-9:
        return None, None
    multiple = np.empty((power.shape[0], outputs))
    partial = np.empty((power.shape[0], outputs, inputs))
    with np.errstate(all="ignore"):
        scale = np.sqrt(np.real(np.einsum("fii->fi", power)))
        alike = power / (scale[:, :, None] * scale[:, None, :])
        for i in range(outputs):
            rows = [i, *range(outputs, outputs + inputs)]
            inverse = _inverse(alike[:, rows][:, :, rows])
            diagonal = np.real(np.einsum("fii->fi", inverse))
            multiple[:, i] = 1.0 - 1.0 / diagonal[:, 0]
            partial[:, i] = np.abs(inverse[:, 0, 1:]) ** 2 / (diagonal[:, :1] * diagonal[:, 1:])
    return np.clip(np.nan_to_num(multiple), 0.0, 1.0), np.clip(np.nan_to_num(partial), 0.0, 1.0)


def _inverse(matrix: ComplexArray) -> ComplexArray:
    """Inverses (nf, n, n) of correlations; a rounding error's worth is added so that full coherence has one."""
    return np.asarray(np.linalg.inv(matrix + 1e-13 * np.eye(matrix.shape[1])))
