"""Units: Hz and rad/s, degrees and radians, dB and ratios, and what a column's suffix means.

Conversions are done here and nowhere else. Inside the project a quantity is SI or bar, as its name says
(`_hz`, `_rad`, `_deg`, `_bar`, `_v`); `to_stored` brings a user's unit to the stored one at the door.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from loopshape.core.errors import WrongUseError

TWO_PI = 2.0 * np.pi
DEG_PER_RAD = 180.0 / np.pi

Array = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]

#: suffix of a stored column -> units that a user may name, with their factors to the stored one
_BY_SUFFIX: dict[str, dict[str, float]] = {
    "s": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9},
    "rad": {"rad": 1.0, "mrad": 1e-3, "deg": 1.0 / DEG_PER_RAD, "rev": TWO_PI},
    "rad_s": {"rad/s": 1.0, "deg/s": 1.0 / DEG_PER_RAD, "rpm": TWO_PI / 60.0},
    "bar": {"bar": 1.0, "mbar": 1e-3, "Pa": 1e-5, "kPa": 1e-2, "MPa": 10.0, "psi": 0.0689475729},
    "v": {"V": 1.0, "mV": 1e-3},
    "a": {"A": 1.0, "mA": 1e-3},
    "n": {"N": 1.0, "kN": 1e3},
    "nm": {"N m": 1.0, "Nm": 1.0},
    "m": {"m": 1.0, "mm": 1e-3, "um": 1e-6, "nm": 1e-9},
    "m_s": {"m/s": 1.0},
    "m_s2": {"m/s2": 1.0, "g": 9.80665},
    "1": {"1": 1.0},
}
#: unit a user may name -> (suffix of the stored column, factor to the stored unit)
UNITS = {unit: (suffix, factor) for suffix, units in _BY_SUFFIX.items() for unit, factor in units.items()}

#: suffix of a stored column -> how the unit is written on an axis
SUFFIXES: dict[str, str] = {
    "rad_s": "rad/s", "m_s2": "m/s²", "m_s": "m/s", "rad": "rad", "bar": "bar", "nm": "N m",
    "s": "s", "v": "V", "a": "A", "n": "N", "m": "m", "1": "1",
}  # fmt: skip


_KNOWN = ", ".join(UNITS)
_NO_UNIT = {"hz": "a speed is rad/s or rpm, and a rate stands in rate_hz; ", "%": "write 1, with gain = 0.01; "}


def _meant(unit: str) -> str:
    """What a word that is no unit may have been meant for, as the beginning of a cure; "" where that is not known."""
    if unit.lower() in _NO_UNIT:
        return _NO_UNIT[unit.lower()]
    like = [known for known in UNITS if known.lower() in (unit.lower(), unit.lower().rstrip("s"), unit[:1].lower())]
    return f"{like[0]!r} perhaps; " if like else ""


def to_stored(unit: str) -> tuple[str, float]:
    """Suffix and factor that bring a user's unit to the stored one; refuses a unit it does not know."""
    if unit not in UNITS:
        raise WrongUseError(
            "a unit is not known", f"{unit!r}", f"{_meant(unit)}use one of {_KNOWN} (1 is dimensionless)"
        )
    return UNITS[unit]


def angular(frequency_hz: ArrayLike) -> Array:
    """Rad/s from Hz."""
    return TWO_PI * np.asarray(frequency_hz, dtype=float)


def hz(angular_rad_s: float) -> float:
    """Hz from rad/s."""
    return float(angular_rad_s) / TWO_PI


def deg(rad: ArrayLike) -> Array:
    """Degrees from radians."""
    return np.asarray(rad, dtype=float) * DEG_PER_RAD


def rad(degrees: ArrayLike) -> Array:
    """Radians from degrees."""
    return np.asarray(degrees, dtype=float) / DEG_PER_RAD


def db(ratio: ArrayLike) -> Array:
    """20 log10 of a magnitude; zero becomes -inf without a warning."""
    with np.errstate(divide="ignore"):
        return 20.0 * np.log10(np.abs(np.asarray(ratio)))


def from_db(decibel: ArrayLike) -> Array:
    """Magnitude from dB."""
    return 10.0 ** (np.asarray(decibel, dtype=float) / 20.0)
