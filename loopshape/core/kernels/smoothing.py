"""Local polynomials over the lines of a response: which window carries one, and the weights that it gives.

Lines are complex, their abscissa and weights real, so the smoother is a real matrix, banded.
"""

from __future__ import annotations

import numpy as np

from loopshape.core.kernels.compiled import Array, ComplexArray, compiled


@compiled
def window(k: int, half: int, lines: int) -> tuple[int, int]:
    """First line and the one after the last of a window of 2 half + 1 lines about k; at the ends it keeps its size."""
    low = min(max(k - half, 0), lines - 2 * half - 1)
    return low, low + 2 * half + 1


@compiled
def _orthonormal(x: Array, w: Array, degree: int, q: Array) -> None:
    """Polynomials q (degree + 1, n) in x (n,), orthonormal under the weights w (n,); two passes of Gram and Schmidt."""
    n = x.size
    largest = max(abs(x[0]), abs(x[n - 1]))
    for j in range(degree + 1):
        for i in range(n):
            q[j, i] = 1.0 if j == 0 else q[j - 1, i] * x[i] / largest
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
