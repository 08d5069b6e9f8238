"""From transforms to responses with their covariance, one instrument at a time.

With Y, U, N the transforms of output, plant input and instrument, G = sum(Y N*)/sum(U N*): what N did not
cause averages out, in closed loop too (van den Hof and Schrama 1993; the source's 4.9 and H.6). The error
is sum(E N*)/sum(U N*) with E = Y - G U, and its variance follows from the E that the segments show.
"""

from __future__ import annotations

import numpy as np
from scipy.ndimage import uniform_filter1d
from scipy.special import digamma

from loopshape.core.units import Array, ComplexArray
from loopshape.data.response.frf import FRF
from loopshape.identify.spectra.transforms import Transforms
from loopshape.identify.tolerances import TOL


def against_instrument(t: Transforms) -> ComplexArray:
    """Response (nf, signals) of each signal to the instrument, sum(X N*)/sum(N N*)."""
    power = (np.abs(t.instrument) ** 2).sum(0)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(np.einsum("skf,kf->fs", t.signals, t.instrument.conj()) / power[:, None])


def line_covariance(
    scatter: ComplexArray, averages: Array, squared: Array, excited: np.ndarray, overlap: float
) -> tuple[ComplexArray, float, int]:
    """Covariance (nf, m, m) of a passing sweep's answers, its degrees of freedom, and over how many lines it is pooled.

    `scatter` (nf, m, m) is the sum of |N|² E E^H, smoothed over five lines, `averages` (nf,) the effective number of
    segments that carry a line, `squared` (nf,) the squared sum of |N|² times the averages a segment counts for.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        median = float(np.median(averages[excited])) if excited.any() else 1.5
        freedom = 2.0 * max(median - 1.0, 0.5) * 5 / overlap
        unbiased = np.where(averages > 1.5, averages / (averages - 1.0), np.inf)
        return np.asarray(scatter * (unbiased / squared)[:, None, None]), freedom, 5


def smoothed(power: ComplexArray, half: int) -> ComplexArray:
    """Moving mean over `half` neighbouring lines on each side."""
    if half == 0 or power.shape[0] < 2:
        return power
    padded = np.pad(power, ((half, half), (0, 0), (0, 0)), mode="reflect" if power.shape[0] > half else "edge")
    return np.asarray(np.lib.stride_tricks.sliding_window_view(padded, 2 * half + 1, axis=0).mean(-1))


def pooled_variance(frf: FRF) -> Array:
    """Variance E|d|² (nf,) of the lines, pooled over neighbours (41 at most) until it has 60 degrees of freedom.

    Few periods know each line's variance badly; weights made of it would prefer the lines that look calm by luck. What
    is pooled are logarithms, bias-corrected (E ln of a chi-square over its freedom n is digamma(n/2) - ln(n/2)),
    of the variance or of its share of |P|², whichever is the flatter about a line.
    """
    v, freedom = np.array(frf.variance[:, 0, 0]), frf.variance_freedom
    if freedom >= TOL.decided_freedom or not v.any():
        return v
    window = min(int(np.ceil(TOL.decided_freedom / freedom)) * frf.variance_pooled, 41, v.size)
    ln_v = np.log(np.maximum(v, 1e-12 * np.median(v) + 1e-300))
    means, misses = [], []
    for base in (np.zeros(v.size), np.log(np.abs(frf.siso) ** 2 + 1e-300)):
        mean = uniform_filter1d(ln_v - base, window, mode="nearest")
        means.append(mean + base)
        misses.append(uniform_filter1d((ln_v - base - mean) ** 2, window, mode="nearest"))
    half = 0.5 * freedom
    return np.asarray(np.exp(np.where(misses[0] <= misses[1], *means) - digamma(half) + np.log(half)))
