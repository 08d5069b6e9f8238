"""Which frequencies of an estimate are fit for use: the valid band, by their relative standard deviation."""

from __future__ import annotations

import numpy as np

from loopshape.core.units import Array

#: a line is known where its relative standard deviation is below the first; a gap up to the second is bridged
KNOWN, BRIDGED = 0.1, 0.3


def trusted_lines(frequency_hz: Array, relative_std: Array, excited: np.ndarray) -> np.ndarray:
    """Lines of the widest band (in octaves) that is known to 10 %, as a mask (nf,).

    A moving median over five lines decides. Within the band no excited line is left out: a resonance between
    known lines is often the least known, and a check must not overlook it; stretches known to 30 % only are
    bridged for its sake.
    """
    relative = np.where(np.isfinite(relative_std), relative_std, np.inf)
    padded = np.pad(relative, 2, mode="edge")
    median = np.median(np.lib.stride_tricks.sliding_window_view(padded, 5), axis=1)
    mask = np.zeros(relative.size, dtype=bool)
    best = 0.0
    for start, end in _stretches((median <= BRIDGED) & excited):
        known = start + np.flatnonzero(median[start:end] <= KNOWN)
        if known.size and (width := np.log2(frequency_hz[known[-1]] / frequency_hz[known[0]]) + 1e-9) > best:
            best = float(width)
            mask[:] = False
            mask[known[0] : known[-1] + 1] = True
    return np.asarray(mask & excited & np.isfinite(relative_std))


def _stretches(mask: np.ndarray) -> list[tuple[int, int]]:
    """Starts and ends (exclusive) of the runs of True."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], mask.astype(int), [0]])))
    return list(zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True))
