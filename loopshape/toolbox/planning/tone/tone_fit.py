"""A tone near a known frequency: its frequency, amplitude and growth with their errors, by least squares.

The signal is brought to 0 Hz and averaged over overlapping Hann blocks; their means follow c exp(g + 2 pi i d)t exactly
where the tone is exponential, and the noise of a narrow band is white in them but for a correlation of 1/6 between
neighbours. So few complex numbers hold all that the record says of the tone, whatever colour the noise has elsewhere.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache

import numpy as np

from loopshape.core.units import TWO_PI, Array, ComplexArray

#: blocks of a fit, each overlapping half of the next, and the correlation of white noise between neighbours
BLOCKS = 64


@dataclass(frozen=True)
class ToneFit:
    """c exp((g + 2 pi i f) t) + conjugate over t about the middle of n samples; errors as standard deviations."""

    samples: int
    rate_hz: float
    frequency_hz: float
    growth_per_s: float
    phasor: complex
    frequency_std_hz: float
    growth_std_per_s: float
    amplitude_std: float
    freedom: int

    @property
    def amplitude(self) -> float:
        """Amplitude in the middle."""
        return 2.0 * abs(self.phasor)

    def signal(self) -> Array:
        """The tone (n,)."""
        exponent = (self.growth_per_s + 1j * TWO_PI * self.frequency_hz) / self.rate_hz
        row = math.isqrt(self.samples) + 1  # exp(a + b) = exp(a) exp(b): of rows and within them, not of each sample
        within = np.exp(exponent * np.arange(row))
        initial = 2.0 * self.phasor * np.exp(exponent * (row * np.arange(row) - 0.5 * (self.samples - 1)))
        parts = np.column_stack([initial.real, -initial.imag]) @ np.vstack([within.real, within.imag])
        return np.asarray(parts.ravel()[: self.samples])


def fit_tone(values: Array, rate_hz: float, near_hz: float) -> ToneFit:
    """The tone of a signal (n,) within some lines of `near_hz`, n at least `BLOCKS` + 1."""
    hop = values.size // (BLOCKS + 1)
    z = _blocks(values, hop, -1j * TWO_PI * near_hz / rate_hz)
    time_s = np.asarray((hop * (np.arange(z.size) + 1.0) - 0.5 * values.size) / rate_hz, dtype=float)
    c, growth, offset, jacobian, left = _exponential(z, time_s)
    freedom = 2 * z.size - 4
    spread = float(left @ left) / freedom * _correlation(left)
    size = np.maximum(np.linalg.norm(jacobian, axis=0), 1e-300)
    covariance = spread * np.linalg.pinv((jacobian / size).T @ (jacobian / size)) / np.outer(size, size)
    gain = _block_gain(growth + 1j * TWO_PI * offset, hop, rate_hz)
    toward = np.array([c.real, c.imag, 0.0, 0.0]) / max(abs(c), 1e-300)
    return ToneFit(
        values.size,
        rate_hz,
        near_hz + offset,
        growth,
        c / gain,
        float(np.sqrt(covariance[3, 3])),
        float(np.sqrt(covariance[2, 2])),
        2.0 * float(np.sqrt(toward @ covariance @ toward)) / abs(gain),
        freedom,
    )


def _hann(hop: int) -> Array:
    window = 0.5 - 0.5 * np.cos(np.pi * (np.arange(2 * hop) + 0.5) / hop)
    return np.asarray(window / window.sum(), dtype=float)


def _blocks(values: Array, hop: int, turn: complex) -> ComplexArray:
    """Weighted means of blocks of 2 hop samples that begin every hop, of values times exp(turn k) about the middle."""
    rows = values[: (BLOCKS + 1) * hop].reshape(BLOCKS + 1, hop)
    halves = _hann(hop).reshape(2, hop) * np.exp(turn * np.arange(hop))
    means = rows @ np.vstack([halves.real, halves.imag]).T
    initial = np.exp(turn * (hop * np.arange(BLOCKS + 1) - 0.5 * (values.size - 1)))
    first, second = initial[:, None].T * (means[:, :2] + 1j * means[:, 2:]).T
    return np.asarray(first[:-1] + second[1:])


def _block_gain(exponent_per_s: complex, hop: int, rate_hz: float) -> complex:
    """What a block's mean makes of an exponential, relative to its value in the block's middle."""
    t = (np.arange(2 * hop) - (hop - 0.5)) / rate_hz
    return complex(_hann(hop) @ np.exp(exponent_per_s * t))


def _exponential(z: ComplexArray, t: Array) -> tuple[complex, float, float, Array, Array]:
    """c, growth, offset in Hz of the least squares c exp((g + 2 pi i d)t) to z; Jacobian and what is left, whitened.

    By Levenberg's and Marquardt's steps in g and d; c is the best for each (Golub and Pereyra, 1973).
    """
    length, whiten = float(t[-1] - t[0]), _whitening()
    target = whiten @ z

    def parts(x: Array) -> tuple[complex, Array, Array]:
        shape = np.exp((x[0] + 1j * TWO_PI * x[1]) / length * t)
        whitened = whiten @ shape
        c = complex(np.vdot(whitened, target) / np.vdot(whitened, whitened).real)
        columns = whiten @ np.column_stack([shape, 1j * shape, c * t * shape, 1j * TWO_PI * c * t * shape])
        return c, np.vstack([columns.real, columns.imag]), _flat(target - c * whitened)

    # growth over the whole span from which a fit starts, in neper
    starts = [np.array([g, _peak(z * np.exp(-g * t / length))]) for g in (-6.0, -2.0, 0.0, 2.0, 6.0)]
    x, (c, jacobian, left) = min(((x, parts(x)) for x in starts), key=lambda one: float(one[1][2] @ one[1][2]))
    damping, most = 1e-3, 1e9  # of a step, relative to the Jacobian's own; above it no step is left
    while damping < most:
        normal = jacobian.T @ jacobian
        step = length * np.linalg.lstsq(normal + damping * np.diag(np.diag(normal)), jacobian.T @ left)[0][2:]
        tried = parts(x + step)
        if tried[2] @ tried[2] < left @ left:
            x, (c, jacobian, left), damping = x + step, tried, 0.1 * damping
            damping = most if np.abs(step).max() < 1e-10 * (1.0 + np.abs(x).max()) else damping
        else:
            damping *= 10.0
    return c, float(x[0] / length), float(x[1] / length), jacobian, left


@cache
def _whitening() -> Array:
    """What makes blocks' noise white: the inverse of the Cholesky factor of its correlation (blocks, blocks)."""
    overlap = np.diag(np.full(BLOCKS - 1, 1.0 / 6.0), 1)
    return np.asarray(np.linalg.inv(np.linalg.cholesky(np.eye(BLOCKS) + overlap + overlap.T)))


def _flat(values: ComplexArray) -> Array:
    return np.concatenate([values.real, values.imag])


def _peak(z: ComplexArray) -> float:
    """Where the spectrum of z is largest, in periods over its length."""
    padded = 8 * z.size
    k = int(np.argmax(np.abs(np.fft.fft(z, padded))))
    turns = (k if k < padded // 2 else k - padded) / padded
    return turns * (z.size - 1)


def _correlation(left: Array) -> float:
    """How many times larger the variance is for what is left being no white noise; 1 where it is."""
    e = left[: left.size // 2] + 1j * left[left.size // 2 :]
    power = float(np.vdot(e, e).real)
    near = [float(np.vdot(e[:-k], e[k:]).real) / max(power, 1e-300) for k in range(1, e.size // 4)]
    if not near or near[0] < 4.0 / np.sqrt(2.0 * e.size):
        return 1.0
    ends = next((k for k, value in enumerate(near) if value <= 0.0), len(near))
    return 1.0 + 2.0 * sum(near[:ends])
