"""Draws of a response's error: one pass over all of them for what is asked of each frequency."""

from __future__ import annotations

import numpy as np

from loopshape.core.kernels.compiled import compiled
from loopshape.core.kernels.types import Array, ComplexArray


@compiled
def spread(draws: ComplexArray) -> tuple[Array, Array, Array]:
    """Root mean square (n,) of draws (m, n), their standard deviation (n,), and how alike neighbours are (n - 1,).

    Alike as |sum d_k+1 conj d_k| over the sizes of both, from 0 to 1; no less than 1e-150 counts as a size.
    """
    count, n = draws.shape
    power, middle, common = np.zeros(n), np.zeros(n, dtype=np.complex128), np.zeros(max(n - 1, 0), dtype=np.complex128)
    for row in draws:
        for k in range(n):
            z = row[k]
            power[k] += z.real * z.real + z.imag * z.imag
            middle[k] += z
        for k in range(n - 1):
            common[k] += row[k + 1] * row[k].conjugate()
    size, alike, off = np.maximum(np.sqrt(power), 1e-150), np.empty(common.size), np.empty(n)
    for k in range(n):
        middle[k] /= count
        off[k] = max(power[k] / count - (middle[k].real ** 2 + middle[k].imag ** 2), 0.0)
    for k in range(common.size):
        alike[k] = abs(common[k]) / (size[k + 1] * size[k])
    return np.sqrt(power / count), np.sqrt(off), alike


@compiled
def straight(
    draws: ComplexArray, k: np.ndarray, before: ComplexArray, after: ComplexArray, sides: ComplexArray,
    off: ComplexArray,
) -> ComplexArray:  # fmt: skip
    """Draws (m, n, e) at places (n,) after lines k (n,): `before` that line, `after` the next one, and a side of `off`.

    `draws` are (m, lines, e), `before` and `after` (n,) their weights, `sides` (m,) what each draw weighs `off` (n, e).
    """
    count, lines, elements = draws.shape
    out = np.empty((count, k.size, elements), dtype=np.complex128)
    for m in range(count):
        for p in range(k.size):
            here, ahead = draws[m, k[p]], draws[m, min(k[p] + 1, lines - 1)]
            for e in range(elements):
                out[m, p, e] = here[e] * before[p] + ahead[e] * after[p] + sides[m] * off[p, e]
    return out
