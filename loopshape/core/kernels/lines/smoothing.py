"""Local polynomials over the lines of a response: which window carries one, and the weights that it gives.

Lines are complex, their abscissa and weights real, so the smoother is a real matrix, banded.
"""

from __future__ import annotations

import numpy as np

from loopshape.core.kernels.compiled import compiled
from loopshape.core.kernels.types import Array, ComplexArray


@compiled
def window(k: int, half: int, lines: int) -> tuple[int, int]:
    """First line and the one after the last of a window of 2 half + 1 lines about k; at the ends it keeps its size."""
    low = min(max(k - half, 0), lines - 2 * half - 1)
    return low, low + 2 * half + 1


@compiled
def _orthonormal(x: Array, w: Array, degree: int, q: Array) -> None:
    """Polynomials q (degree + 1, n) in x (n,), orthonormal under the weights w (n,); two passes of Gram and Schmidt."""
    n = x.size
    reach = max(abs(x[0]), abs(x[n - 1]))
    for j in range(degree + 1):
        for i in range(n):
            q[j, i] = 1.0 if j == 0 else q[j - 1, i] * x[i] / reach
        for _ in range(2):
            for m in range(j):
                along = 0.0
                for i in range(n):
                    along += w[i] * q[m, i] * q[j, i]
                for i in range(n):
                    q[j, i] -= along * q[m, i]
        size = 0.0
        for i in range(n):
            size += w[i] * q[j, i] ** 2
        for i in range(n):
            q[j, i] /= np.sqrt(size)


@compiled
def _left_over(x: Array, y: ComplexArray, w: Array, degree: int, q: Array) -> float:
    """Weighted sum of squares that a polynomial of a degree leaves of y (n,)."""
    _orthonormal(x, w, degree, q)
    n = x.size
    rest = y.copy()
    for j in range(degree + 1):
        along = 0.0j
        for i in range(n):
            along += w[i] * q[j, i] * y[i]
        for i in range(n):
            rest[i] -= along * q[j, i]
    total = 0.0
    for i in range(n):
        total += w[i] * (rest[i].real ** 2 + rest[i].imag ** 2)
    return total


@compiled
def accepted_halves(
    x: Array, y: ComplexArray, v: Array, halves: np.ndarray, degree: int, strictness: float, overlap: float, span: float
) -> np.ndarray:
    """Half widths (nf,) of the widest windows over which a polynomial of a degree leaves no more than the noise.

    Windows widen through `halves` (rising) until the residual of y (nf,) exceeds what its variance v (nf,) explains by
    `strictness` standard deviations, or the window spans more than `span` in x (nf,). `overlap` is the number of
    lines that carry one line's worth of independent error. 0 where not even the narrowest holds.
    """
    lines = y.size
    found = np.zeros(lines, dtype=np.int64)
    q = np.empty((degree + 1, 2 * halves[-1] + 1))
    common = 0.5 * (min(overlap, 1.94) - 1.0)
    for k in range(lines):
        for half in halves:
            n = 2 * half + 1
            if n > lines:
                break
            low, high = window(k, half, lines)
            if x[high - 1] - x[low] > span:
                break
            rest = _left_over(x[low:high] - x[k], y[low:high], 1.0 / v[low:high], degree, q)
            expected = n - (degree + 1) * overlap
            spread = np.sqrt((n - degree - 1) * (1.0 + 2.0 * common * common))
            if rest - expected > strictness * spread:
                break
            found[k] = half
    return found


@compiled
def excesses(x: Array, y: ComplexArray, v: Array, width: int, degree: int, overlap: float) -> Array:
    """What a polynomial of a degree leaves over noise in windows of `width` lines, half of that apart, (windows,).

    The weighted squared residual of y (nf,) with variance v (nf,), in shares of what noise alone leaves of it.
    Windows start at lines 0, width/2, width, ...; the last ends with the last line.
    """
    step = width // 2
    count = max((x.size - width + step - 1) // step, 0) + 1
    found = np.empty(count)
    q = np.empty((degree + 1, width))
    for k in range(count):
        low = min(k * step, x.size - width)
        high = low + width
        rest = _left_over(x[low:high] - 0.5 * (x[low] + x[high - 1]), y[low:high], 1.0 / v[low:high], degree, q)
        found[k] = rest / max(width - (degree + 1) * overlap, 1.0)
    return found


@compiled
def within_span(x: Array, halves: np.ndarray, span: float) -> np.ndarray:
    """The half widths, narrowed until each window spans `span` in x at most."""
    out = halves.copy()
    for k in range(x.size):
        while out[k] > 0:
            low, high = window(k, out[k], x.size)
            if low >= 0 and x[high - 1] - x[low] <= span:
                break
            out[k] -= 1
    return out


@compiled
def smoothing_weights(x: Array, v: Array, halves: np.ndarray, degree: int) -> tuple[np.ndarray, Array]:
    """First lines (nf,) and weights (nf, widest) by which each window's lines make the response at its own."""
    lines, widest = x.size, 2 * halves.max() + 1
    first, weights = np.zeros(lines, dtype=np.int64), np.zeros((lines, widest))
    q = np.empty((degree + 1, widest))
    for k in range(lines):
        low, high = window(k, halves[k], lines)
        n = high - low
        first[k] = low
        if n == 1:
            weights[k, 0] = 1.0
            continue
        top = min(degree, n - 1)
        w = 1.0 / v[low:high]
        _orthonormal(x[low:high] - x[k], w, top, q)
        for i in range(n):
            total = 0.0
            for j in range(top + 1):
                total += q[j, k - low] * q[j, i]
            weights[k, i] = total * w[i]
    return first, weights
