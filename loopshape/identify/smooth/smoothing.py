"""FRF -> the same FRF with what neighbouring lines have in common taken together, and the scatter that is left.

A margin read from noisy lines is biased: the largest of many noisy numbers is too large. A plant's response is smooth
between its resonances, so at each line a polynomial of fourth degree in ln f is fitted over the widest window in which
one of second degree leaves nothing but the FRF's own noise. The higher degree keeps the bias of the window's choice
below its noise (Calonico, Cattaneo and Titiunik, Econometrica 82(6), 2014: robust bias-corrected inference).
Resonances as narrow as a few lines are fitted, taken out before and put back after, between the lines too. Each element
of a matrix is smoothed as a single response, with windows of its own; the errors of all elements are drawn together, by
the covariance of their line.

Of very many frequencies neighbours that differ by noise alone are averaged before. A period of minutes gives a million
frequencies, most of which say the same as their neighbours. Neighbours are merged by twos, then by fours and so on,
wherever a polynomial of second degree over the 16 about them leaves nothing but noise. Where the plant bends faster, at
a resonance, and where one frequency alone stands out further than chance makes one of all stand out (5.7 deviations of
a million), every frequency stays.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from scipy.ndimage import median_filter
from scipy.sparse import csr_array
from scipy.special import chdtri

from loopshape.core.kernels.smoothing import accepted_halves, excesses, smoothing_weights, within_span
from loopshape.core.remembered import remembered
from loopshape.core.units import Array, ComplexArray
from loopshape.data.algebra.propagation import pick
from loopshape.data.response.frf import FRF
from loopshape.data.response.smoothed import Dense, Scatter
from loopshape.identify.smooth.pole_terms import PoleTerm, common_poles, pole_terms
from loopshape.identify.spectra.averages import pooled_variance
from loopshape.identify.tolerances import TOL

#: half widths of windows that are tried, in lines
HALVES = np.array([2, 3, 4, 5, 6, 8, 10, 13, 16, 20, 26, 32, 40, 50, 64, 80])
#: degree that must leave only noise, and the one that is used
TESTED, USED = 2, 4
#: widest window in ln f: from 1 to 5
SPAN = 1.6
#: draws of the scatter, and their seed
DRAWS, SEED = 200, 20071


@remembered
def smoothed(frf: FRF, band_hz: tuple[float, float] | None = None) -> tuple[FRF, Scatter]:
    """The valid band of a 1 x 1 FRF, or those in a band, smoothed, and draws of their error; same FRF, same answer.

    The lines' covariance is used unchanged: one that is too small leaves the lines rough and the intervals short,
    one that is too large lets a window run over a narrow resonance. An FRF without variance stays unchanged, without
    scatter. Errors of neighbouring lines are drawn with the correlation that `line_overlap` tells.
    """
    frf = frf.between(*band_hz) if band_hz else frf.valid_lines()
    y, v = frf.siso, pooled_variance(frf)
    if not v.any():
        return frf, Scatter(y, np.zeros((1, y.size), dtype=complex))
    f, terms = frf.frequency_hz, pole_terms(frf, v)
    errors, poles = drawn_errors(np.random.default_rng(SEED), v, frf.line_overlap), _added(terms, f)
    moved = sum((term.deviations(f, errors) for term in terms), np.zeros(errors.shape, dtype=complex))
    smooth = _smooth(frf, poles, errors - moved, v)
    response, reference, deviations = smooth.response + poles, smooth.reference + poles, smooth.deviations + moved
    variance = np.mean(np.abs(deviations) ** 2, axis=0)
    made = replace(
        frf, response=response[:, None, None], covariance=variance[:, None, None] + 0j, noise_covariance=None
    )
    dense = _dense(replace(smooth, reference=reference - poles), terms, errors) if terms else None
    narrow = np.array([(x.resonance.pole_hz, x.resonance.residue) for x in terms], dtype=complex).reshape(-1, 2)
    return made, Scatter(reference, deviations, dense, narrow[:, 0], narrow[:, 1])


def _added(terms: Sequence[PoleTerm], f: Array) -> ComplexArray:
    """What narrow resonances add to a response at f (n,) in Hz."""
    return sum((term.resonance.response(f) for term in terms), np.zeros(f.size, dtype=complex))


def _dense(smooth: Dense, terms: Sequence[PoleTerm], errors: ComplexArray) -> Dense:
    """Lines, and places between them over each narrow resonance: what is smooth by splines, resonances as they are."""
    f, places = smooth.frequency_hz, np.concatenate([term.places_hz for term in terms])
    at = np.unique(np.concatenate([f, places[(places > f[0]) & (places < f[-1])]]))
    poles, smooth = _added(terms, at), smooth.at(at)
    moved = sum((term.deviations(at, errors) for term in terms), np.zeros((len(errors), at.size), dtype=complex))
    return Dense(at, smooth.response + poles, smooth.reference + poles, smooth.deviations + moved)


@dataclass(frozen=True, eq=False)
class Recipe:
    """What draws of a smoothed response's error are made from, beside the generator's numbers.

    The lines' `variance` (nf,), half widths (nf,) of their windows, `taps` by which neighbours share errors, and narrow
    resonances.
    """

    variance: Array
    halves: np.ndarray
    taps: Array
    terms: tuple[PoleTerm, ...]


def recipe_of(lines: FRF) -> Recipe:
    """How `smoothed` makes its draws for the lines of its band: for a program that draws the same ones."""
    y, v = lines.siso, pooled_variance(lines)
    if not v.any():
        return Recipe(v, np.zeros(v.size, dtype=int), np.ones(1), ())
    terms = pole_terms(lines, v)
    halves = _halves(lines, y - _added(terms, lines.frequency_hz), _floor(y, v))
    return Recipe(v, halves, _taps(lines.line_overlap), terms)


def _floor(y: ComplexArray, v: Array) -> Array:
    """Variance (nf,) that no line is known better than."""
    return np.maximum(v, 1e-20 * np.abs(y) ** 2 + 1e-300)


def _halves(frf: FRF, y: ComplexArray, v: Array) -> np.ndarray:
    """Half widths (nf,) of the windows over lines y (nf,)."""
    x = np.log(frf.frequency_hz)
    halves = accepted_halves(x, y, v, HALVES, TESTED, TOL.smooth_std, frf.line_overlap, SPAN)
    return within_span(x, median_filter(halves, size=TOL.smooth_lines, mode="nearest"), SPAN)


def smoother_of(frf: FRF, y: ComplexArray, v: Array) -> csr_array:
    """The smoother (nf, nf) as a sparse matrix."""
    halves = _halves(frf, y, v)
    first, weights = smoothing_weights(np.log(frf.frequency_hz), v, halves, USED)
    lines, width = weights.shape
    inside = np.arange(width) < (2 * halves + 1)[:, None]
    columns = (first[:, None] + np.arange(width))[inside]
    rows = np.repeat(np.arange(lines), 2 * halves + 1)
    return csr_array((weights[inside], (rows, columns)), shape=(lines, lines))


def drawn_errors(rng: np.random.Generator, v: Array, overlap: float, draws: int = DRAWS) -> ComplexArray:
    """Circular errors (draws, nf) of variance v (nf,), neighbours correlated as `overlap` lines of one's worth."""
    taps = _taps(overlap)
    lines = v.size + taps.size - 1
    white = rng.standard_normal((draws, lines)) + 1j * rng.standard_normal((draws, lines))
    error = sum(tap * white[:, k : k + v.size] for k, tap in enumerate(taps))
    return np.asarray(error * np.sqrt(0.5 * v / float(taps @ taps)))


