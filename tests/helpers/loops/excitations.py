"""Signals that excite the loops of the bench's tests, by numpy alone: multisines of rms 0.65, noise and sines of 1."""

import numpy as np


def multisine(f_low_hz, f_high_hz, period_s, rate_hz, *, periods=4, seed=0, ramp_s=1.0, lines_hz=None):
    """Whole periods of all lines of a band, or of some, of one amplitude, random phases; ramps before and after."""
    n, ramp_n = round(period_s * rate_hz), round(ramp_s * rate_hz)
    lines = np.arange(np.ceil(f_low_hz * period_s), np.floor(f_high_hz * period_s) + 1) / period_s
    bins = np.round((lines if lines_hz is None else np.array(lines_hz)) * period_s).astype(int)
    spectrum = np.zeros(n // 2 + 1, dtype=complex)
    spectrum[bins] = np.exp(2j * np.pi * np.random.default_rng(seed).random(bins.size))
    one = np.fft.irfft(spectrum, n)
    x = (0.65 * one / one.std())[np.arange(-ramp_n, periods * n + ramp_n) % n]
    edge = np.linspace(0.0, 1.0, ramp_n)
    x[:ramp_n] *= edge
    x[x.size - ramp_n :] *= edge[::-1]
    return x


def band_noise(f_low_hz, f_high_hz, duration_s, rate_hz, seed=0):
    """Gaussian noise in a band, of rms 1, clipped at 3.5."""
    n = round(duration_s * rate_hz)
    f = np.fft.rfftfreq(n, 1.0 / rate_hz)
    spectrum = np.fft.rfft(np.random.default_rng(seed).standard_normal(n))
    x = np.fft.irfft(np.where((f >= f_low_hz) & (f <= f_high_hz), spectrum, 0.0), n)
    return np.clip(x / x.std(), -3.5, 3.5)


def up_and_down(f_low_hz, f_high_hz, duration_s, rate_hz):
    """A sine whose frequency rises in time, and falls back."""
    t = np.arange(round(duration_s * rate_hz)) / rate_hz
    f_hz = f_low_hz + (f_high_hz - f_low_hz) * np.minimum(t, duration_s - t) / (0.5 * duration_s)
    return np.sin(2.0 * np.pi * np.cumsum(f_hz) / rate_hz)
