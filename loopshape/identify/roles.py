"""What signals of unknown parts say of each other: sums, who answers whom, who moves by itself.

Columns are (n, m) of one recording. A signal that others' past helps to predict answers them (Granger, Econometrica 37,
1969, with a regression on a few lags); one whose prediction they do not help moves by itself. Misleads for signals that
their own past predicts to the last digit (sines, staircases): of those nothing is reported.
"""

from __future__ import annotations

from itertools import permutations

import numpy as np

from loopshape.core.units import Array

_LAGS = 8
_ROWS = 20_000  # rows looked at
_EXACT = 1e-4  # of a signal's rms, up to which a sum is one
_PREDICTED = 1e-9  # share of a signal that its own past leaves: below it nothing is said of it
_REPEATED = 0.1  # of a signal's rms, by which two of its periods may differ
_LEAST = 0.005  # share of what its own past leaves open, from which on others' past may explain a signal


def constants(x: Array) -> np.ndarray:
    """Mask (m,) of the columns that do not move."""
    return np.asarray(np.ptp(x, axis=0) <= 1e-12 * np.maximum(np.abs(x).max(axis=0), 1e-300))


def differences(x: Array) -> list[tuple[int, int, int]]:
    """Triples (a, b, c) of columns with a = b - c, to a ten-thousandth of a's rms, neither of them constant."""
    moving = np.flatnonzero(~constants(x))
    found = []
    for a, b, c in permutations(moving.tolist(), 3):
        left = x[:, a] - (x[:, b] - x[:, c])
        if np.sqrt(np.mean(left**2)) <= _EXACT * np.std(x[:, a]):
            found.append((int(a), int(b), int(c)))
    return found


def answers(x: Array) -> Array:
    """How much each column answers the others, (m,): the share of what its own past leaves open that theirs explains.

    nan where its own past leaves nothing open, or where the record is too short to tell.
    """
    x = _scaled(x)
    n, m = x.shape
    out = np.full(m, np.nan)
    if n < 4 * _LAGS * m + 50:
        return out
    past = np.concatenate([x[_LAGS - k : n - k] for k in range(1, _LAGS + 1)], axis=1)
    for j in range(m):
        own = _left(past[:, j::m], x[_LAGS:, j])
        if np.mean(own**2) <= _PREDICTED:
            continue
        every = _left(past, x[_LAGS:, j])
        out[j] = 1.0 - np.sum(every**2) / np.sum(own**2) * (n - _LAGS) / (n - _LAGS - _LAGS * (m - 1))
    return out


def beyond_chance(rows: int, columns: int) -> float:
    """The share in `answers` from which on it is an answer: eight standard deviations of what chance leaves."""
    return float(max(_LEAST, 8.0 * np.sqrt(2.0 * _LAGS * max(columns - 1, 1)) / min(rows, _ROWS)))


def at_once(x: Array, source: int, answer: int) -> float:
    """Correlation of what is new in two columns at the same row, beyond what all columns' past tells."""
    x = _scaled(x)
    n, m = x.shape
    if n < 4 * _LAGS * m + 50:
        return float("nan")
    past = np.concatenate([x[_LAGS - k : n - k] for k in range(1, _LAGS + 1)], axis=1)
    a, b = (_left(past, x[_LAGS:, j]) for j in (source, answer))
    if min(np.mean(a**2), np.mean(b**2)) <= _PREDICTED:
        return float("nan")
    return float(a @ b / np.sqrt((a @ a) * (b @ b)))


def rows_of_a_period(x: Array) -> tuple[int, int]:
    """Rows after which a signal (n,) repeats itself, and from which row on; (0, 0) for one that does not."""
    n = x.size
    late = x[n // 3 :] - x[n // 3 :].mean()
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
    if noise > _REPEATED * late.std():
        return 0, 0
    begins = _last_crowd(apart > max(1e-3 * late.std(), 6.0 * noise), max(8, period // 20))
    still = begins + 2 * period > n or x[begins:].std() < 0.3 * late.std()  # what rests repeats too
    return (0, 0) if still else (period, begins)


def _last_crowd(marked: np.ndarray, width: int) -> int:
    """The row behind the last stretch of `width` rows of which over a quarter are marked; 0 without one."""
    count = np.concatenate([[0], np.cumsum(marked)])
    crowds = np.flatnonzero(count[width:] - count[:-width] > width // 4)
    return int(crowds[-1] + np.flatnonzero(marked[crowds[-1] : crowds[-1] + width])[-1]) + 1 if crowds.size else 0


def rises(x: Array) -> bool:
    """Whether the frequency of a signal (n,) rises or falls steadily, as a sweep's does, by a factor of three."""
    moved = np.flatnonzero(np.abs(np.diff(x)) > 1e-6 * max(float(np.ptp(x)), 1e-300))
    if moved.size < 100:
        return False
    inner = x[moved[0] : moved[-1] + 1]
    inner = inner - 0.5 * (inner.max() + inner.min())
    crossed = np.array([np.count_nonzero(np.diff(np.signbit(part))) for part in np.array_split(inner, 6)])
    steps = np.diff(crossed[1:] if crossed[0] < 3 else crossed)
    return bool((np.all(steps > 0) or np.all(steps < 0)) and crossed.max() >= 3 * max(1, crossed.min()))


def _scaled(x: Array) -> Array:
    """The middle rows, at most `_ROWS`, without mean, each with an rms of 1."""
    n = x.shape[0]
    start = max(0, (n - _ROWS) // 2)
    x = x[start : start + _ROWS] - x[start : start + _ROWS].mean(axis=0)
    return np.asarray(x / np.maximum(np.sqrt(np.mean(x**2, axis=0)), 1e-300))


def _left(columns: Array, y: Array) -> Array:
    return np.asarray(y - columns @ np.linalg.lstsq(columns, y, rcond=None)[0])
