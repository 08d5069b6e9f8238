"""Sums over windows of neighbouring lines, from which local least squares follow without a matrix for each line.

With signals z = (R, 1, X_1 .. X_m) of an instrument R and answers X, a local model's normal equations hold nothing but
the moments M_s[a, b] = sum_j conj(z_a(j)) z_b(j) t_j^s over its window, t_j the distance from the line in question.
Windows about one line lie within each other, so that each line of the record is added once for all of them.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from loopshape.core.kernels.compiled import Array, ComplexArray, compiled, compiled_in_line

#: beyond so many lines a window's leverages are small, and their mean is taken for each
NARROW = 100


class Windows(NamedTuple):
    """A window [left, right] (n,), both ends included, about each of `lines` (n,), and the order of its polynomials."""

    lines: np.ndarray
    left: np.ndarray
    right: np.ndarray
    order: int


class Solved(NamedTuple):
    """What was fitted in n windows, contiguous; shapes and meaning as in `Fits`."""

    inverse: ComplexArray
    theta: ComplexArray
    denominator: ComplexArray
    bends: ComplexArray
    pull: ComplexArray


@compiled
def moments(z: ComplexArray, lines: Array, left: Array, right: Array, powers: int, out: ComplexArray) -> None:
    """Moments (n, windows, powers, s, s) at `lines` (n,) of z (nf, s), over windows [left, right] (n, windows), both
    ends included, each within the next; t is the distance over half the widest window. Upper triangles are filled.
    """
    s, windows = z.shape[1], left.shape[1]
    total = np.zeros((powers, s * (s + 1)))  # real and imaginary parts of each pair
    product = np.empty(s * (s + 1))
    for i in range(lines.size):
        total[:] = 0.0
        scale = 2.0 / (right[i, windows - 1] - left[i, windows - 1])
        first, last = left[i, 0], left[i, 0] - 1
        for c in range(windows):
            for j in range(left[i, c], first):
                _add(z[j], (j - lines[i]) * scale, product, total)
            for j in range(last + 1, right[i, c] + 1):
                _add(z[j], (j - lines[i]) * scale, product, total)
            first, last = left[i, c], right[i, c]
            for p in range(powers):
                k = 0
                for a in range(s):
                    for b in range(a, s):
                        out[i, c, p, a, b] = complex(total[p, k], total[p, k + 1])
                        k += 2


@compiled_in_line
def _add(z: ComplexArray, t: float, product: Array, total: Array) -> None:
    k = 0
    for a in range(z.size):
        for b in range(a, z.size):
            product[k] = z[a].real * z[b].real + z[a].imag * z[b].imag
            product[k + 1] = z[a].real * z[b].imag - z[a].imag * z[b].real
            k += 2
    power = 1.0
    for p in range(total.shape[0]):
        for k in range(product.size):
            total[p, k] += product[k] * power
        power *= t


@compiled
def influence(z: ComplexArray, windows: Windows, fits: Solved, total: ComplexArray, effective: Array) -> None:
    """Sums of what each line's residual moves a response by, for one window at each of n lines.

    z (nf, 2 + m) are an instrument, 1 and answers. Into `total` (n, m, m) go squares, each residual over the root of
    one less its leverage (HC2: MacKinnon and White 1985), into `effective` (n,) how many residuals that is.
    """
    lines, left, right, order = windows
    inverse, theta, denominator, bends, pull = fits
    rows, q, m = theta.shape
    b, a = np.empty(q, dtype=np.complex128), np.empty(q, dtype=np.complex128)
    moved = np.empty(m, dtype=np.complex128)
    change = np.empty(denominator.shape[1], dtype=np.complex128)
    for i in range(rows):
        width = right[i] - left[i] + 1
        second, fourth = 0.0, 0.0
        for j in range(left[i], right[i] + 1):
            t = (j - lines[i]) * 2.0 / (width - 1)
            _columns(z[j, 0], t, order + 1, b)
            root = 1.0 / np.sqrt(max(1.0 - _leverage(inverse[i], b, width, a), 1e-3))
            _moved(z[j], t, root, b, a, (theta[i], denominator[i], bends[i], pull[i]), change, moved)
            for x in range(m):
                for y in range(m):
                    total[i, x, y] += moved[x] * np.conj(moved[y])
            weight = a[0].real ** 2 + a[0].imag ** 2
            second += weight
            fourth += weight * weight
        effective[i] = second * second / fourth


@compiled
def shifted(
    z: ComplexArray, windows: Windows, fits: Solved, gates: Array, moves: ComplexArray, columns: ComplexArray
) -> None:
    """What residuals would move each response by, had the sweep passed earlier or later; arguments as for `influence`.

    Turned by `gates` (g,) cycles over the window, a response's weights are those of another time: into `moves`
    (n, g, m) go their sums with the residuals, into `columns` (n, g, q) those with the fitted columns, which are what
    a fit takes away of noise at that time.
    """
    lines, left, right, order = windows
    inverse, theta, denominator, bends, pull = fits
    rows, q, m = theta.shape
    b, a = np.empty(q, dtype=np.complex128), np.empty(q, dtype=np.complex128)
    moved = np.empty(m, dtype=np.complex128)
    change = np.empty(denominator.shape[1], dtype=np.complex128)
    turns, cycles = np.empty(gates.size, dtype=np.complex128), np.empty(gates.size, dtype=np.complex128)
    for i in range(rows):
        width = right[i] - left[i] + 1
        turns[:] = np.exp(2j * np.pi * gates / width)
        cycles[:] = 1.0
        for j in range(left[i], right[i] + 1):
            t = (j - lines[i]) * 2.0 / (width - 1)
            _columns(z[j, 0], t, order + 1, b)
            _weight(inverse[i], b, a)
            _moved(z[j], t, 1.0, b, a, (theta[i], denominator[i], bends[i], pull[i]), change, moved)
            for g in range(gates.size):
                for x in range(m):
                    moves[i, g, x] += moved[x] * cycles[g]
                weight = a[0] * cycles[g]
                for k in range(q):
                    columns[i, g, k] += weight * b[k]
                cycles[g] *= turns[g]


@compiled_in_line
def _columns(instrument: complex, t: float, terms: int, b: ComplexArray) -> None:
    """What a line's equations multiply: powers of t times the instrument, then powers of t, into b (2 terms,)."""
    power = 1.0
    for s in range(terms):
        b[s], b[terms + s] = instrument * power, power
        power *= t


