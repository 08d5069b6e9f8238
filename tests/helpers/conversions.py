"""Units as tests convert them: by numpy alone, so that what the package converts is held to something else."""

import numpy as np
from numpy.typing import NDArray

TWO_PI = 2.0 * np.pi

Array = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]

deg, rad = np.rad2deg, np.deg2rad


def angular(f_hz):
    """Rad/s from Hz."""
    return 2.0 * np.pi * np.asarray(f_hz, dtype=float)


def hz(w_rad_s):
    """Hz from rad/s."""
    return w_rad_s / (2.0 * np.pi)


def db(ratio):
    """20 log10 of a magnitude; -inf for zero."""
    with np.errstate(divide="ignore"):
        return 20.0 * np.log10(np.abs(ratio))


def from_db(decibel):
    """Magnitude from dB."""
    return np.power(10.0, np.divide(decibel, 20.0))