def correlation(overlap: float) -> Array:
    """Correlation of a line's error with its own (1) and those 1, 2, ... lines on, as far as it is not 0."""
    taps = _taps(overlap)
    own = np.correlate(taps, taps, "full")[taps.size - 1 :]
    return np.asarray(own / own[0])


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


@remembered
def smoothed_matrix(frf: FRF) -> tuple[Dense, ComplexArray] | None:
    """Smoothed lines of a matrix FRF (n, ny, nu) with draws of their error, and what its narrow resonances add to them.

    None where the FRF has no covariance. The same FRF, the same answer.

    The covariance is used unchanged; the correlations between a line's elements are that line's own, their variances
    pooled with those of neighbours where few degrees of freedom know them. Narrow resonances, which all elements share,
    are taken out before and put back after, between the lines too.
    """
    if not frf.covariance.any():
        return None
    ny, nu = frf.response.shape[1:]
    f, elements = frf.frequency_hz, [pick(frf, [i], [j]) for j in range(nu) for i in range(ny)]
    variance = np.stack([pooled_variance(one) for one in elements], axis=1)
    errors, poles = _drawn(frf, variance, SEED), common_poles(elements, variance)
    at = np.unique(np.concatenate([f, *(one.places_hz for one in poles)]))
    at = at[(at >= f[0]) & (at <= f[-1])]
    drawn = [one.drawn(errors) for one in poles]
    response, narrow = np.empty((at.size, ny, nu), dtype=complex), np.empty_like(frf.response, dtype=complex)
    reference, deviations = np.empty_like(response), np.empty((len(errors), at.size, ny, nu), dtype=complex)
    for k, one in enumerate(elements):
        j, i = divmod(k, ny)

        def put_back(places: Array, k: int = k) -> tuple[ComplexArray, ComplexArray]:
            still = sum((pole.response(places)[:, k] for pole in poles), np.zeros(places.size, dtype=complex))
            moved = [pole.deviations(places, own, k) for pole, own in zip(poles, drawn, strict=True)]
            return still, np.asarray(sum(moved, np.zeros((1, 1), dtype=complex)))

        still, moved = put_back(f)
        narrow[:, i, j] = still
        found = _smooth(one, still, errors[:, :, k] - moved, variance[:, k])
        if poles:
            found, (still, moved) = found.at(at), put_back(at)
        response[:, i, j], reference[:, i, j] = found.response + still, found.reference + still
        deviations[:, :, i, j] = found.deviations + moved
    return Dense(at, response, reference, deviations), narrow


