"""A tone near a known frequency: its frequency, amplitude and growth with their errors, by least squares.

The signal is brought to 0 Hz and averaged over overlapping Hann blocks; their means follow c exp(g + 2 pi i d)t exactly
where the tone is exponential, and the noise of a narrow band is white in them but for a correlation of 1/6 between
neighbours. So few complex numbers hold all that the record says of the tone, whatever colour the noise has elsewhere.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import cholesky_banded, solve_banded

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
        t = _middle_times(self.samples, self.rate_hz)
        return np.asarray(2.0 * (self.phasor * np.exp((self.growth_per_s + 1j * TWO_PI * self.frequency_hz) * t)).real)


def fit_tone(values: Array, rate_hz: float, near_hz: float) -> ToneFit:
    """The tone of a signal (n,) within some lines of `near_hz`, n at least `BLOCKS` + 1."""
    hop = values.size // (BLOCKS + 1)
    t = _middle_times(values.size, rate_hz)
    z = _blocks(values * np.exp(-1j * TWO_PI * near_hz * t), hop)
    time_s = t[0] + (hop * (np.arange(z.size) + 1.0) - 0.5) / rate_hz
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


def _middle_times(samples: int, rate_hz: float) -> Array:
    return np.asarray((np.arange(samples) - 0.5 * (samples - 1)) / rate_hz, dtype=float)


def _hann(hop: int) -> Array:
    window = 0.5 - 0.5 * np.cos(np.pi * (np.arange(2 * hop) + 0.5) / hop)
    return np.asarray(window / window.sum(), dtype=float)


def _blocks(shifted: ComplexArray, hop: int) -> ComplexArray:
    """Weighted means of blocks of 2 hop samples that begin every hop."""
    rows = shifted[: (BLOCKS + 1) * hop].reshape(BLOCKS + 1, hop)
    window = _hann(hop)
    return np.asarray(rows[:-1] @ window[:hop] + rows[1:] @ window[hop:])


def _block_gain(exponent_per_s: complex, hop: int, rate_hz: float) -> complex:
    """What a block's mean makes of an exponential, relative to its value in the block's middle."""
    t = (np.arange(2 * hop) - (hop - 0.5)) / rate_hz
    return complex(_hann(hop) @ np.exp(exponent_per_s * t))


def _exponential(z: ComplexArray, t: Array) -> tuple[complex, float, float, Array, Array]:
    """c, growth, offset in Hz of the least squares c exp((g + 2 pi i d)t) to z; Jacobian and what is left, whitened."""
    from scipy.optimize import least_squares

    length = float(t[-1] - t[0])
    overlap = 1.0 / 6.0
    factor = cholesky_banded(np.vstack([np.ones(z.size), np.full(z.size, overlap)]), lower=True)

    def white(columns: ComplexArray) -> ComplexArray:
        return np.asarray(solve_banded((1, 0), factor, columns))

    def basis(x: Array) -> ComplexArray:
        return np.asarray(np.exp((x[0] / length + 1j * TWO_PI * x[1] / length) * t))

    def parts(x: Array) -> tuple[complex, ComplexArray, ComplexArray]:
        shape = basis(x)
        whitened = white(shape)
        c = complex(np.vdot(whitened, target) / np.vdot(whitened, whitened).real)
        return c, shape, target - c * whitened

    def left(x: Array) -> Array:
        return _flat(parts(x)[2])

    target = white(z)
    # growth over the whole span from which a fit starts, in neper
    starts = [np.array([g, _peak(z * np.exp(-g * t / length), length)]) for g in (-6.0, -2.0, 0.0, 2.0, 6.0)]
    initial = min(starts, key=lambda x: float(np.sum(left(x) ** 2)))
    x = least_squares(left, initial, method="lm", xtol=1e-10, ftol=1e-10, x_scale=(1.0, 0.3)).x
    c, shape, missed = parts(x)
    columns = white(np.column_stack([shape, 1j * shape, c * t * shape, 1j * TWO_PI * c * t * shape]))
    return c, float(x[0] / length), float(x[1] / length), np.vstack([columns.real, columns.imag]), _flat(missed)


def _flat(values: ComplexArray) -> Array:
    return np.concatenate([values.real, values.imag])


def _peak(z: ComplexArray, length: float) -> float:
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
