"""Which window and shape each line of a sweep's transform gets, and how large its transient is expected to be.

The window grows until its answer leaves the narrower ones' by more than noise explains (Lepski 1990; Goldenshluger and
Nemirovski 1997), and is then taken four steps narrower, so that what it rounds off is small against the noise. Near the
ends of a record the sweep's own transform is as smooth as a transient and no fit can tell them apart: there the
transient is held to the size that it has next to those lines, and what that leaves open counts in the covariance.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import median_filter, uniform_filter1d

from loopshape.core.units import Array, ComplexArray
from loopshape.identify.local.local_models import TINY, Fits, Shape, at_gates, solve, window_moments
from loopshape.identify.tolerances import TOL

#: half widths tried, in lines, each square larger than the last by two
HALVES = np.array([5, 6, 8, 11, 16, 23, 32, 45, 64, 91, 128, 181, 256, 362, 512, 724, 1024, 1448, 2048, 2896, 4096])
#: half a window is this share of its frequency at most, but for the narrowest
WIDEST = 0.2
#: lines at which windows are chosen are every third
EVERY = 3
POLYNOMIAL, RATIONAL, RESTING = Shape(2, 0), Shape(2, 2), Shape(2, 0, transient=False)
#: from how much power just before the sweep passes, over the record's, noise is clearly louder there
LOUD = 2.0
#: times at which noise is heard, in cycles over the window from when the sweep passes
GATES = np.arange(-10.0, 11.0)
#: with a taper the inner ones: before (far, near) and after (near, far) the sweep passes, and how many each part holds
PARTS = (slice(0, 6), slice(6, 8), slice(11, 13), slice(13, 19))
HELD = np.array([6.0, 2.0, 2.0, 6.0])
#: degrees of freedom of what the far ones show: of white noise each shows two, pooled over lines (150 records)
HEARD = 2.0 * (HELD[0] + HELD[3])


@dataclass(frozen=True, eq=False)
class Chosen:
    """Of n lines: ends of each window (n,), both included, which has a denominator (n,), and the power of noise
    (n, m, m) about when the sweep passes where that is clearly louder than the record's, else 0."""

    left: np.ndarray
    right: np.ndarray
    rational: np.ndarray
    passing: ComplexArray


@dataclass(frozen=True, eq=False)
class Transient:
    """Expected size of a transient about n lines, with its coefficients taken over one line: `power` (n, order + 1)
    relative to the noise's, and `covariance` (n, order + 1, m, m)."""

    power: Array
    covariance: ComplexArray

    def ridge(self, left: np.ndarray, right: np.ndarray) -> Array:
        """What holds the coefficients over windows [left, right] (n, ...) to that size, (n, ..., order + 1)."""
        half = (0.5 * (right - left))[..., None] ** (2.0 * np.arange(self.power.shape[1]))
        power = self.power.reshape(self.power.shape[0], *[1] * (left.ndim - 1), -1)
        return np.asarray(1.0 / np.maximum(power * half, 1e-30))

    def select(self, rows: np.ndarray) -> Transient:
        """The same of some of the lines."""
        return Transient(self.power[rows], self.covariance[rows])


def choose(z: ComplexArray, lines: np.ndarray, low: int, high: int, outputs: int) -> tuple[Chosen, Transient]:
    """Windows within [low, high] for `lines` (n,) of z (nf, 2 + m): an instrument, 1, and answers, outputs first."""
    few = lines[::EVERY]
    transient, passing, loud, separate = _reference(z, few, low, high, outputs)
    left, right = _windows(few, low, high)
    M = window_moments(z, few, left, right, RATIONAL.powers)
    count, ridge = (right - left + 1).astype(float), transient.ridge(left, right)
    widest = np.argmax(count, axis=1)
    place, variance = zip(
        *(_best(solve(M, count, shape, ridge), outputs, shape, loud, widest) for shape in (POLYNOMIAL, RATIONAL)),
        strict=True,
    )
    rational = (variance[1] < variance[0] + np.log(TOL.rational_pays)) & (loud == 0.0).all(axis=1) & separate
    taken = np.minimum(np.maximum(np.where(rational, place[1], place[0]), TOL.sweep_narrowest), left.shape[1] - 1)
    rows = np.arange(few.size)
    nearest = np.minimum(np.searchsorted(0.5 * (few[1:] + few[:-1]), lines), few.size - 1)
    half = (0.5 * (right - left)[rows, taken]).astype(int)[nearest]
    middle = np.clip(lines, low + half, high - half)
    return Chosen(middle - half, middle + half, rational[nearest], passing[nearest]), transient.select(nearest)


