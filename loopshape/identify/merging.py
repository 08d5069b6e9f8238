"""FRF of very many frequencies -> the same FRF on fewer: neighbours that differ by noise alone are averaged.

A period of minutes gives a million frequencies, most of which say the same as their neighbours. Neighbours are merged
by twos, then by fours and so on, wherever a polynomial of second degree over the 16 about them leaves nothing but
noise: by the measure by which a smoothing accepts a window. Where the plant bends faster, at a resonance, and where
one frequency alone stands out, every frequency stays.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np

from loopshape.core.kernels.smoothing import excesses
from loopshape.core.units import Array
from loopshape.data.frf import FRF
from loopshape.identify.pooling import pooled_variance
from loopshape.identify.smoothing import STRICTNESS, TESTED, correlation

#: an FRF of no more frequencies stays as it is
MANY = 20_000
#: frequencies of a window, and the widest group of merged ones in ln f
WINDOW, WIDEST = 16, 0.005
#: values are taken to err by this share of |P| at least: what a polynomial may round off
FLOOR = 1e-4

_DONE: WeakKeyDictionary[FRF, FRF] = WeakKeyDictionary()


def merged(frf: FRF) -> FRF:
    """A 1 x 1 FRF with more than 20,000 frequencies on fewer, a smaller one as it is; same FRF, same answer.

    A group's value is the mean of its frequencies' values, weighted by their variances, at the mean of their
    frequencies: off by 1e-4 of |P| or a small share of its own deviation at most. Its variance counts
    neighbours that are correlated (`line_overlap`); groups are taken to be correlated as frequencies are, which makes
    intervals too long where that is much. A group spans 0.5 % in frequency at most.

    Misleads where the stated variance is larger than the true one: then a narrow resonance can pass as noise. Where it
    is too small everywhere, what windows leave over in the median is taken for the noise.
    """
    if frf.frequency_hz.size <= MANY:
        return frf
    if frf not in _DONE:
        v = pooled_variance(frf)
        _DONE[frf] = _grouped(frf, _starts(frf, v), v)
    return _DONE[frf]


def _starts(frf: FRF, v: Array) -> np.ndarray:
    """First frequency of each group."""
    f, weight = frf.frequency_hz, _weights(frf, v)
    starts, noise = np.arange(f.size), 0.0
    size = 1
    while True:
        means = [_mean(x, weight, starts) for x in (f, frf.siso)]
        std = np.sqrt(_variance(v, weight, starts, frf.line_overlap))
        tested = std**2 + (FLOOR * np.abs(means[1])) ** 2 + 1e-300
        excess = excesses(np.log(means[0]), means[1], tested, WINDOW, TESTED, frf.line_overlap)
        noise = max(float(np.median(excess)), 1.0) if size == 1 else noise
        smooth = _smooth(excess / noise, starts.size, frf.line_overlap)
        second = _seconds(frf, starts, smooth, size)
        if not second.any():
            return starts
        starts, size = starts[~second], 2 * size


def _weights(frf: FRF, v: Array) -> Array:
    """Weights (nf,) by the variance; equal ones where nothing errs."""
    return 1.0 / np.maximum(v, 1e-20 * np.abs(frf.siso) ** 2 + 1e-300)


def _smooth(excess: Array, groups: int, overlap: float) -> np.ndarray:
    """Whether all windows about each group (groups,) leave no more than noise."""
    left = WINDOW - TESTED - 1
    common = 0.5 * (min(overlap, 1.94) - 1.0)
    good = excess <= 1.0 + STRICTNESS * np.sqrt((1.0 + 2.0 * common**2) / left)
    smooth = np.ones(groups, dtype=bool)
    for k in np.flatnonzero(~good):
        low = min(int(k) * (WINDOW // 2), groups - WINDOW)
        smooth[low : low + WINDOW] = False
    return smooth


def _seconds(frf: FRF, starts: np.ndarray, smooth: np.ndarray, size: int) -> np.ndarray:
    """Groups that join the one before: both of `size` frequencies, smooth, of one trust, and narrow together."""
    f, ends = frf.frequency_hz, np.append(starts[1:], frf.frequency_hz.size)
    whole = (ends - starts == size) & smooth
    second = np.zeros(starts.size, dtype=bool)
    second[1:] = whole[1:] & whole[:-1] & (starts[:-1] % (2 * size) == 0)
    second[1:] &= frf.trusted[starts[1:]] == frf.trusted[starts[:-1]]
    second[1:] &= np.log(f[ends[1:] - 1] / f[starts[:-1]]) < WIDEST
    return second


def _mean(values: np.ndarray, weight: Array, starts: np.ndarray, power: int = 1) -> np.ndarray:
    """Weighted means (groups, ...) of values (nf, ...); of a variance with `power` 2, as if independent."""
    along = weight.reshape(-1, *[1] * (values.ndim - 1))
    total = np.add.reduceat(weight, starts).reshape(-1, *[1] * (values.ndim - 1))
    return np.asarray(np.add.reduceat(along**power * values, starts) / total**power)


def _variance(v: Array, weight: Array, starts: np.ndarray, overlap: float) -> Array:
    """Variance (groups,) of each group's mean."""
    return np.asarray(_mean(v, weight, starts, 2).real * _shared(starts, v.size, overlap))


def _shared(starts: np.ndarray, lines: int, overlap: float) -> Array:
    """How much correlated neighbours raise the variance of each group's mean (groups,); 1 for independent ones."""
    sizes = np.diff(starts, append=lines)
    rho, k = correlation(overlap), np.arange(1, correlation(overlap).size)
    share = np.maximum(1.0 - k / sizes[:, None], 0.0) if k.size else np.zeros((sizes.size, 0))
    return np.asarray(1.0 + 2.0 * share @ rho[1:])


def _grouped(frf: FRF, starts: np.ndarray, v: Array) -> FRF:
    """The FRF on groups of frequencies."""
    weight = _weights(frf, v)
    made: dict[str, Any] = {"trusted": frf.trusted[starts], "frequency_hz": _mean(frf.frequency_hz, weight, starts)}
    for name in ("covariance", "noise_covariance"):
        if (values := getattr(frf, name)) is not None:
            shared = _shared(starts, frf.frequency_hz.size, frf.line_overlap)
            made[name] = _mean(values, weight, starts, 2) * shared[:, None, None]
    for name in _AVERAGED:
        if (values := getattr(frf, name)) is not None:
            made[name] = _mean(values, weight, starts)
    return replace(frf, **made)


_AVERAGED = (
    "response",
    "coherence",
    "input_power",
    "output_power",
    "cross_power",
    "multiple_coherence",
    "partial_coherence",
)
