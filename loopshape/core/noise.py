"""The noise of a sensor, from a recording of a moving machine."""

from __future__ import annotations

import numpy as np

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
