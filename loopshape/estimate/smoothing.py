"""FRF -> the same FRF with what neighbouring lines have in common taken together, and the scatter that is left.

A margin read from noisy lines is biased: the largest of many noisy numbers is too large. A plant's response is smooth
between its resonances, so at each line a polynomial of fourth degree in ln f is fitted over the widest window in which
one of second degree leaves nothing but the FRF's own noise. The higher degree keeps the bias of the window's choice
below its noise (Calonico, Cattaneo and Titiunik, Econometrica 82(6), 2014: robust bias-corrected inference). Where a
resonance is as narrow as a few lines, the lines stay as they are.
"""

from __future__ import annotations

from dataclasses import replace
from weakref import WeakKeyDictionary

import numpy as np
from scipy.ndimage import median_filter, uniform_filter1d
from scipy.sparse import csr_array
from scipy.special import digamma

from loopshape.frf import FRF
from loopshape.kernels.smoothing import accepted_halves, smoothing_weights, within_span
from loopshape.smoothed import Scatter
from loopshape.units import Array, ComplexArray

#: half widths of windows that are tried, in lines
HALVES = np.array([2, 3, 4, 5, 6, 8, 10, 13, 16, 20, 26, 32, 40, 50, 64, 80])
#: degree that must leave only noise, and the one that is used
TESTED, USED = 2, 4
#: a window is too wide where the residual exceeds the noise by so many standard deviations
STRICTNESS = 6.0
#: widest window in ln f: from 1 to 5
SPAN = 1.6
#: a line's window is the median of those of so many lines about it: one line's bad luck does not narrow it alone
AGREED = 11
#: draws of the scatter, and their seed
DRAWS, SEED = 200, 20071
#: a variance with fewer degrees of freedom is pooled with its neighbours' until it has as many
FREEDOM = 60.0

Band = tuple[float, float] | None
_DONE: WeakKeyDictionary[FRF, dict[Band, tuple[FRF, Scatter]]] = WeakKeyDictionary()


def smoothed(frf: FRF, band_hz: Band = None) -> tuple[FRF, Scatter]:
    """The trusted lines of a 1 x 1 FRF, or those in a band, smoothed, and draws of their error; same FRF, same answer.

    The lines' covariance is believed: one that is too small leaves the lines rough and the intervals short, one that is
    too large lets a window run over a narrow resonance. A FRF without any variance comes back as it is, without scatter
    to speak of. Errors of neighbouring lines are drawn with the correlation that `line_overlap` tells.
    """
    done = _DONE.setdefault(frf, {})
    if band_hz not in done:
        done[band_hz] = _smoothed(frf.between(*band_hz) if band_hz else frf.trusted_lines())
    return done[band_hz]


def _smoothed(frf: FRF) -> tuple[FRF, Scatter]:
    y, v = frf.siso, pooled_variance(frf)
    if not v.any():
        return frf, Scatter(y, np.zeros((1, y.size), dtype=complex))
    floor = np.maximum(v, 1e-20 * np.abs(y) ** 2 + 1e-300)
    smoother = smoother_of(frf, y, floor)
    rng = np.random.default_rng(SEED)
    deviations = np.asarray((smoother @ drawn_errors(rng, v, frf.line_overlap).T).T)
    response = np.asarray(smoother @ y)
    variance = np.mean(np.abs(deviations) ** 2, axis=0)
    made = replace(
        frf, response=response[:, None, None], covariance=variance[:, None, None] + 0j, noise_covariance=None
    )
    return made, Scatter(np.asarray(smoother @ response), deviations)


def smoother_of(frf: FRF, y: ComplexArray, v: Array) -> csr_array:
    """The smoother (nf, nf) as a sparse matrix."""
    x, span = np.log(frf.frequency_hz), SPAN
    halves = accepted_halves(x, y, v, HALVES, TESTED, STRICTNESS, frf.line_overlap, span)
    halves = within_span(x, median_filter(halves, size=AGREED, mode="nearest"), span)
    first, weights = smoothing_weights(x, v, halves, USED)
    lines, width = weights.shape
    inside = np.arange(width) < (2 * halves + 1)[:, None]
    columns = (first[:, None] + np.arange(width))[inside]
    rows = np.repeat(np.arange(lines), 2 * halves + 1)
    return csr_array((weights[inside], (rows, columns)), shape=(lines, lines))


def pooled_variance(frf: FRF) -> Array:
    """Variance E|d|² (nf,) of the lines, pooled over neighbours (41 at most) until it has 60 degrees of freedom.

    Few periods know each line's variance badly; weights made of it would prefer the lines that look calm by luck. What
    is pooled are logarithms, freed of their bias (E ln of a chi-square over its freedom n is digamma(n/2) - ln(n/2)),
    of the variance or of its share of |P|², whichever is the flatter about a line.
    """
    v, freedom = np.array(frf.variance[:, 0, 0]), frf.variance_freedom
    if freedom >= FREEDOM or not v.any():
        return v
    reach = min(int(np.ceil(FREEDOM / freedom)) * frf.variance_pooled, 41, v.size)
    ln_v = np.log(np.maximum(v, 1e-12 * np.median(v) + 1e-300))
    means, misses = [], []
    for base in (np.zeros(v.size), np.log(np.abs(frf.siso) ** 2 + 1e-300)):
        mean = uniform_filter1d(ln_v - base, reach, mode="nearest")
        means.append(mean + base)
        misses.append(uniform_filter1d((ln_v - base - mean) ** 2, reach, mode="nearest"))
    half = 0.5 * freedom
    return np.asarray(np.exp(np.where(misses[0] <= misses[1], *means) - digamma(half) + np.log(half)))


def drawn_errors(rng: np.random.Generator, v: Array, overlap: float) -> ComplexArray:
    """Circular errors (DRAWS, nf) of variance v (nf,), neighbours correlated as `overlap` lines of one's worth."""
    taps = _taps(overlap)
    lines = v.size + taps.size - 1
    white = rng.standard_normal((DRAWS, lines)) + 1j * rng.standard_normal((DRAWS, lines))
    error = sum(tap * white[:, k : k + v.size] for k, tap in enumerate(taps))
    return np.asarray(error * np.sqrt(0.5 * v / float(taps @ taps)))


def _taps(overlap: float) -> Array:
    """Ones and a last tap b in [0, 1], whose moving sum has (sum of taps)²/(sum of squares) = overlap."""
    whole = max(int(np.ceil(overlap - 1e-9)) - 1, 1)
    if overlap <= 1.0:
        return np.ones(1)
    # (n + b)² = o (n + b²), the root within [0, 1]
    n, o = float(whole), float(overlap)
    roots = np.roots([o - 1.0, -2.0 * n, n * (o - n)]).real
    b = float(np.clip(roots.min(), 0.0, 1.0))
    return np.append(np.ones(whole), b)
