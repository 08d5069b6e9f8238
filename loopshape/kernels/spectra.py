"""Fourier transforms of segments and what overlapping windows leave of their independence."""

from __future__ import annotations

import numpy as np

from loopshape.kernels.types import Array, ComplexArray


def hann(n: int) -> Array:
    """Periodic Hann window (n,)."""
    return np.asarray(0.5 - 0.5 * np.cos(2.0 * np.pi * np.arange(n) / n))


def segment_spectra(signal: Array, length: int, step: int, window: Array) -> ComplexArray:
    """Transforms (segments, length//2 + 1) of windowed segments of `signal` (n,), each without its mean."""
    starts = np.arange(0, signal.size - length + 1, step)
    segments = np.lib.stride_tricks.sliding_window_view(signal, length)[starts]
    return np.asarray(np.fft.rfft((segments - segments.mean(axis=1, keepdims=True)) * window, axis=1))


def independent_share(segments: int, length: int, step: int, window: Array) -> float:
    """Independent averages per segment for stationary noise (Welch 1967, eq. for overlapping windows)."""
    energy = float(window @ window)
    total = 1.0
    for lag in range(1, min(segments, -(-length // step))):
        shift = lag * step
        overlap = float(window[shift:] @ window[: length - shift]) / energy
        total += 2.0 * (1.0 - lag / segments) * overlap**2
    return 1.0 / total


def line_overlap(window: Array) -> float:
    """How many neighbouring lines carry one line's worth of independent power: 1 for none, 1.94 for Hann.

    Neighbours correlate by the transform of the squared window; averages of products of two such signals
    by its square.
    """
    correlation = np.abs(np.fft.fft(window**2)) / float(window @ window)
    return float(correlation @ correlation)


def period_spectra(signal: Array, length: int) -> ComplexArray:
    """Transforms (periods, length//2 + 1) of consecutive whole periods; a sine of amplitude a gives a/2."""
    periods = signal.size // length
    return np.asarray(np.fft.rfft(signal[: periods * length].reshape(periods, length), axis=1) / length)
