"""Sums over windows of neighbouring lines, from which local least squares follow without a matrix for each line.

With signals z = (R, 1, X_1 .. X_m) of an instrument R and answers X, a local model's normal equations hold nothing but
the moments M_s[a, b] = sum_j conj(z_a(j)) z_b(j) t_j^s over its window, t_j the distance from the line in question.
Windows about one line lie within each other, so that each line of the record is added once for all of them.
"""

from __future__ import annotations

import numpy as np

from loopshape.kernels.compiled import compiled, compiled_in_line
from loopshape.kernels.types import Array, ComplexArray

#: from so many lines on a window's leverages are small, and their mean is taken for each
NARROW = 100


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
def influence(
    z: ComplexArray,
    lines: Array,
    left: Array,
    right: Array,
    order: int,
    inverse: ComplexArray,
    theta: ComplexArray,
    denominator: ComplexArray,
    bends: ComplexArray,
    pull: ComplexArray,
    gates: Array,
    total: ComplexArray,
    gated: ComplexArray,
    effective: Array,
) -> None:
    """Sums of what each line's residual moves a response by, for one window at each of `lines` (n,), as `Fits` has it.

    z (nf, 2 + m) are an instrument, 1 and answers. Into `total` (n, m, m) go squares, each residual over the root of
    one less its leverage (HC2: MacKinnon and White 1985); into `gated` (n, gates, m) sums turned by `gates` cycles over
    the window, which is the same window some time earlier or later; into `effective` (n,) how many residuals that is.
    """
    rows, q, m = theta.shape
    poles, terms = denominator.shape[1] - 1, order + 1
    b, a = np.empty(q, dtype=np.complex128), np.empty(q, dtype=np.complex128)
    residual, moved = np.empty(m, dtype=np.complex128), np.empty(m, dtype=np.complex128)
    change = np.empty(max(poles, 1), dtype=np.complex128)
    turns, cycles = np.empty(gates.size, dtype=np.complex128), np.empty(gates.size, dtype=np.complex128)
    for i in range(rows):
        scale = 2.0 / (right[i] - left[i])
        turns[:] = np.exp(2j * np.pi * gates / (right[i] - left[i] + 1))
        cycles[:] = 1.0
        second, fourth = 0.0, 0.0
        for j in range(left[i], right[i] + 1):
            t = (j - lines[i]) * scale
            power = 1.0
            for s in range(terms):
                b[s], b[terms + s] = z[j, 0] * power, power
                power *= t
            leverage = 0.0
            for k in range(q if right[i] - left[i] < NARROW else 1):
                a[k] = 0.0
                for n in range(q):
                    a[k] += inverse[i, k, n] * np.conj(b[n])
                leverage += (b[k] * a[k]).real
            if right[i] - left[i] >= NARROW:
                leverage = q / (right[i] - left[i] + 1.0)
            root = 1.0 / np.sqrt(max(1.0 - leverage, 1e-3))
            change[:] = 0.0
            for x in range(m):
                value, power = 0.0j, 1.0
                for p in range(poles + 1):
                    value += denominator[i, p] * power
                    power *= t
                value *= z[j, 2 + x]
                for k in range(q):
                    value -= b[k] * theta[i, k, x]
                residual[x] = value * root
                power = 1.0
                for p in range(poles):
                    power *= t
                    across = z[j, 2 + x] * power
                    for k in range(q):
                        across -= b[k] * bends[i, p, k, x]
                    for n in range(poles):
                        change[n] += pull[i, n, p, x] * np.conj(across) * residual[x]
            for x in range(m):
                moved[x] = a[0] * residual[x]
                for p in range(poles):
                    moved[x] += bends[i, p, 0, x] * change[p]
            for x in range(m):
                for y in range(m):
                    total[i, x, y] += moved[x] * np.conj(moved[y])
                for g in range(gates.size):
                    gated[i, g, x] += moved[x] * cycles[g]
            for g in range(gates.size):
                cycles[g] *= turns[g]
            weight = a[0].real ** 2 + a[0].imag ** 2
            second += weight
            fourth += weight * weight
        effective[i] = second * second / fourth
