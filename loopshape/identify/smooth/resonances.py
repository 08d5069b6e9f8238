"""Lightly damped poles that a measured plant shows: a pole over a polynomial, fitted to windows of its lines.

In a window about a resonance P is r/(j (f - f0) + w) and a smooth rest. (f - z) P = polynomial is linear in
z = f0 + j w and in the polynomial's coefficients (Levy, IRE Transactions on Automatic Control 4, 1959); solved again
with the last z's weights it ends at the least squared misfit of P itself (Sanathanan and Koerner, the same
Transactions 8, 1963).
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from functools import lru_cache

import numpy as np

from loopshape.core.units import Array, ComplexArray
from loopshape.data.response.frf import FRF
from loopshape.identify.spectra.averages import pooled_variance
from loopshape.identify.tolerances import TOL

#: half widths of windows that are tried, in lines; windows stand half of that apart
HALVES, APART = (4, 7, 12, 22, 36), 2
#: order of the polynomial beside the pole, and rounds of weighting anew
ORDER, ROUNDS = 2, 3
#: a pole is a resonance up to this damping, in this share of its window, and as wide as this share of its half at most
DAMPED, MIDDLE, WIDE = 0.3, 0.5, 0.6
#: a resonance has no less damping than this
SHARPEST = 1e-4
#: lines are taken to err by this share of |P| at least: what the polynomial rounds off
FLOOR = 1e-4


class Phase(StrEnum):
    """How the phase of P passes a resonance: it falls by 180 deg past a stable pole pair, rises past an unstable one.

    Unknown where the lines show the place of a pole and not the sign of its damping.
    """

    FALLING = "falling"
    RISING = "rising"
    UNKNOWN = "unknown"


@dataclass(frozen=True)
class Resonance:
    """A pole pair of a plant near the frequency axis: frequency, damping ratio (positive), and how the phase passes it.

    `first` .. `last` are the lines of the window that it was fitted on. `residue` is r of r/(j (f - f0) + w) with w the
    half width in Hz, negative for a rising phase. `pole_std_hz` is the deviation of the pole in the complex plane, root
    of E|dz|², with what the form leaves counted as noise. `frequency_std_hz`, and `peak_std` of the peak's logarithm,
    are deviations by the noise that the window shows: what two estimates of one resonance differ by.
    """

    frequency_hz: float
    damping: float
    phase: Phase
    first: int
    last: int
    residue: complex
    pole_std_hz: float
    frequency_std_hz: float = 0.0
    peak_std: float = 0.0

    @property
    def pole_hz(self) -> complex:
        """f0 + j w: the response has r/(j (f - pole)); w is negative where the phase rises."""
        width = self.damping * self.frequency_hz
        return complex(self.frequency_hz, -width if self.phase is Phase.RISING else width)

    @property
    def peak(self) -> float:
        """Height of the peak of |r/(j (f - pole))|, in the unit of P."""
        return abs(self.residue) / abs(self.pole_hz.imag)

    def response(self, frequency_hz: Array, shift: float = 0.0) -> ComplexArray:
        """The pole pair's part of P at `frequency_hz` (n,), moved by a relative `shift`: r/(j (f - z)) and its mirror.

        What a pair R/(s² + 2 zeta w s + w²) does whose stiffness changes: mode shape and mass, so R, and the damping
        ratio are kept.
        """
        f, z, r = np.asarray(frequency_hz, dtype=float), self.pole_hz * (1.0 + shift), self.residue / (1.0 + shift)
        return np.asarray(r / (1j * (f - z)) + np.conj(r) / (1j * (f + np.conj(z))))


def resonances(frf: FRF) -> tuple[Resonance, ...]:
    """Resonances of a 1 x 1 FRF on all its lines, in the order of frequency; the same FRF, the same answer.

    Found are poles whose peak stands out of the rest of P, of damping below 0.3, whose place the lines tell. Two whose
    half widths overlap are one; one whose tails lie below the noise is not found, nor any of fewer than nine lines.
    Give frequencies as measured: smoothed ones have lost what is sharp.
    """
    f, P = frf.frequency_hz, frf.siso
    overlap = max(frf.line_overlap, 1.0)
    return _remembered(f.tobytes(), P.astype(complex).tobytes(), pooled_variance(frf).tobytes(), overlap)


@lru_cache(maxsize=256)
def _remembered(f: bytes, P: bytes, variance: bytes, overlap: float) -> tuple[Resonance, ...]:
    return _found(np.frombuffer(f), np.frombuffer(P, dtype=complex), np.frombuffer(variance), overlap)


def _found(f: Array, P: ComplexArray, variance: Array, overlap: float) -> tuple[Resonance, ...]:
    every: list[Resonance] = []
    for half in HALVES:
        if f.size >= 2 * half + 1:
            every += _of_windows(f, P, variance, half, overlap)
    kept: list[Resonance] = []
    for one in sorted(every, key=lambda x: x.pole_std_hz / max(abs(x.pole_hz.imag), x.pole_std_hz)):
        if not any(_same(one, other) for other in kept):
            kept.append(one)
    return tuple(sorted(kept, key=lambda x: x.frequency_hz))


def _same(one: Resonance, other: Resonance) -> bool:
    """Whether one is another, surer one again: their widths overlap, or it only makes up for that in its window."""
    if one.phase is Phase.UNKNOWN and one.first <= 0.5 * (other.first + other.last) <= one.last:
        return True
    widths = abs(one.pole_hz.imag) + abs(other.pole_hz.imag) + 3.0 * (one.pole_std_hz + other.pole_std_hz)
    return abs(one.frequency_hz - other.frequency_hz) < widths


def _of_windows(f: Array, P: ComplexArray, variance: Array, half: int, overlap: float) -> list[Resonance]:
    """Resonances in windows of 2 half + 1 lines."""
    starts = np.unique(np.append(np.arange(0, f.size - 2 * half, max(half // APART, 1)), f.size - 2 * half - 1))
    rows = starts[:, None] + np.arange(2 * half + 1)
    centre = 0.5 * (f[rows[:, 0]] + f[rows[:, -1]])
    half_width = 0.5 * (f[rows[:, -1]] - f[rows[:, 0]])
    x, y = (f[rows] - centre[:, None]) / half_width[:, None], P[rows]
    std = np.sqrt(variance[rows] + (FLOOR * np.abs(y)) ** 2 + 1e-300)
    z = _poles(x, y, std)
    f0, width = centre + half_width * z.real, half_width * np.maximum(np.abs(z.imag), SHARPEST * centre / half_width)
    k = np.flatnonzero((np.abs(z.real) < MIDDLE) & (np.abs(z.imag) < WIDE) & (width < DAMPED * f0))
    if not k.size:
        return []
    f0, width, half_width, rows = f0[k], width[k], half_width[k], rows[k]
    pole = z[k].real + 1j * np.where(z[k].imag < 0.0, -1.0, 1.0) * width / half_width
    residue, rest, error, sure, noisy = _with_residue(x[k], y[k], std[k], pole, overlap)
    residue, error, gap = residue * half_width, error * half_width, 2.0 * half_width / (2 * half)
    known = error < TOL.resonance_known * width
    placed = (error < TOL.resonance_placed * gap) & (width < gap)
    # its peak stands so far above what is left of P there
    visible = np.abs(residue) > 0.5 * np.abs(rest) * np.maximum(width, error)
    good = (known | placed) & (sure > TOL.resonance_std) & visible
    return [
        Resonance(
            frequency_hz=float(f0[i]),
            damping=float(width[i] / f0[i]),
            phase=Phase.UNKNOWN if not known[i] else Phase.FALLING if pole[i].imag > 0.0 else Phase.RISING,
            first=int(rows[i, 0]),
            last=int(rows[i, -1]),
            residue=complex(residue[i]),
            pole_std_hz=float(max(error[i], 1e-9 * f0[i])),
            frequency_std_hz=float(noisy[0, i] * half_width[i]),
            peak_std=float(noisy[1, i]),
        )
        for i in np.flatnonzero(good)
    ]


def _poles(x: Array, y: ComplexArray, std: Array) -> ComplexArray:
    """Pole z (n,) of each window by x y = z y + polynomial of x, weighted anew with the last z."""
    powers = np.stack([x**k for k in range(ORDER + 2)], axis=-1).astype(complex)
    columns = np.concatenate([powers, y[:, :, None]], axis=-1)
    z = np.zeros(len(x), dtype=complex)
    for k in range(ROUNDS):
        across = np.maximum(np.abs(x - z[:, None]), 1e-3) if k else np.ones_like(x)
        weight = 1.0 / (std * across)
        A = columns * weight[:, :, None]
        scale = np.sqrt((np.abs(A) ** 2).sum(axis=1)) + 1e-300
        A = A / scale[:, None, :]
        square = A.conj().transpose(0, 2, 1) @ A + 1e-13 * np.eye(A.shape[2])
        right = A.conj().transpose(0, 2, 1) @ (x * y * weight)[:, :, None]
        z = (np.linalg.solve(square, right)[:, -1, 0] / scale[:, -1]).astype(complex)
        z = np.where(np.abs(z) < 1e3, z, 1e3)
    return z


def _with_residue(
    x: Array, y: ComplexArray, std: Array, pole: ComplexArray, overlap: float
) -> tuple[ComplexArray, ComplexArray, Array, Array, Array]:
    """Residue (n,) of each window's pole, the polynomial beside it at the pole, and the deviation of the pole's place.

    And the residue's size in its own deviations, and by the noise seen in the window the deviations (2, n) of the
    pole's real part and of ln |residue / half width|. What a window leaves over counts as noise where it is more than
    the lines' own.
    """
    column = 1.0 / (1j * (x - pole[:, None]))
    powers = np.stack([x**k for k in range(ORDER + 1)], axis=-1)
    A = np.concatenate([powers, column[:, :, None]], axis=-1) / std[:, :, None]
    Q, R = np.linalg.qr(A)
    along = Q.conj().transpose(0, 2, 1)
    solved = np.linalg.solve(R + 1e-300 * np.eye(A.shape[2]), along @ (y / std)[:, :, None])[:, :, 0]
    left = y / std - (A @ solved[:, :, None])[:, :, 0]
    noise = np.sqrt(np.maximum((np.abs(left) ** 2).sum(1) / max(x.shape[1] - A.shape[2] - 1, 1), 1.0))
    slope = (1j * solved[:, -1:] * column**2 / std)[:, :, None]
    onto = along @ slope
    bent = (slope - Q @ onto)[:, :, 0]
    rest = (solved[:, :-1] * pole.real[:, None] ** np.arange(ORDER + 1)).sum(1)
    across = np.sqrt((np.abs(bent) ** 2).sum(1) + 1e-300)
    error = noise / across
    residue = np.asarray(solved[:, -1], dtype=complex)
    size = np.abs(residue * R[:, -1, -1]) / noise
    by_residue = 1.0 / (residue * R[:, -1, -1] + 1e-150)
    by_pole = 1j / pole.imag - by_residue * onto[:, -1, 0]
    to_pole = bent.conj() / across[:, None] ** 2
    to_peak = by_residue[:, None] * Q[:, :, -1].conj() + by_pole[:, None] * to_pole
    square, beside = _seen_noise(left, overlap, A.shape[2] + 1)
    noisy = np.stack([_of_noise(h, square, beside) for h in (to_pole, to_peak)])
    return residue, np.asarray(rest, dtype=complex), error, size, noisy


def _seen_noise(left: ComplexArray, overlap: float, free: int) -> tuple[Array, Array]:
    """Mean square (n,) of what is left over (n, lines) in the lines' own noise, and correlation of neighbours there.

    Leakage of Welch's estimates is less than their coherence tells and of the other sign from line to line. Few lines
    tell little of it: `TOL.prior_lines` of what the FRF states are added (Newey and West, Econometrica 55, 1987).
    """
    alone = (np.abs(left) ** 2).sum(axis=1)
    beside = (left[:, 1:] * left[:, :-1].conj()).real.sum(axis=1)
    square = (TOL.prior_lines + alone) / (TOL.prior_lines + left.shape[1] - free)
    return square, (TOL.prior_lines * 0.5 * (overlap - 1.0) + beside) / (TOL.prior_lines + alone)


def _of_noise(influence: ComplexArray, square: Array, beside: Array) -> Array:
    """Deviation (n,) of Re(influence (n, lines) . e), complex errors e of this mean square, neighbours correlated."""
    largest = np.abs(influence).max(axis=1)  # without limit where there is no residue: it must not be squared
    share = influence / np.maximum(largest, 1e-300)[:, None]
    alone = (np.abs(share) ** 2).sum(axis=1)
    near = 2.0 * beside * (share[:, 1:] * share[:, :-1].conj()).real.sum(axis=1)
    return np.asarray(largest * np.sqrt(0.5 * square * np.maximum(alone + near, 0.05 * alone)))
