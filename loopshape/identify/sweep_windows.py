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
from loopshape.identify.local_models import Fits, Shape, influences, solve, window_moments

#: half widths tried, in lines, each square larger than the last by two
HALVES = np.array([5, 6, 8, 11, 16, 23, 32, 45, 64, 91, 128, 181, 256, 362, 512, 724, 1024, 1448, 2048, 2896, 4096])
#: half a window is this share of its frequency at most, but for the narrowest
WIDEST = 0.2
#: windows this narrow hold too few lines for a denominator: steps of `HALVES` left out
TOO_FEW = 3
#: squared distance from a narrower window's answer, over what noise gives, from which on a window is too wide
LIMIT = 1.5
#: by so many steps a window is narrower than the widest that agrees
BACK = 4
#: the narrowest step of `HALVES` that is taken: narrower windows serve to compare, too few residuals tell their noise
SOUND = 2
#: lines at which windows are chosen are every third; on each side so many are pooled
EVERY, POOL = 3, 3
POLYNOMIAL, RATIONAL, RESTING = Shape(2, 0), Shape(2, 2), Shape(2, 0, transient=False)
#: share of the polynomial's variance below which a rational is taken: it bends to noise, which no variance shows
PAYS = 0.2
#: variance that a transient may add before its lines count as inseparable from it
SEPARATE = 2.0
#: and up to which a denominator is fitted beside it
PLAIN = 1.02
#: turns over a window before the sweep passes (an answer that rings on is no noise), and what is clearly louder there
LOUD = 2.0
BEFORE = np.arange(-8.0, -1.0)
#: what Hann's taper makes of the power of noise that a quadratic's kernel weighs
TAPERED = 2.63


@dataclass(frozen=True, eq=False)
class Chosen:
    """Of n lines: ends of each window (n,), both included, which has a denominator (n,), and by how much in power noise
    is louder while the sweep passes than over the record (n,): 1 where that is not clear."""

    left: np.ndarray
    right: np.ndarray
    rational: np.ndarray
    louder: Array


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
    transient, louder, loud, separate = _reference(z, few, low, high, outputs)
    left, right = _windows(few, low, high)
    M = window_moments(z, few, left, right, RATIONAL.powers)
    count, ridge = (right - left + 1).astype(float), transient.ridge(left, right)
    widest = np.argmax(count, axis=1)
    place, variance = zip(
        *(_best(solve(M, count, shape, ridge), outputs, shape, loud, widest) for shape in (POLYNOMIAL, RATIONAL)),
        strict=True,
    )
    rational = (variance[1] < variance[0] + np.log(PAYS)) & (loud == 0.0).all(axis=1) & separate
    taken = np.minimum(np.maximum(np.where(rational, place[1], place[0]), SOUND), left.shape[1] - 1)
    rows = np.arange(few.size)
    nearest = np.minimum(np.searchsorted(0.5 * (few[1:] + few[:-1]), lines), few.size - 1)
    half = (0.5 * (right - left)[rows, taken]).astype(int)[nearest]
    middle = np.clip(lines, low + half, high - half)
    return Chosen(middle - half, middle + half, rational[nearest], louder[nearest]), transient.select(nearest)


