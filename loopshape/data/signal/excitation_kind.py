"""Which signal is a sweep, by its zero crossings, and which repeats itself."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from loopshape.core.stretches import AT_ONCE, Signal, extent
from loopshape.core.units import Array

#: shares of the largest value nearby and anywhere that a signal must reach to have crossed zero
NEARBY, ANYWHERE = 0.1, 0.02
#: zero crossings that a sweep has at least, and over how many of them, or more of thousands, its frequency is taken
CROSSINGS, SPAN = 40, 8
#: spread of a sweep's ln f between its quartiles, absolute and over the whole range
SPREAD = 0.1
#: mean |x| squared over mean square, cycle by cycle: 8 / pi^2 of a sine, 1 of a square wave, 2 / pi of Gaussian noise
SINE = (0.77, 0.85)
#: share of a signal's rms by which its periods may differ: of one that was measured, and of one that is known
REPEATED, KNOWN_REPEATED = 0.1, 0.03


def zero_crossings(x: Signal) -> Array:
    """Where a signal (n,) crosses its mean, in samples; it must move clearly to the other side, so noise is none."""
    whole = extent(x)
    mean, least = whole.mean, ANYWHERE * max(whole.most - whole.mean, whole.mean - whole.least)
    found, last = [], (0, 0.0)  # row and value of the last sample that lies clearly on a side
    for start, part in _parts(x, mean):
        size = np.abs(part)
        blocks = np.arange(0, part.size, max(part.size // 20, 3))
        near = np.repeat(np.maximum.reduceat(size, blocks), np.diff([*blocks, part.size]))
        rows = np.flatnonzero(size > np.maximum(NEARBY * near, least))
        k, values = np.concatenate([[last[0]], rows + start]), np.concatenate([[last[1]], part[rows]])
        flips = np.flatnonzero(values[1:] * values[:-1] < 0.0)
        a, b = values[flips], values[flips + 1]
        found.append(k[flips] + (k[flips + 1] - k[flips]) * a / (a - b))
        last = int(k[-1]), float(values[-1])
    return np.concatenate(found)


def is_sweep(x: Signal) -> bool:
    """Whether a signal (n,) is a sine whose frequency only rises, only falls, or does one after the other.

    By its zero crossings, 20 cycles at least: the frequency moves monotonically, all along and not at one end alone,
    and each stretch of four cycles has the mean size of a sine. A single period of a multisine with Schroeder's phases
    is a sweep in this sense; several periods, noise, PRBS and steps are none. An amplitude that falls to a tenth or
    less while the sweep passes may hide it.
    """
    at = zero_crossings(x)
    if at.size < CROSSINGS:
        return False
    span = max(SPAN, at.size // 200)
    log_f = -np.log(at[span:] - at[:-span])
    low, high = np.quantile(log_f, [0.25, 0.75])
    if high - low < max(SPREAD, SPREAD * float(np.ptp(log_f))):
        return False
    # share of the variance of a sweep's ln f that a frequency which only rises, then only falls explains
    monotone = 0.997
    if max(_monotone(log_f), _monotone(-log_f)) < monotone:
        return False
    return bool(SINE[0] < _form(x, at) < SINE[1])


def _monotone(y: Array) -> float:
    """Share of the variance of y (n,) that a curve which rises up to its largest value, and falls on, explains."""
    top = int(np.argmax(y))
    left = float(sum(np.sum(_unsteady(part) ** 2) for part in (y[: top + 1], y[top:][::-1])))
    return 1.0 - left / (y.size * float(np.var(y)))


def _unsteady(y: Array) -> Array:
    """What a rising curve, the mean of the largest so far and of the least from there on, leaves of y (n,)."""
    return np.asarray(y - 0.5 * (np.maximum.accumulate(y) + np.minimum.accumulate(y[::-1])[::-1]))


def _form(x: Signal, at: Array) -> float:
    """Mean of |x| squared over mean square, each over `SPAN` zero crossings `at`, weighted by power."""
    cells = at.size // SPAN
    sums = np.zeros((3, cells + 1))
    for start, part in _parts(x, extent(x).mean):
        cell = np.searchsorted(at, np.arange(start, start + part.size)) // SPAN
        for row, weights in zip(sums, (np.ones(part.size), np.abs(part), part**2), strict=True):
            row += np.bincount(cell, weights, minlength=cells + 1)[: cells + 1]
    count, size, power = sums[:, 1:cells]  # cells at the ends hold what lies outside the crossings
    return float(np.sum(size**2 / np.maximum(count, 1.0)) / np.sum(power))


def _parts(x: Signal, mean: float) -> Iterator[tuple[int, Array]]:
    """First row and values of stretches of x (n,) less its mean."""
    for start in range(0, x.size, AT_ONCE):
        yield start, np.asarray(x[start : start + AT_ONCE] - mean)


def rows_of_a_period(x: Array, differ: float = REPEATED) -> tuple[int, int]:
    """Rows after which a signal (n,) repeats itself, and from which row on; (0, 0) for one that does not.

    Its periods may `differ` by a share of its rms.
    """
    found = _repeating(x, x.size // 3, differ)
    return found if found[0] else _repeating(x, 0, differ)


def _repeating(x: Array, start: int, differ: float) -> tuple[int, int]:
    """A period and where it begins, looked for from a row: at least half of the rows repeat, not a few at the end."""
    n = x.size
    late = x[start:] - x[start:].mean()
    if late.size < 8 or not late.any():
        return 0, 0
    power = np.fft.irfft(np.abs(np.fft.rfft(late, 2 * late.size)) ** 2, 2 * late.size)[: late.size]
    lags = np.arange(late.size // 2 + 1)
    alike = power[: lags.size] / power[0] * late.size / (late.size - lags)
    fallen = np.flatnonzero(alike < 0.5)
    if not fallen.size:
        return 0, 0
    rest = alike[fallen[0] :]
    first = int(np.argmax(rest >= rest.max() - 0.02))  # multiples of a period are as good
    period = int(fallen[0] + first + np.argmax(rest[first : first + max(3, (fallen[0] + first) // 20)]))
    apart = np.abs(x[period:] - x[:-period])
    noise = 1.5 * float(np.median(apart[-period:]))  # a median: single rows may be wrong
    if noise > differ * late.std():
        return 0, 0
    begins = _last_dense(apart > max(1e-3 * late.std(), 6.0 * noise), max(8, period // 20))
    if begins > n // 2 or begins + 2 * period > n or x[begins:].std() < 0.3 * late.std():  # what rests repeats too
        return 0, 0
    whole = x[begins : begins + (n - begins) // period * period].reshape(-1, period)
    scatter = np.mean((whole - whole.mean(axis=0)) ** 2)  # it drifts with a period of no whole number of rows
    return (0, 0) if scatter > differ**2 * whole.mean(axis=0).var() else (period, begins)


def _last_dense(marked: np.ndarray, width: int) -> int:
    """The row behind the last stretch of `width` rows of which over a quarter are marked; 0 without one."""
    count = np.concatenate([[0], np.cumsum(marked)])
    dense = np.flatnonzero(count[width:] - count[:-width] > width // 4)
    return int(dense[-1] + np.flatnonzero(marked[dense[-1] : dense[-1] + width])[-1]) + 1 if dense.size else 0
