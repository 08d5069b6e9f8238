"""What signals of unknown parts say of each other: sums, direction of causality, what moves by itself.

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
_PREDICTED = 1e-9  # share of a signal that its own past leaves: below it nothing is said of it
_COPIED = 1e-5  # of a signal's rms, up to which a column is a copy of another


def constants(x: Array) -> np.ndarray:
    """Mask (m,) of the columns that do not move."""
    return np.asarray(np.ptp(x, axis=0) <= 1e-12 * np.maximum(np.abs(x).max(axis=0), 1e-300))


def copies(x: Array) -> list[tuple[int, int, float]]:
    """Pairs (a, b, factor) of columns, a < b, with b = factor a + constant to `_COPIED` of b's rms, each b once.

    The factor is 1 exactly where b equals a, to that.
    """
    moved = np.flatnonzero(~constants(x)).tolist()
    scaled = _scaled(x, len(x))
    found: list[tuple[int, int, float]] = []
    for k, b in enumerate(moved):
        for a in moved[:k]:
            share = float(scaled[:, a] @ scaled[:, b] / len(scaled))
            left = scaled[:, b] - share * scaled[:, a]
            if a not in {pair[1] for pair in found} and np.sqrt(np.mean(left**2)) <= _COPIED:
                equal = np.abs(x[:, a] - x[:, b]).max() <= _COPIED * float(np.ptp(x[:, b]))
                found.append((a, b, 1.0 if equal else share * float(np.std(x[:, b]) / np.std(x[:, a]))))
                break
    return found


def drives(x: Array, first: int, second: int) -> int:
    """1 where the second of two columns answers the first, -1 where the first answers the second, 0 where none is told.

    Told is a direction in which the past explains far more of what is new than in the other, at this rate or at means
    of 4 or 16 rows (slow plants answer late). In a closed loop both answer each other, and nothing is told.
    """
    pair = x[:, [first, second]]
    means = (1, 4, 16)  # rows averaged
    one_way = 0.2  # of what one column explains of another, up to which the other way counts as none
    for rows in means:
        part = pair[: len(pair) // rows * rows].reshape(-1, rows, 2).mean(axis=1)
        back, on = answers(part)
        if np.isnan(back) or np.isnan(on) or max(back, on) < beyond_chance(*part.shape):
            continue
        if min(back, on) < one_way * max(back, on):
            return 1 if on > back else -1
    return 0


def adds(x: Array, source: int, control: int, output: int) -> float:
    """What the past of `source` explains of what the pasts of output and control leave open of the output.

    Nothing where the control is all that enters the plant; nan as for `answers`.
    """
    return float(answers(x[:, [output, control, source]], apart=2)[0])


def differences(x: Array) -> list[tuple[int, int, int]]:
    """Triples (a, b, c) of columns with a = b - c, to a ten-thousandth of a's rms, neither of them constant."""
    moving = np.flatnonzero(~constants(x))
    found = []
    exact = 1e-4  # of a signal's rms, up to which a sum is one
    for a, b, c in permutations(moving.tolist(), 3):
        left = x[:, a] - (x[:, b] - x[:, c])
        if np.sqrt(np.mean(left**2)) <= exact * np.std(x[:, a]):
            found.append((int(a), int(b), int(c)))
    return found


def answers(x: Array, apart: int = 1) -> Array:
    """How much each column answers the others, (m,): the share of what its own past leaves open that theirs explains.

    With `apart` 2 the first column alone is asked, and what its own past and that of the second leave open. nan where
    that is nothing, or where the record is too short to tell.
    """
    x = _scaled(x)
    n, m = x.shape
    out = np.full(m, np.nan)
    if n < 4 * _LAGS * m + 50:
        return out
    past = np.concatenate([x[_LAGS - k : n - k] for k in range(1, _LAGS + 1)], axis=1)
    for j in range(m if apart == 1 else 1):
        mine = [k for k in range(past.shape[1]) if j <= k % m < j + apart]
        own = _left(past[:, mine], x[_LAGS:, j])
        if not np.mean(own**2) > _PREDICTED:
            continue
        every = _left(past, x[_LAGS:, j])
        out[j] = 1.0 - np.sum(every**2) / np.sum(own**2) * (n - _LAGS) / (n - _LAGS - _LAGS * (m - apart))
    return out


def beyond_chance(rows: int, columns: int) -> float:
    """The share in `answers` from which on it is an answer: eight standard deviations of what chance leaves."""
    least = 0.005  # share of what its own past leaves open, from which on others' past may explain a signal
    return float(max(least, 8.0 * np.sqrt(2.0 * _LAGS * max(columns - 1, 1)) / min(rows, _ROWS)))


def at_once(x: Array, source: int, answer: int) -> float:
    """Correlation of what is new in two columns at the same row, beyond what all columns' past tells."""
    x = _scaled(x)
    n, m = x.shape
    if n < 4 * _LAGS * m + 50:
        return float("nan")
    past = np.concatenate([x[_LAGS - k : n - k] for k in range(1, _LAGS + 1)], axis=1)
    a, b = (_left(past, x[_LAGS:, j]) for j in (source, answer))
    if not min(np.mean(a**2), np.mean(b**2)) > _PREDICTED:
        return float("nan")
    return float(a @ b / np.sqrt((a @ a) * (b @ b)))


def _scaled(x: Array, rows: int = _ROWS) -> Array:
    """The middle rows, at most so many, without mean, each with an rms of 1; what is not finite counts as 0."""
    start = max(0, (x.shape[0] - rows) // 2)
    x = np.nan_to_num(x[start : start + rows], posinf=0.0, neginf=0.0)
    x = x / np.maximum(np.abs(x).max(axis=0), 1e-300)  # before squares: 1e300 of a damaged file has none
    x = x - x.mean(axis=0)
    return np.asarray(x / np.maximum(np.sqrt(np.mean(x**2, axis=0)), 1e-300))


def _left(columns: Array, y: Array) -> Array:
    """What least squares leave of y; nan where they do not converge."""
    try:
        return np.asarray(y - columns @ np.linalg.lstsq(columns, y, rcond=None)[0])
    except np.linalg.LinAlgError:
        return np.full(y.shape, np.nan)
