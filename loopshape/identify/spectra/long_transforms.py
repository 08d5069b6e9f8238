"""Transforms of long records by parts that are interleaved in time (Cooley and Tukey, Math. Comp. 19, 1965).

A whole transform needs several times the record's memory: its own plan, its copy, its lines. Every R-th sample from the
r-th on is transformed for itself, and X(k) = sum_r exp(-2 pi j r k / n) X_r(k mod n / R) is summed over the lines that
are wanted: beside these and the record only a part is held.
"""

from __future__ import annotations

import numpy as np

from loopshape.core.units import TWO_PI, Array, ComplexArray

#: samples of a part: that many, or where this is more a share of the record, as each part passes over all lines
PART, SHARE = 1 << 20, 8


def low_lines(x: Array, last: int) -> ComplexArray:
    """Lines 0 to `last` (last + 1,), at most n // 2, of the transform of a signal (n,), as `numpy.fft.rfft` has them.

    n has a divisor near what is wanted if it is a fast length; of others the parts may be small and many.
    """
    n = x.size
    parts = _parts(n)
    size = n // parts
    lines = np.zeros(last + 1, dtype=complex)
    for r in range(parts):
        own = np.fft.rfft(x[r::parts])
        for start in range(0, last + 1, size):
            stop = min(start + size, last + 1)
            lines[start:stop] += _of_real(own, size, 0, stop - start) * _turns(n, r, start, stop)
    return lines


def quadrature(x: Array) -> Array:
    """The signal (n,) a quarter of a cycle later at each frequency (Hilbert's transform), without mean."""
    n = x.size
    parts = _parts(n)
    size = n // parts
    lines = low_lines(x, n // 2)
    lines *= -1j
    lines[0] = 0.0
    lines[(n + 1) // 2 :] = 0.0  # Nyquist's
    y = np.empty(n)
    for r in range(parts):
        own = np.zeros(size // 2 + 1, dtype=complex)
        for start in range(0, n, size):
            stop = start + own.size
            own += _of_real(lines, n, start, stop) * _turns(n, r, start, stop).conj()
        y[r::parts] = np.fft.irfft(own, size) / parts
    return y


def _parts(n: int) -> int:
    """Fewest parts of one size that is not above what is wanted."""
    fewest = -(-n // max(PART, -(-n // SHARE)))
    return next(parts for parts in range(fewest, n + 1) if n % parts == 0)


def _of_real(half: ComplexArray, n: int, start: int, stop: int) -> ComplexArray:
    """Lines start to stop (exclusive), up to n, of a real signal of n samples, of which `half` holds 0 to n // 2."""
    if stop <= half.size:
        return half[start:stop]
    above = half[n - stop + 1 : n - max(start, half.size) + 1]
    return np.concatenate([half[start:], above[::-1].conj()])


def _turns(n: int, r: int, start: int, stop: int) -> ComplexArray:
    """exp(-2 pi j r k / n) for k from start to stop (exclusive), from two tables whose angles are exact."""
    fine = int(np.sqrt(stop - start)) + 1
    coarse = start + fine * np.arange(-(-(stop - start) // fine))
    first, second = (np.exp(-1j * TWO_PI / n * (r * k % n)) for k in (coarse, np.arange(fine)))
    return np.asarray(np.outer(first, second).ravel()[: stop - start])
