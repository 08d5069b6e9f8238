"""The FRF workload for benchmarks: two loops excited at once by noise, 20 minutes at 1 kHz, segments of 20 s."""

from __future__ import annotations

import tracemalloc
from collections.abc import Callable

import numpy as np
from scipy.signal import csd

import loopshape as ls
from loopshape.data.signal.recording import RecordingInfo
from loopshape.identify.local.local import by_local_fits
from loopshape.identify.settings import Settings
from loopshape.identify.spectra.welch import by_welch

RATE, MINUTES, LENGTH, STEP = 1000.0, 20, 20_000, 5_000


def signals(minutes: int = MINUTES) -> list[np.ndarray]:
    """Two outputs, two plant inputs, two instruments; what they hold does not matter to the time."""
    rng = np.random.default_rng(0)
    return [rng.standard_normal(round(60 * minutes * RATE)) for _ in range(6)]


def ours(six: list[np.ndarray]) -> Callable[[], object]:
    """The whole estimate: responses to both instruments with the covariance of all elements."""
    recording = ls.Recording(RecordingInfo("w.parquet", "noise", "plant_input", excites="a"), RATE, {})
    settings = Settings(method="welch", resolution_hz=RATE / LENGTH)
    return lambda: by_welch(recording, six[:4], six[4:], settings)


def pairwise(six: list[np.ndarray]) -> Callable[[], object]:
    """scipy.signal.csd for each pair that the responses need: each signal and instrument with each instrument."""

    def go() -> None:
        for a, x in enumerate(six):
            for b, n in enumerate(six[4:], start=4):
                if a <= b:
                    csd(n, x, RATE, "hann", LENGTH, LENGTH - STEP)

    return go


def bare_transforms(six: list[np.ndarray]) -> Callable[[], object]:
    """Nothing but the transforms of as many segments, of one block of numbers that stays in memory."""
    count = (six[0].size - LENGTH) // STEP + 1
    block = np.random.default_rng(1).standard_normal((8, LENGTH))
    out = np.empty((8, LENGTH // 2 + 1), dtype=complex)

    def go() -> None:
        for _ in six:
            for _ in range(-(-count // 8)):
                np.fft.rfft(block, axis=1, out=out)

    return go


def peak_megabytes(minutes: int) -> float:
    """Most memory that the estimate takes beside the record, in MB."""
    go = ours(signals(minutes))
    go()
    tracemalloc.start()
    go()
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    return 1e-6 * peak


def local(seconds: float = 60.0) -> tuple[Callable[[], object], Callable[[], object]]:
    """Local fits of a record of noise at 1 kHz, and the bare transforms of its three signals, a hundred times."""
    rng = np.random.default_rng(0)
    n, v = (rng.standard_normal(round(seconds * RATE)) for _ in range(2))
    y = np.convolve(n, 0.9 ** np.arange(60))[: n.size] + 0.01 * v
    recording = ls.Recording(RecordingInfo("w.parquet", "noise", "plant_input", excites="a"), RATE, {})
    signals, settings = [y, n - 0.1 * y], Settings(method="local")

    def bare() -> None:
        for _ in range(100):
            for x in (*signals, n):
                np.fft.rfft(x)

    return lambda: by_local_fits(recording, signals, [n], 1, settings), bare
