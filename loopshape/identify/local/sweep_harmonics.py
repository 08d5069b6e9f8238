"""Harmonics of a sweep: what a nonlinear machine adds to its answer, taken out before local models are fitted.

While a sweep passes f / m, a nonlinear plant answers at f too, at another time than when the sweep itself passes there
(Farina, AES 108, 2000; Novak, Simon, Kadlec, Lotton, IEEE TIM 59, 2010). In the record's transform that is a ripple
over frequency, X(k) = H(k) R(k) + sum_m H_m(k) R_m(k) + T(k) + V(k) with R_m of m times the sweep's phase: a narrow
window takes it for the plant, a wide one for noise, and it is neither.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from loopshape.core.stretches import AT_ONCE
from loopshape.core.units import Array, ComplexArray
from loopshape.identify.local.local_models import Fits, Shape, solve, window_moments
from loopshape.identify.spectra.long_transforms import low_lines, quadrature

#: highest harmonic looked for
HIGHEST = 12
#: half a window: this share of its frequency, if that is not as many lines up to another share, or fewer lines at worst
WIDTH, ENOUGH, WIDEST, LEAST = 0.1, 40, 0.4, 20
#: what is tried for the sweep's own answer over a window, none, one or two resonances, and the order of a harmonic's
SHAPES, ORDER = (Shape(2, 0), Shape(2, 2), Shape(4, 4)), 2
#: a harmonic is taken that explains so many times what noise would, if all those taken leave this share at most
CLEAR, LEAVES = 5.0, 0.67
#: one that the sweep times a polynomial of this order explains beyond this share passes with the sweep, not apart
SMOOTH, APART = 8, 0.5
#: a machine has a harmonic in this share at least of the windows in which it passes apart; a resonance looks so in one
OFTEN = 0.2


@dataclass(frozen=True, eq=False)
class Harmonics:
    """What a sweep's harmonics add: to the transforms (lines, m) from line `low` on, the share (lines,) of the noise
    that went with them, and which were found (their numbers)."""

    low: int
    added: ComplexArray
    share: Array
    found: tuple[int, ...]

    def __str__(self) -> str:
        numbers = ", ".join(str(m) for m in self.found)
        return f", without the sweep's harmonic{'s' * (len(self.found) > 1)} {numbers}" * bool(self.found)


def harmonics(z: ComplexArray, instrument: Array, low: int, high: int, lowest: float) -> Harmonics:
    """The harmonics in lines [low, high] of z (nf, 2 + m), an instrument's transform, 1 and answers.

    `instrument` (n,) is the sweep over time, from line `lowest` on: harmonic m begins at m times that. It is used up.
    A harmonic that resonances or noise may explain as well is left where it is.
    """
    inputs = _inputs(instrument, low, high)
    middle, half = _windows(low, high)
    added = np.zeros((high + 1 - low, z.shape[1] - 2), dtype=complex)
    share = np.zeros(high + 1 - low)
    found: set[int] = set()
    left, right = middle - half, middle + half
    M = window_moments(z, middle, left[:, None], right[:, None], SHAPES[-1].powers)[:, 0]
    count = right - left + 1.0
    fits = [(shape, solve(M, count, shape)) for shape in SHAPES]
    windows = []
    for i, (c, h) in enumerate(zip(middle, half, strict=True)):
        k, t = np.arange(c - h, c + h + 1), np.arange(-h, h + 1) / h
        residuals = min((_residuals(z[k], t, *x, i) for x in fits), key=lambda r: float(np.prod(_energy(r))))
        here = slice(c - h, c + h + 1)
        beyond = inputs[: max(0, int(c / lowest) - 1), here.start - low : here.stop - low]
        windows.append(_Window(k, t, z[here, 0], residuals, beyond))
    apart = [window.apart() for window in windows]
    taken = [window.explained(those)[1] for window, those in zip(windows, apart, strict=True)]
    often = {j for those in taken for j in those if _times(j, taken) >= max(2.0, OFTEN * _times(j, apart))}
    for i, (window, those) in enumerate(zip(windows, apart, strict=True)):
        part, chosen = window.explained([j for j in those if j in often])
        k, weight = window.lines, np.interp(window.lines, middle, np.eye(middle.size)[i])
        added[k - low] += weight[:, None] * part
        share[k - low] += weight * len(chosen) * (ORDER + 1) / k.size
        found.update(j + 2 for j in chosen)
    return Harmonics(low, added, share, tuple(sorted(found)))


def _times(j: int, lists: list[list[int]]) -> int:
    return sum(j in those for those in lists)


def _inputs(instrument: Array, low: int, high: int) -> ComplexArray:
    """Transforms (HIGHEST - 1, lines) of a sweep, which is used up, at 2, 3, ... times its phase, up to Nyquist."""
    size, phase, most = _analytic(instrument)
    found = np.empty((HIGHEST - 1, high + 1 - low), dtype=complex)
    wave = instrument
    for m in range(2, HIGHEST + 1):
        np.multiply(m, phase, out=wave)
        np.cos(wave, out=wave)
        wave *= size
        wave[most < m] = 0.0
        found[m - 2] = low_lines(wave, high)[low:]
    return found


def _analytic(x: Array) -> tuple[Array, Array, np.ndarray]:
    """Amplitude (n,) and phase (n,) in rad of a sweep over time, and its highest harmonic (n,) below Nyquist.

    The sweep's mean is taken from it in place.
    """
    x -= x.mean()
    y = quadrature(x)
    size = np.hypot(x, y)
    phase = np.arctan2(y, x, out=y)
    most = np.empty(phase.size, dtype=np.int8)
    for start in range(0, phase.size, AT_ONCE):
        first, stop = max(start - 1, 0), min(start + AT_ONCE, phase.size)
        step = np.gradient(np.unwrap(phase[first : stop + 1]))[start - first : stop - first]
        most[start:stop] = np.where(step * HIGHEST < np.pi, HIGHEST, np.ceil(np.pi / np.maximum(step, 0.1)) - 1.0)
    return size, phase, most


def _windows(low: int, high: int) -> tuple[np.ndarray, np.ndarray]:
    """Middles and half widths of windows within [low, high], each reaching to the next one's middle."""

    def width(c: int) -> int:
        return min(max(LEAST, min(ENOUGH, int(WIDEST * c)), int(WIDTH * c)), (high - low) // 2)

    half = [width(low)]
    middle = [low + half[0]]
    while middle[-1] + half[-1] < high:
        middle.append(middle[-1] + half[-1])
        half.append(width(middle[-1]))
        middle[-1] = min(middle[-1], high - half[-1])
    return np.array(middle), np.array(half)


def _residuals(z: ComplexArray, t: Array, shape: Shape, fits: Fits, i: int) -> ComplexArray:
    """What the fit over window i leaves of its answers, (lines, m)."""
    powers = t[:, None] ** np.arange(shape.order + 1)
    shaped = np.hstack([z[:, :1] * powers, powers]) @ fits.theta[i]
    denominator = fits.denominator[i]
    return np.asarray(z[:, 2:] - shaped / (powers[:, : denominator.size] @ denominator)[:, None])


@dataclass(frozen=True, eq=False)
class _Window:
    """Lines (n,), t over half of them, the sweep there, what a fit leaves of the answers (n, m), harmonics' inputs."""

    lines: np.ndarray
    t: Array
    sweep: ComplexArray
    residuals: ComplexArray
    inputs: ComplexArray

    def apart(self) -> list[int]:
        """Which harmonics pass at another time than the sweep."""
        smooth = np.linalg.qr(self.sweep[:, None] * np.polynomial.chebyshev.chebvander(self.t, SMOOTH))[0]
        return [j for j, x in enumerate(self.inputs) if _energy(smooth.conj().T @ x) < APART * _energy(x)]

    def explained(self, among: list[int]) -> tuple[ComplexArray, list[int]]:
        """What harmonics explain of the residuals, and which of those named these are."""
        powers = self.t[:, None] ** np.arange(ORDER + 1)
        base = np.hstack([self.sweep[:, None] * powers, powers])
        basis = np.linalg.qr(base)[0]
        left = self.residuals - basis @ (basis.conj().T @ self.residuals)
        start = size = _energy(left)
        taken: list[int] = []
        while len(taken) < len(among):
            spans = {j: _span(self.inputs[j][:, None] * powers, basis) for j in among if j not in taken}
            less = {j: float(np.mean(_energy(span.conj().T @ left) / size)) for j, span in spans.items()}
            best = max(less, key=less.__getitem__)
            free = self.t.size - basis.shape[1]
            if free < 4 * powers.shape[1] or less[best] < CLEAR * powers.shape[1] / free:
                break
            taken.append(best)
            basis = np.hstack([basis, spans[best]])
            left = left - spans[best] @ (spans[best].conj().T @ left)
            size = _energy(left)
        if not {0, 1} & set(taken) or float(np.mean(size / start)) > LEAVES:  # no machine has higher ones alone
            return np.zeros_like(self.residuals), []
        columns = np.hstack([base, *(self.inputs[j][:, None] * powers for j in taken)])
        columns /= np.sqrt(_energy(columns))
        theta = np.linalg.lstsq(columns, self.residuals, rcond=None)[0]
        return np.asarray(columns[:, base.shape[1] :] @ theta[base.shape[1] :]), taken


def _span(columns: ComplexArray, basis: ComplexArray) -> ComplexArray:
    """An orthonormal basis of what of columns (lines, p) lies outside of `basis` (lines, q)."""
    return np.linalg.qr(columns - basis @ (basis.conj().T @ columns))[0]


def _energy(x: ComplexArray) -> Array:
    return np.maximum((np.abs(x) ** 2).sum(axis=0), 1e-300)