@compiled_in_line
def _weight(inverse: ComplexArray, b: ComplexArray, a: ComplexArray) -> None:
    """What N(0) answers to a line's residual, into a[0]."""
    a[0] = 0.0
    for n in range(b.size):
        a[0] += inverse[0, n] * np.conj(b[n])


@compiled_in_line
def _leverage(inverse: ComplexArray, b: ComplexArray, width: int, a: ComplexArray) -> float:
    """A line's leverage, and into a (q,) what coefficients answer to its residual: all in narrow windows, else N(0)."""
    q = b.size
    leverage = 0.0
    for k in range(q if width <= NARROW else 1):
        a[k] = 0.0
        for n in range(q):
            a[k] += inverse[k, n] * np.conj(b[n])
        leverage += (b[k] * a[k]).real
    return leverage if width <= NARROW else q / width


@compiled_in_line
def _moved(
    z: ComplexArray, t: float, root: float, b: ComplexArray, a: ComplexArray, fit: tuple[ComplexArray, ...],
    change: ComplexArray, moved: ComplexArray,
) -> None:  # fmt: skip
    """What a line's residuals times `root` move each response by, into moved (m,): directly and by the denominator.

    `fit` is what was fitted in the line's window, without the inverse.
    """
    theta, denominator, bends, pull = fit
    q, poles = b.size, denominator.size - 1
    change[:] = 0.0
    for x in range(moved.size):
        value, power = z[2 + x] * denominator[0], 1.0
        for p in range(poles):
            power *= t
            value += z[2 + x] * denominator[p + 1] * power
        for k in range(q):
            value -= b[k] * theta[k, x]
        residual, power = value * root, 1.0
        moved[x] = a[0] * residual
        for p in range(poles):
            power *= t
            across = z[2 + x] * power
            for k in range(q):
                across -= b[k] * bends[p, k, x]
            for n in range(poles):
                change[n] += pull[n, p, x] * np.conj(across) * residual
    for x in range(moved.size):
        for p in range(poles):
            moved[x] += bends[p, 0, x] * change[p]
