"""Variances of an FRF's lines, pooled over neighbours where few degrees of freedom know them."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import uniform_filter1d
from scipy.special import digamma

from loopshape.core.units import Array
from loopshape.data.response.frf import FRF

#: a variance with fewer degrees of freedom is pooled with its neighbours' until it has as many
FREEDOM = 60.0


def pooled_variance(frf: FRF) -> Array:
    """Variance E|d|² (nf,) of the lines, pooled over neighbours (41 at most) until it has 60 degrees of freedom.

    Few periods know each line's variance badly; weights made of it would prefer the lines that look calm by luck. What
    is pooled are logarithms, freed of their bias (E ln of a chi-square over its freedom n is digamma(n/2) - ln(n/2)),
    of the variance or of its share of |P|², whichever is the flatter about a line.
    """
    v, freedom = np.array(frf.variance[:, 0, 0]), frf.variance_freedom
    if freedom >= FREEDOM or not v.any():
        return v
    reach = min(int(np.ceil(FREEDOM / freedom)) * frf.variance_pooled, 41, v.size)
    ln_v = np.log(np.maximum(v, 1e-12 * np.median(v) + 1e-300))
    means, misses = [], []
    for base in (np.zeros(v.size), np.log(np.abs(frf.siso) ** 2 + 1e-300)):
        mean = uniform_filter1d(ln_v - base, reach, mode="nearest")
        means.append(mean + base)
        misses.append(uniform_filter1d((ln_v - base - mean) ** 2, reach, mode="nearest"))
    half = 0.5 * freedom
    return np.asarray(np.exp(np.where(misses[0] <= misses[1], *means) - digamma(half) + np.log(half)))
