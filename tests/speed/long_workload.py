"""A long recording on disk: noise in closed loop at 10 kHz, three columns, estimated by segments of 20 s."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

import loopshape as ls
from loopshape.core import stretches
from loopshape.data.signal.experiment import LoopSetup
from loopshape.data.signal.recording import RecordingInfo
from loopshape.identify.frequency_response import estimate_frf
from loopshape.io.run.run_folder import check_recordings

RATE_HZ, ROWS, LENGTH, STEP = 10_000.0, 9_000_000, 200_000, 50_000
COLUMNS = ("n_v", "z_v", "y_m")


def written(folder: Path) -> Path:
    """A run of one recording of a quarter of an hour."""
    rng = np.random.default_rng(0)
    n = np.round(rng.standard_normal(ROWS), 3)
    y = np.convolve(n, 0.9 ** np.arange(60))[:ROWS] + 0.01 * np.round(rng.standard_normal(ROWS), 2)
    loop = LoopSetup("axis", None, "n_v", "z_v", "y_m", None)
    info = RecordingInfo("r.parquet", "noise", "controller_input", excites="axis")
    columns = dict(zip(COLUMNS, (n, n - 0.1 * y, y), strict=True))
    ls.write(ls.Run(RATE_HZ, (loop,), (ls.Recording(info, RATE_HZ, columns),)), folder)
    return folder


def ours(folder: Path) -> Callable[[], object]:
    """The look at the signals and the estimate, from the file."""
    assert ROWS >= stretches.LONG

    def go() -> None:
        run = ls.read(folder)
        check_recordings(run)
        estimate_frf(run.recordings[0], run.loop("axis"))

    return go


def reading_and_transforms(folder: Path) -> Callable[[], object]:
    """Nothing but reading each column once, and the bare transforms of as many segments of one block of numbers."""
    block = np.random.default_rng(1).standard_normal((1, LENGTH))
    out = np.empty((1, LENGTH // 2 + 1), dtype=complex)

    def go() -> None:
        columns = ls.read(folder).recordings[0]
        for name in COLUMNS:
            for _ in stretches.stretches(columns.signal(name)):
                pass
            for _ in range((ROWS - LENGTH) // STEP + 1):
                np.fft.rfft(block, axis=1, out=out)

    return go
