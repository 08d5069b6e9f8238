"""FRF -> the same FRF with what neighbouring lines have in common taken together, and the scatter that is left.

A margin read from noisy lines is biased: the largest of many noisy numbers is too large. A plant's response is smooth
between its resonances, so at each line a polynomial of fourth degree in ln f is fitted over the widest window in which
one of second degree leaves nothing but the FRF's own noise. The higher degree keeps the bias of the window's choice
below its noise (Calonico, Cattaneo and Titiunik, Econometrica 82(6), 2014: robust bias-corrected inference).
Resonances as narrow as a few lines are fitted, taken out before and put back after, between the lines too. Each element
of a matrix is smoothed as a single response, with windows of its own; the errors of all elements are drawn together, by
the covariance of their line.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from weakref import WeakKeyDictionary

import numpy as np
from scipy.ndimage import median_filter
from scipy.sparse import csr_array

from loopshape.core.kernels.smoothing import accepted_halves, smoothing_weights, within_span
from loopshape.core.units import Array, ComplexArray
from loopshape.data.algebra.propagation import pick
from loopshape.data.response.frf import FRF
from loopshape.data.response.smoothed import Dense, Scatter
from loopshape.identify.smooth.pole_terms import PoleTerm, common_poles, pole_terms
from loopshape.identify.spectra.averages import pooled_variance

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

Band = tuple[float, float] | None
_DONE: WeakKeyDictionary[FRF, dict[Band, tuple[FRF, Scatter]]] = WeakKeyDictionary()


def smoothed(frf: FRF, band_hz: Band = None) -> tuple[FRF, Scatter]:
    """The valid band of a 1 x 1 FRF, or those in a band, smoothed, and draws of their error; same FRF, same answer.

    The lines' covariance is used unchanged: one that is too small leaves the lines rough and the intervals short,
    one that is too large lets a window run over a narrow resonance. A FRF without variance comes back as it is, without
    scatter. Errors of neighbouring lines are drawn with the correlation that `line_overlap` tells.
    """
    done = _DONE.setdefault(frf, {})
    if band_hz not in done:
        done[band_hz] = _smoothed(frf.between(*band_hz) if band_hz else frf.trusted_lines())
    return done[band_hz]


def _smoothed(frf: FRF) -> tuple[FRF, Scatter]:
    y, v = frf.siso, pooled_variance(frf)
    if not v.any():
        return frf, Scatter(y, np.zeros((1, y.size), dtype=complex))
    f, terms = frf.frequency_hz, pole_terms(frf, v)
    poles = sum((term.resonance.response(f) for term in terms), np.zeros(f.size, dtype=complex))
    smoother = smoother_of(frf, y - poles, _floor(y, v))
    errors = drawn_errors(np.random.default_rng(SEED), v, frf.line_overlap)
    moved = sum((term.deviations(f, errors) for term in terms), np.zeros(errors.shape, dtype=complex))
    rest, strayed = np.asarray(smoother @ (y - poles)), np.asarray((smoother @ (errors - moved).T).T)
    response, reference, deviations = rest + poles, np.asarray(smoother @ rest) + poles, strayed + moved
    variance = np.mean(np.abs(deviations) ** 2, axis=0)
    made = replace(
        frf, response=response[:, None, None], covariance=variance[:, None, None] + 0j, noise_covariance=None
    )
    dense = _dense(f, rest, reference - poles, strayed, terms, errors) if terms else None
    narrow = np.array([(x.resonance.pole_hz, x.resonance.residue) for x in terms], dtype=complex).reshape(-1, 2)
    return made, Scatter(reference, deviations, dense, narrow[:, 0], narrow[:, 1])


def _dense(
    f: Array,
    rest: ComplexArray,
    again: ComplexArray,
    strayed: ComplexArray,
    terms: Sequence[PoleTerm],
    errors: ComplexArray,
) -> Dense:
    """Lines, and places between them over each narrow resonance: what is smooth by splines, resonances as they are."""
    places = np.concatenate([term.places_hz for term in terms])
    at = np.unique(np.concatenate([f, places[(places > f[0]) & (places < f[-1])]]))
    poles = sum((term.resonance.response(at) for term in terms), np.zeros(at.size, dtype=complex))
    moved = sum((term.deviations(at, errors) for term in terms), np.zeros((len(errors), at.size), dtype=complex))
    smooth = Dense(f, rest, again, strayed).at(at)
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
    f, terms = lines.frequency_hz, pole_terms(lines, v)
    poles = sum((term.resonance.response(f) for term in terms), np.zeros(f.size, dtype=complex))
    return Recipe(v, _halves(lines, y - poles, _floor(y, v)), _taps(lines.line_overlap), terms)


def _floor(y: ComplexArray, v: Array) -> Array:
    """Variance (nf,) that no line is known better than."""
    return np.maximum(v, 1e-20 * np.abs(y) ** 2 + 1e-300)


def _halves(frf: FRF, y: ComplexArray, v: Array) -> np.ndarray:
    """Half widths (nf,) of the windows over lines y (nf,)."""
    x = np.log(frf.frequency_hz)
    halves = accepted_halves(x, y, v, HALVES, TESTED, STRICTNESS, frf.line_overlap, SPAN)
    return within_span(x, median_filter(halves, size=AGREED, mode="nearest"), SPAN)


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


_MATRICES: WeakKeyDictionary[FRF, tuple[Dense, ComplexArray] | None] = WeakKeyDictionary()


def smoothed_matrix(frf: FRF) -> tuple[Dense, ComplexArray] | None:
    """Smoothed lines of a matrix FRF (n, ny, nu) with draws of their error, and what its narrow resonances add to them.

    None where the FRF has no covariance. The same FRF, the same answer.

    The covariance is used unchanged; the correlations between a line's elements are that line's own, their variances
    pooled with those of neighbours where few degrees of freedom know them. Narrow resonances, which all elements share,
    are taken out before and put back after, between the lines too.
    """
    if frf not in _MATRICES:
        _MATRICES[frf] = _smoothed_elements(frf) if frf.covariance.any() else None
    return _MATRICES[frf]


def _smoothed_elements(frf: FRF) -> tuple[Dense, ComplexArray]:
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
    floor = np.maximum(variance, 1e-20 * np.abs(one.siso) ** 2 + 1e-300)
    smoother = smoother_of(one, rest, floor)
    response = np.asarray(smoother @ rest)
    return Dense(one.frequency_hz, response, np.asarray(smoother @ response), np.asarray((smoother @ errors.T).T))


def _drawn(frf: FRF, variance: Array, seed: int) -> ComplexArray:
    """Errors (draws, nf, ny nu) of vec(response), neighbours correlated as they overlap."""
    rng, ones = np.random.default_rng(seed), np.ones(frf.frequency_hz.size)
    white = np.stack([drawn_errors(rng, ones, frf.line_overlap) for _ in variance.T], axis=2)
    return np.asarray(np.einsum("fij,dfj->dfi", _root(frf.covariance, variance), white))


def _root(covariance: ComplexArray, variance: Array) -> ComplexArray:
    """A root (nf, m, m) of covariances that have been given other variances (nf, m), their correlations kept."""
    own = np.sqrt(np.maximum(np.real(np.einsum("fii->fi", covariance)), 1e-300))
    values, vectors = np.linalg.eigh(covariance / own[:, :, None] / own[:, None, :])
    root = vectors * np.sqrt(np.maximum(values, 0.0))[:, None, :]
    return np.asarray(np.sqrt(variance)[:, :, None] * root)
