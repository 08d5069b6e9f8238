"""From transforms to responses with their covariance, one instrument at a time.

With Y, U, N the transforms of output, plant input and instrument, G = sum(Y N*)/sum(U N*): what N did not
cause averages out, in closed loop too (van den Hof and Schrama 1993; the source's 4.9 and H.6). The error
is sum(E N*)/sum(U N*) with E = Y - G U, and its variance follows from the E that the segments show.
"""

from __future__ import annotations

import numpy as np

from loopshape.estimate.transforms import Transforms
from loopshape.units import Array, ComplexArray


def against_instrument(t: Transforms) -> ComplexArray:
    """Response (nf, signals) of each signal to the instrument, sum(X N*)/sum(N N*)."""
    power = (np.abs(t.instrument) ** 2).sum(0)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(np.einsum("skf,kf->fs", t.signals, t.instrument.conj()) / power[:, None])


def error_covariance(t: Transforms, residual: ComplexArray) -> ComplexArray:
    """Covariance (nf, m, m) of sum(E N*)/sum(N N*) for residuals E (m, k, nf).

    Where every segment carries the same excitation (noise, periods) the noise is pooled over all. Where a
    sweep passes, each segment's residual counts with its own excitation, which follows disturbances that
    come with the sweep; the number of averages is then per line, and a line carried by less than about one
    and a half gets an infinite variance.
    """
    nn = np.abs(t.instrument) ** 2
    k = nn.shape[0]
    with np.errstate(divide="ignore", invalid="ignore"):
        if t.stationary:
            averages = np.full(nn.shape[1], k * t.independent)
            scatter = np.einsum("akf,bkf->fab", residual, residual.conj()) / k * nn.sum(0)[:, None, None]
        else:
            averages = t.independent * nn.sum(0) ** 2 / (nn**2).sum(0)
            scatter = _smooth(np.einsum("akf,bkf,kf->fab", residual, residual.conj(), nn))
        freedom = np.where(averages > 1.5, averages / (averages - 1.0), np.inf)
        scale = freedom / (t.independent * nn.sum(0) ** 2)
        return np.asarray(scatter * scale[:, None, None])


def _smooth(power: ComplexArray, half: int = 2) -> ComplexArray:
    """Moving mean over neighbouring lines: a handful of segments alone would make a ragged variance."""
    width = 2 * half + 1
    padded = np.pad(power, ((half, half), (0, 0), (0, 0)), mode="edge")
    return np.asarray(np.lib.stride_tricks.sliding_window_view(padded, width, axis=0).mean(-1))


def coherence(Y: ComplexArray, U: ComplexArray) -> Array:
    """Ordinary coherence (nf,) of two signals' transforms (k, nf), between 0 and 1."""
    cross = (Y * U.conj()).sum(0)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(np.abs(cross) ** 2 / ((np.abs(Y) ** 2).sum(0) * (np.abs(U) ** 2).sum(0)))


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