def _smooth(one: FRF, poles: ComplexArray, errors: ComplexArray, variance: Array) -> Dense:
    """An element without its poles (nf,), smoothed, with errors (draws, nf) of what is left."""
    rest = one.siso - poles
    smoother = smoother_of(one, rest, _floor(one.siso, variance))
    response = np.asarray(smoother @ rest)
    return Dense(one.frequency_hz, response, np.asarray(smoother @ response), np.asarray((smoother @ errors.T).T))


def _drawn(frf: FRF, variance: Array, seed: int) -> ComplexArray:
    """Errors (draws, nf, ny nu) of vec(response), neighbours correlated as they overlap."""
    rng, ones = np.random.default_rng(seed), np.ones(frf.frequency_hz.size)
    white = np.stack([drawn_errors(rng, ones, frf.line_overlap) for _ in variance.T], axis=2)
    return np.asarray(np.einsum("fij,dfj->dfi", _root(frf.covariance, variance), white))


def _root(covariance: ComplexArray, variance: Array) -> ComplexArray:
    """The symmetric root (nf, m, m) of covariances that have been given other variances (nf, m), correlations kept."""
    own = np.sqrt(np.maximum(np.real(np.einsum("fii->fi", covariance)), 1e-300))
    values, vectors = np.linalg.eigh(covariance / own[:, :, None] / own[:, None, :])
    root = (vectors * np.sqrt(np.maximum(values, 0.0))[:, None, :]) @ vectors.conj().transpose(0, 2, 1)
    return np.asarray(np.sqrt(variance)[:, :, None] * root)


#: groups in a window, the degree that must leave only noise in it, and the widest group in ln f
_WINDOW, _DEGREE, _WIDEST = 16, 2, 0.005


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
    many = 20_000  # an FRF of no more frequencies stays as it is
    if frf.frequency_hz.size <= many:
        return frf
    return _grouped(frf)


def _starts(frf: FRF, v: Array) -> np.ndarray:
    """First frequency (groups,) of each group."""
    starts, noise, size = np.arange(v.size), 1.0, 1
    while True:
        f, P = _means(frf.frequency_hz, starts), _means(frf.siso, starts)
        variance = _variance(v, starts, frf.line_overlap)
        # values are taken to err by this share of |P| at least: what a polynomial may round off
        tested = variance + (1e-4 * np.abs(P)) ** 2 + 1e-300
        excess = excesses(np.log(f), P, tested, _WINDOW, _DEGREE, frf.line_overlap)
        noise = max(float(np.median(excess)), 1.0) if size == 1 else noise
        smooth = _nothing_but_noise(excess / noise, starts.size, frf.line_overlap)
        second = _seconds(frf, starts, smooth, variance, size)
        if not second.any():
            return starts
        starts, size = starts[~second], 2 * size


def _nothing_but_noise(excess: Array, groups: int, overlap: float) -> np.ndarray:
    """Whether all windows about each group (groups,) leave no more than noise, by its chance over all windows."""
    common = 0.5 * (min(overlap, 1.94) - 1.0)
    freedom = 2.0 * (_WINDOW - _DEGREE - 1) / (1.0 + 2.0 * common**2)
    good = excess <= chdtri(freedom, TOL.merged_by_chance / excess.size) / freedom
    smooth = np.ones(groups, dtype=bool)
    for k in np.flatnonzero(~good):
        low = min(int(k) * (_WINDOW // 2), groups - _WINDOW)
        smooth[low : low + _WINDOW] = False
    return smooth


def _seconds(frf: FRF, starts: np.ndarray, smooth: np.ndarray, variance: Array, size: int) -> np.ndarray:
    """Groups (groups,) that join the one before: both smooth, of `size` frequencies, as sure, and narrow together."""
    f, ends = frf.frequency_hz, np.append(starts[1:], frf.frequency_hz.size)
    whole = (ends - starts == size) & smooth
    low, high = np.minimum(variance[1:], variance[:-1]), np.maximum(variance[1:], variance[:-1])
    second = np.zeros(starts.size, dtype=bool)
    second[1:] = whole[1:] & whole[:-1] & (starts[:-1] % (2 * size) == 0) & (high <= TOL.merged_ratio * low)
    second[1:] &= frf.valid[starts[1:]] == frf.valid[starts[:-1]]
    second[1:] &= np.log(f[ends[1:] - 1] / f[starts[:-1]]) < _WIDEST
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


@remembered
def _grouped(frf: FRF) -> FRF:
    """The FRF on groups of frequencies."""
    starts = _starts(frf, pooled_variance(frf))
    made: dict[str, Any] = {"valid": frf.valid[starts]}
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
