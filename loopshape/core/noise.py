"""The noise of a sensor, from a recording of a moving machine; how sure a rms is."""

from __future__ import annotations

import numpy as np
from scipy.special import gammaincinv

from loopshape.core.units import Array


def noise_rms(values: Array) -> float:
    """White noise's rms from third differences, in which a smooth signal vanishes; the median of blocks (Rice 1984).

    Not below the noise of rounding to the smallest step that occurs.
    """
    third = np.diff(values, 3)
    n = third.size // 50 * 50
    squares = np.mean((third[:n] ** 2).reshape(-1, 50), axis=1)
    steps = np.abs(np.diff(values))
    steps = steps[steps > 1e-9 * np.ptp(values)] if np.ptp(values) > 0.0 else np.array([1e-9])
    rounding = float(np.min(steps)) / np.sqrt(12.0)
    return max(float(np.sqrt(np.median(squares) / 20.0)), rounding, 1e-12)


def rms_interval(power: float, variance: float) -> tuple[float, float]:
    """95 % interval of a rms, from the mean square and its variance, as that of chi square with their ratio."""
    if power <= 0.0 or variance <= 0.0:
        return float(np.sqrt(max(power, 0.0))), float(np.sqrt(max(power, 0.0)))
    freedom = 2.0 * power**2 / variance
    low, high = (float(np.sqrt(0.5 * power * freedom / gammaincinv(0.5 * freedom, level))) for level in (0.975, 0.025))
    return low, high