def _windows(lines: np.ndarray, low: int, high: int) -> tuple[np.ndarray, np.ndarray]:
    """Ends (n, windows) of the windows about each line, each within the next, no wider than `WIDEST` allows."""
    most = np.clip((WIDEST * lines).astype(int), HALVES[0], (high - low) // 2)
    half = np.minimum(HALVES, most[:, None])[:, : int(np.searchsorted(HALVES, most.max())) + 1]
    middle = np.clip(lines[:, None], low + half, high - half)
    return middle - half, middle + half


def _best(fits: Fits, outputs: int, shape: Shape, loud: Array, widest: np.ndarray) -> tuple[np.ndarray, Array]:
    """Window (n,) that one shape takes at each line, and the logarithm of its relative variance, smoothed."""
    value, noise = _sought(fits, outputs)
    noise = np.maximum(_pooled(noise), loud[:, None])
    first = min(TOO_FEW if shape.poles else 0, value.shape[1] - 1)
    gain = fits.gain[..., : value.shape[-1]]
    grown = first + _grown(value[:, first:], noise[:, first:], gain[:, first:])
    grown = np.minimum(grown, widest)  # windows beyond are the same
    best = np.maximum(median_filter(grown, 5, mode="nearest") - BACK, first)
    rows = np.arange(best.size)
    size = np.maximum(np.abs(value[rows, best]) ** 2, 1e-60)
    return best, _pooled(np.log((noise * gain)[rows, best] / size).mean(axis=-1))


def _sought(fits: Fits, outputs: int) -> tuple[ComplexArray, Array]:
    """What is sought of fits (..., k) and its noise: the plant where one input is among the answers, else these."""
    H, power = fits.response, fits.power
    if H.shape[-1] != outputs + 1:
        return H, power
    u = np.where(np.abs(H[..., outputs:]) > 1e-30, H[..., outputs:], 1e-30)
    P = H[..., :outputs] / u
    cross = np.real(P.conj() * fits.scatter[..., :outputs, outputs])
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
            agrees[:, c] &= _pooled((apart / expected).mean(axis=-1)) < LIMIT
    return np.asarray(np.logical_and.accumulate(agrees, axis=1).sum(axis=1) - 1)


def _pooled(x: Array) -> Array:
    return np.asarray(uniform_filter1d(x, 2 * POOL + 1, axis=0, mode="nearest"))


def _reference(
    z: ComplexArray, lines: np.ndarray, low: int, high: int, outputs: int
) -> tuple[Transient, Array, Array, np.ndarray]:
    """From fits over a fixed share of the frequency: the transient, by how much noise is louder (n,) while the sweep
    passes, what is sought's noise (n, k) there, zero where it is not clearly louder, and which lines (n,) tell a
    transient from the response."""
    half = np.minimum(np.maximum(8, (0.1 * lines).astype(int)), (high - low) // 2)
    middle = np.clip(lines, low + half, high - half)
    left, right = middle - half, middle + half
    M = window_moments(z, lines, left[:, None], right[:, None], RATIONAL.powers)[:, 0]
    count = right - left + 1.0
    fits, without = solve(M, count, POLYNOMIAL), solve(M, count, RESTING)
    separate = fits.gain[:, 0] / without.gain[:, 0]
    sharp = solve(M, count, RATIONAL)
    both = ((fits, POLYNOMIAL), (sharp, RATIONAL))
    parts = zip(*(_around(z, lines, left, right, *x, outputs) for x in both), strict=True)
    better = np.all(sharp.power < PAYS * fits.power, axis=1, keepdims=True)
    before, after, power, noise = (_pooled(np.asarray(np.where(better, b, a))) for a, b in parts)
    ratio, later = before[:, 0] / power[:, 0], after[:, 0] / power[:, 0]
    clear = (ratio > LOUD) & (separate < SEPARATE)
    louder = np.where(clear, np.maximum(ratio, later), 1.0)
    loud = np.where(clear, louder, 0.0)[:, None] * noise
    return _expected(fits, lines, half, separate), louder, loud, separate < PLAIN


def _around(
    z: ComplexArray, lines: np.ndarray, left: np.ndarray, right: np.ndarray, fits: Fits, shape: Shape, outputs: int
) -> tuple[Array, Array, Array, Array]:
    """Noise power over all answers (n, 1) just before and after the sweep passes, over the record, and of what is
    sought (n, k)."""
    total, gated, _ = influences(z, lines, left, right, shape.order, fits, np.concatenate([BEFORE, -BEFORE]))
    share = fits.power / np.maximum(np.einsum("nii->ni", total).real, 1e-300)
    before, after = (
        (share * _tapered(part)).sum(axis=1, keepdims=True)
        for part in (gated[:, : BEFORE.size], gated[:, BEFORE.size :])
    )
    return before, after, fits.power.sum(axis=1, keepdims=True), _sought(fits, outputs)[1]


def _tapered(gated: ComplexArray) -> Array:
    """Mean power (n, m) in neighbouring gates (n, gates, m) with Hann's taper over the window's lines.

    What a polynomial rounds off of a resonance stands where the sweep passes, is far above the noise there, and without
    a taper leaks into every other gate.
    """
    tapered = gated[:, 1:-1] - 0.5 * (gated[:, :-2] + gated[:, 2:])
    return np.asarray((np.abs(tapered) ** 2).mean(axis=1) / TAPERED)


def _expected(fits: Fits, lines: np.ndarray, half: np.ndarray, separate: Array) -> Transient:
    """A transient's size where a fit tells it from the response, and beyond these lines that of the nearest.

    Towards low frequency it is taken to grow as drift does, with 1/f.
    """
    own = np.flatnonzero(separate < SEPARATE)
    own = own if own.size else np.array([int(np.argmin(separate))])
    per_line = 1.0 / half[own, None] ** (2.0 * np.arange(POLYNOMIAL.order + 1))
    T = fits.theta[own, POLYNOMIAL.order + 1 :]
    power = _pooled((np.abs(T) ** 2).sum(axis=-1) / fits.power[own].sum(axis=-1)[:, None] * per_line)
    covariance = T[..., :, None] * T[..., None, :].conj() * per_line[..., None, None]
    covariance = _pooled(covariance.real) + 1j * _pooled(covariance.imag)
    nearest = np.clip(np.searchsorted(own, np.arange(lines.size)), 0, own.size - 1)
    growth = np.maximum(1.0, (lines[own[nearest]] / lines) ** 2)
    return Transient(power[nearest] * growth[:, None], covariance[nearest] * growth[:, None, None, None])
