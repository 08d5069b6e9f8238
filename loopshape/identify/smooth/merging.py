"""FRF of very many frequencies -> the same FRF on fewer: neighbours that differ by noise alone are averaged.

A period of minutes gives a million frequencies, most of which say the same as their neighbours. Neighbours are merged
by twos, then by fours and so on, wherever a polynomial of second degree over the 16 about them leaves nothing but
noise. Where the plant bends faster, at a resonance, and where one frequency alone stands out further than chance makes
one of all stand out (5.7 deviations of a million), every frequency stays.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np
from scipy.stats import chi2

from loopshape.core.kernels.smoothing import excesses
from loopshape.core.units import Array
from loopshape.data.response.frf import FRF
from loopshape.identify.smooth.smoothing import correlation
from loopshape.identify.spectra.averages import pooled_variance

#: an FRF of no more frequencies stays as it is
MANY = 20_000
#: groups in a window, the degree that must leave only noise in it, and the widest group in ln f
WINDOW, TESTED, WIDEST = 16, 2, 0.005
#: chance that all windows of noise alone leave one out
FALSE_ALARM = 1e-3
#: values are taken to err by this share of |P| at least: what a polynomial may round off
FLOOR = 1e-4
#: variances of neighbours that are merged differ by this factor at most
ALIKE = 4.0

_DONE: WeakKeyDictionary[FRF, FRF] = WeakKeyDictionary()


def merged(frf: FRF) -> FRF:
    """A 1 x 1 FRF with more than 20,000 frequencies on fewer, a smaller one as it is; same FRF, same answer.

    A group's value is the plain mean of its frequencies' values, at the mean of its frequencies: off by 1e-4 of |P| or
    a small share of its own deviation at most. Weights would prefer values that are small by chance where a variance
    was stated as a share of |P|. A group's variance counts that neighbours are correlated (`line_overlap`); groups are
    taken to be correlated as frequencies are, which makes intervals too long where that is much. A group spans 0.5 % in
    frequency at most, and no frequency joins one whose variance is four times its own.

    Misleads where the stated variance is larger than the true one: then a narrow resonance can pass as noise. Where it
    is too small everywhere, what windows leave over in the median is taken for the noise.
    """
    if frf.frequency_hz.size <= MANY:
        return frf
    if frf not in _DONE:
        v = pooled_variance(frf)
        _DONE[frf] = _grouped(frf, _starts(frf, v))
    return _DONE[frf]


def _starts(frf: FRF, v: Array) -> np.ndarray:
    """First frequency (groups,) of each group."""
    starts, noise, size = np.arange(v.size), 1.0, 1
    while True:
        f, P = _means(frf.frequency_hz, starts), _means(frf.siso, starts)
        variance = _variance(v, starts, frf.line_overlap)
        tested = variance + (FLOOR * np.abs(P)) ** 2 + 1e-300
        excess = excesses(np.log(f), P, tested, WINDOW, TESTED, frf.line_overlap)
        noise = max(float(np.median(excess)), 1.0) if size == 1 else noise
        smooth = _smooth(excess / noise, starts.size, frf.line_overlap)
        second = _seconds(frf, starts, smooth, variance, size)
        if not second.any():
            return starts
        starts, size = starts[~second], 2 * size


def _smooth(excess: Array, groups: int, overlap: float) -> np.ndarray:
    """Whether all windows about each group (groups,) leave no more than noise, by its chance over all windows."""
    common = 0.5 * (min(overlap, 1.94) - 1.0)
    freedom = 2.0 * (WINDOW - TESTED - 1) / (1.0 + 2.0 * common**2)
    good = excess <= chi2.isf(FALSE_ALARM / excess.size, freedom) / freedom
    smooth = np.ones(groups, dtype=bool)
    for k in np.flatnonzero(~good):
        low = min(int(k) * (WINDOW // 2), groups - WINDOW)
        smooth[low : low + WINDOW] = False
    return smooth


def _seconds(frf: FRF, starts: np.ndarray, smooth: np.ndarray, variance: Array, size: int) -> np.ndarray:
    """Groups (groups,) that join the one before: both smooth, of `size` frequencies, as sure, and narrow together."""
    f, ends = frf.frequency_hz, np.append(starts[1:], frf.frequency_hz.size)
    whole = (ends - starts == size) & smooth
    low, high = np.minimum(variance[1:], variance[:-1]), np.maximum(variance[1:], variance[:-1])
    second = np.zeros(starts.size, dtype=bool)
    second[1:] = whole[1:] & whole[:-1] & (starts[:-1] % (2 * size) == 0) & (high <= ALIKE * low)
    second[1:] &= frf.trusted[starts[1:]] == frf.trusted[starts[:-1]]
    second[1:] &= np.log(f[ends[1:] - 1] / f[starts[:-1]]) < WIDEST
    return second


def _means(values: np.ndarray, starts: np.ndarray) -> np.ndarray:
    """Means (groups, ...) of values (nf, ...)."""
    sizes = np.diff(starts, append=len(values)).reshape(-1, *[1] * (values.ndim - 1))
    return np.asarray(np.add.reduceat(values, starts) / sizes)


def _variance(v: np.ndarray, starts: np.ndarray, overlap: float) -> np.ndarray:
    """Variance or covariance (groups, ...) of each group's mean, correlated neighbours counted."""
    sizes, rho = np.diff(starts, append=len(v)), correlation(overlap)
    share = np.maximum(1.0 - np.arange(1, rho.size) / sizes[:, None], 0.0)
    own = (1.0 + 2.0 * share @ rho[1:]) / sizes
    return np.asarray(_means(v, starts) * own.reshape(-1, *[1] * (v.ndim - 1)))


def _grouped(frf: FRF, starts: np.ndarray) -> FRF:
    """The FRF on groups of frequencies."""
    made: dict[str, Any] = {"trusted": frf.trusted[starts]}
    for names, mean in ((_VARIANCES, partial(_variance, overlap=frf.line_overlap)), (_AVERAGED, _means)):
        made |= {n: mean(values, starts) for n in names if (values := getattr(frf, n)) is not None}
    return replace(frf, **made)


_VARIANCES = ("covariance", "noise_covariance")
_AVERAGED = (
    "frequency_hz",
    "response",
    "coherence",
    "input_power",
    "output_power",
    "cross_power",
    "multiple_coherence",
    "partial_coherence",
)