def _windows(lines: np.ndarray, low: int, high: int) -> tuple[np.ndarray, np.ndarray]:
    """Ends (n, windows) of the windows about each line, each within the next, no wider than `WIDEST` allows."""
    most = np.clip((WIDEST * lines).astype(int), HALVES[0], (high - low) // 2)
    half = np.minimum(HALVES, most[:, None])[:, : int(np.searchsorted(HALVES, most.max())) + 1]
    middle = np.clip(lines[:, None], low + half, high - half)
    return middle - half, middle + half


def _best(fits: Fits, outputs: int, shape: Shape, loud: Array, widest: np.ndarray) -> tuple[np.ndarray, Array]:
    """Window (n,) that one shape takes at each line, and the logarithm of its relative variance, smoothed."""
    value, noise = _sought(fits.response, fits.scatter, outputs)
    noise = np.maximum(_pooled(noise), loud[:, None])
    too_few = 3  # windows this narrow hold too few lines for a denominator: steps of `HALVES` left out
    first = min(too_few if shape.poles else 0, value.shape[1] - 1)
    gain = fits.gain[..., : value.shape[-1]]
    grown = first + _grown(value[:, first:], noise[:, first:], gain[:, first:])
    grown = np.minimum(grown, widest)  # windows beyond are the same
    best = np.maximum(median_filter(grown, 5, mode="nearest") - TOL.sweep_narrower, first)
    rows = np.arange(best.size)
    size = np.maximum(np.abs(value[rows, best]) ** 2, 1e-60)
    return best, _pooled(np.log((noise * gain)[rows, best] / size).mean(axis=-1))


def _sought(H: ComplexArray, scatter: ComplexArray, outputs: int) -> tuple[ComplexArray, Array]:
    """What is sought of answers H (..., m) and its noise, by theirs (..., m, m): the plant where one input is among the
    answers, else these."""
    power = np.maximum(np.einsum("...xx->...x", scatter).real, TINY)
    if H.shape[-1] != outputs + 1:
        return H, power
    u = np.where(np.abs(H[..., outputs:]) > 1e-30, H[..., outputs:], 1e-30)
    P = H[..., :outputs] / u
    cross = np.real(P.conj() * scatter[..., :outputs, outputs])
    left = power[..., :outputs] + np.abs(P) ** 2 * power[..., outputs:] - 2.0 * cross
    floor = 1e-14 * (np.abs(H[..., :outputs]) ** 2 + 1e-60)
    return P, np.maximum(left, floor) / np.abs(u) ** 2


def _grown(value: ComplexArray, noise: Array, gain: Array) -> np.ndarray:
    """Widest of the windows (n, windows, k) that agrees, as do all narrower ones, with all narrower than itself."""
    windows = value.shape[1]
    agrees = np.ones(value.shape[:2], dtype=bool)
    for c in range(1, windows):
        for b in range(c):
            apart = np.abs(value[:, c] - value[:, b]) ** 2
            expected = noise[:, b] * np.maximum(gain[:, b] - gain[:, c], 0.05 * gain[:, b])
            agrees[:, c] &= _pooled((apart / expected).mean(axis=-1)) < TOL.sweep_misfit
    return np.asarray(np.logical_and.accumulate(agrees, axis=1).sum(axis=1) - 1)


def _pooled(x: Array) -> Array:
    return np.asarray(uniform_filter1d(x, 2 * TOL.choice_pooled + 1, axis=0, mode="nearest"))


def _pooled_powers(x: ComplexArray) -> ComplexArray:
    return np.asarray(_pooled(x.real) + 1j * _pooled(x.imag))


def _reference(
    z: ComplexArray, lines: np.ndarray, low: int, high: int, outputs: int
) -> tuple[Transient, ComplexArray, Array, np.ndarray]:
    """From fits over a fixed share of the frequency: the transient, the noise's power (n, m, m) about when the sweep
    passes and what is sought's noise (n, k) there, both zero where it is not clearly louder, and which lines (n,) tell
    a transient from the response."""
    half = np.minimum(np.maximum(8, (0.1 * lines).astype(int)), (high - low) // 2)
    middle = np.clip(lines, low + half, high - half)
    left, right = middle - half, middle + half
    M = window_moments(z, lines, left[:, None], right[:, None], RATIONAL.powers)[:, 0]
    count = right - left + 1.0
    fits, without, sharp = (solve(M, count, shape) for shape in (POLYNOMIAL, RESTING, RATIONAL))
    separate = fits.gain[:, 0] / without.gain[:, 0]
    better = np.all(sharp.power < TOL.rational_pays * fits.power, axis=1)[:, None, None]
    heard, sharply = (_heard(z, lines, left, right, *x) for x in ((fits, POLYNOMIAL), (sharp, RATIONAL)))
    heard, record = np.where(better[:, None], sharply, heard), np.where(better, sharp.scatter, fits.scatter)
    passing = _passing(_pooled_powers(heard), _pooled_powers(record))
    clear = (_trace(passing) > 0.0) & (separate < TOL.transient_variance)
    passing[~clear] = 0.0
    loud = np.where(clear[:, None], _sought(fits.response, passing, outputs)[1], 0.0)
    return _expected(fits, lines, half, separate), passing, loud, separate < TOL.transient_beside


def _heard(
    z: ComplexArray, lines: np.ndarray, left: np.ndarray, right: np.ndarray, fits: Fits, shape: Shape
) -> ComplexArray:
    """The noise's power (n, parts, m, m) in each of `PARTS`.

    Of noise that comes with the sweep a fit takes away more than of noise at other times: each part is measured by
    what it would show of white noise of power 1 once the fit has taken its share.
    """
    moves, columns = at_gates(z, lines, left, right, shape.order, fits, GATES)
    heard, taken = _tapered(moves), _tapered(columns)
    own = np.einsum("ngq,nq->ng", columns[:, GATES >= 0.0], fits.inverse[:, 0].conj()).real
    white = (1.5 * own[:, 0] - 2.0 * own[:, 1] + 0.5 * own[:, 2])[:, None]  # of Hann's taper squared
    white = white - np.einsum("ngq,nqp,ngp->ng", taken, fits.inverse, taken.conj()).real
    more = np.sqrt(np.maximum(fits.gain / fits.inverse[:, :1, 0].real, 1.0))  # by the denominator
    power = np.stack([np.einsum("ngx,ngy->nxy", heard[:, p], heard[:, p].conj()) for p in PARTS], axis=1)
    unit = np.stack([white[:, p].sum(axis=1) for p in PARTS], axis=1)
    return np.asarray(power / unit[..., None, None] / (more[:, None, :, None] * more[:, None, None, :]))


def _passing(heard: ComplexArray, record: ComplexArray) -> ComplexArray:
    """The noise's power (n, m, m) about when the sweep passes, of `heard` (n, parts, m, m): zero where it is not
    clearly louder just before than over the record (n, m, m). An answer that rings on afterwards is no noise.

    What a polynomial rounds off of a resonance stands where the sweep passes and shows in the near parts, not in the
    far ones: where the near ones hold clearly more, the far ones count alone.
    """
    power, held = _trace(heard), np.tile(HELD, (heard.shape[0], 1))
    held[power[:, 1] + power[:, 2] > LOUD * (power[:, 0] + power[:, 3]), 1:3] = 0.0
    before = (held * power)[:, :2].sum(axis=1) / held[:, :2].sum(axis=1)
    around = np.einsum("np,npxy->nxy", held, heard) / held.sum(axis=1)[:, None, None]
    around[before <= LOUD * _trace(record)] = 0.0
    return np.asarray(around)


def _tapered(gates: ComplexArray) -> ComplexArray:
    """Inner gates (n, gates - 2, x) of (n, gates, x), with Hann's taper over the window's lines."""
    return np.asarray(gates[:, 1:-1] - 0.5 * (gates[:, :-2] + gates[:, 2:]))


def _trace(power: ComplexArray) -> Array:
    return np.asarray(np.einsum("...xx->...", power).real)


def _expected(fits: Fits, lines: np.ndarray, half: np.ndarray, separate: Array) -> Transient:
    """A transient's size where a fit tells it from the response, and beyond these lines that of the nearest.

    Towards low frequency it is taken to grow as drift does, with 1/f.
    """
    own = np.flatnonzero(separate < TOL.transient_variance)
    own = own if own.size else np.array([int(np.argmin(separate))])
    per_line = 1.0 / half[own, None] ** (2.0 * np.arange(POLYNOMIAL.order + 1))
    T = fits.theta[own, POLYNOMIAL.order + 1 :]
    power = _pooled((np.abs(T) ** 2).sum(axis=-1) / fits.power[own].sum(axis=-1)[:, None] * per_line)
    covariance = T[..., :, None] * T[..., None, :].conj() * per_line[..., None, None]
    covariance = _pooled_powers(covariance)
    nearest = np.clip(np.searchsorted(own, np.arange(lines.size)), 0, own.size - 1)
    growth = np.maximum(1.0, (lines[own[nearest]] / lines) ** 2)
    return Transient(power[nearest] * growth[:, None], covariance[nearest] * growth[:, None, None, None])
