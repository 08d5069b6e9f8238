"""Fourier transforms of segments and what overlapping windows leave of their independence."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np

from loopshape.core.kernels.compiled import Array, ComplexArray, compiled, compiled_in_line


class Sliced(Protocol):
    """A signal (n,) that is an array, or is read a slice at a time."""

    @property
    def size(self) -> int:
        """Number of samples."""

    def __getitem__(self, rows: slice, /) -> Array:
        """Some of them, next to each other."""


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


def detrended(segments: Array, how: str) -> Array:
    """Segments (k, n) without their mean, without their least-squares line, or as they are ("none")."""
    if how == "none":
        return segments
    out = segments - segments.mean(axis=1, keepdims=True)
    if how == "linear":
        t = np.arange(segments.shape[1]) - 0.5 * (segments.shape[1] - 1)
        out -= np.outer(out @ t / (t @ t), t)
    return np.asarray(out)


#: bytes of transforms that `cross_spectra` holds at a time
BLOCK_BYTES = 8_000_000
#: lines whose products are added at a time
NEAR = 512


def cross_spectra(
    signals: Sequence[Sliced],
    length: int,
    step: int,
    weigh: int | None = None,
    window: Array | None = None,
    detrend: str = "mean",
) -> tuple[ComplexArray, ComplexArray, Array]:
    """Sums over segments of x x^H, (s, s, nf), and of w x x^H and w² with w = |x[weigh]|², for signals (n,) each.

    Segments are those of `segment_spectra`, a few at a time, so that memory does not grow with the record; signals may
    be read as they are sliced. Without
    `weigh` the weighted sums are zero and one line long. `window` (length,) is Hann's where none is given; `detrend`
    takes each segment's "mean", its "linear" least-squares trend, or nothing ("none") off first.
    """
    hanning = window is None
    count, nf = (signals[0].size - length) // step + 1, length // 2 + 1
    total = np.zeros((len(signals), len(signals), nf), dtype=np.complex128)
    weighted = np.zeros_like(total) if weigh is not None else np.zeros((1, 1, 1), dtype=np.complex128)
    squares = np.zeros(nf if weigh is not None else 1)
    window = hann(length) if window is None else window
    few = max(1, BLOCK_BYTES // (16 * nf * len(signals)))
    block = np.empty((len(signals), min(few, count), nf), dtype=np.complex128)
    room = np.empty((min(few, count), length))
    for first in range(0, count, few):
        k = min(few, count - first)
        for row, signal in enumerate(signals):
            part = signal[first * step : (first + k - 1) * step + length]
            segments = np.lib.stride_tricks.sliding_window_view(part, length)[::step]
            if hanning and detrend == "mean":
                np.multiply(segments, window, out=room[:k])
                np.fft.rfft(room[:k], axis=1, out=block[row, :k])
                means = _means(part, segments, step)  # a mean under a Hann window lies in the lines 0 and 1 alone
                block[row, :k, 0] -= (0.5 * length) * means
                block[row, :k, 1] += (0.25 * length) * means
            else:
                np.multiply(detrended(segments, detrend), window, out=room[:k])
                np.fft.rfft(room[:k], axis=1, out=block[row, :k])
        add_products(block[:, :k], -1 if weigh is None else weigh, total, weighted, squares)
    return total, weighted, squares


def _means(part: Array, segments: Array, step: int) -> Array:
    """Means (k,) of the segments (k, length) of `part`, from sums of what they share where steps fill a length."""
    length = segments.shape[1]
    if length % step:
        return np.asarray(segments.mean(axis=1))
    shared = part.reshape(-1, step).sum(axis=1)
    return np.asarray(np.convolve(shared, np.full(length // step, 1.0 / length), "valid"))


@compiled_in_line
def _product(x: complex, y: complex) -> complex:
    """x y*."""
    return complex(x.real * y.real + x.imag * y.imag, x.imag * y.real - x.real * y.imag)


@compiled
def add_products(block: ComplexArray, weigh: int, total: ComplexArray, weighted: ComplexArray, squares: Array) -> None:
    """Add x x^H of `block` (s, k, nf) to `total` (s, s, nf), upper triangle; weighted by |x[weigh]|² too if asked."""
    signals, segments, lines = block.shape
    for low in range(0, lines, NEAR):  # as many lines as stay in the nearest cache
        high = min(low + NEAR, lines)
        for a in range(signals):
            for b in range(a, signals):
                into = total[a, b, low:high]
                for k in range(0, segments - 3, 4):  # four at a time: half as many loads and stores
                    x0, y0 = block[a, k, low:high], block[b, k, low:high]
                    x1, y1 = block[a, k + 1, low:high], block[b, k + 1, low:high]
                    x2, y2 = block[a, k + 2, low:high], block[b, k + 2, low:high]
                    x3, y3 = block[a, k + 3, low:high], block[b, k + 3, low:high]
                    for f in range(high - low):
                        two = _product(x0[f], y0[f]) + _product(x1[f], y1[f])
                        into[f] += two + (_product(x2[f], y2[f]) + _product(x3[f], y3[f]))
                for k in range(segments - segments % 4, segments):
                    x0, y0 = block[a, k, low:high], block[b, k, low:high]
                    for f in range(high - low):
                        into[f] += _product(x0[f], y0[f])
    if weigh < 0:
        return
    for k in range(segments):
        n = block[weigh, k]
        for f in range(lines):
            w = n[f].real ** 2 + n[f].imag ** 2
            squares[f] += w * w
            for a in range(signals):
                for b in range(a, signals):
                    weighted[a, b, f] += w * block[a, k, f] * np.conj(block[b, k, f])
