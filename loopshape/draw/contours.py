"""Curves of constant |S| and |T| in Nichols coordinates: open-loop phase in degrees, magnitude in dB."""

from __future__ import annotations

import numpy as np

from loopshape.units import TWO_PI, Array, ComplexArray, db, deg, from_db


def constant_s(sensitivity_db: float, points: int = 721) -> ComplexArray:
    """Open loops L (points,) with |S| = 1/|1 + L| at a level: a circle around -1, from phase -360 round to 0."""
    edge = 1e-9 if sensitivity_db <= 0.0 else 0.0  # circles around the origin too stay open at its phase jump
    turn = np.linspace(edge, TWO_PI - edge, points)
    return np.asarray(-1.0 + np.exp(1j * turn) / from_db(sensitivity_db))


def constant_t(complementary_db: float, points: int = 721) -> ComplexArray:
    """Open loops L (points,) with |T| = |L|/|1 + L| at a level."""
    edge = 1e-9 if complementary_db <= 0.0 else 0.0
    t = from_db(complementary_db) * np.exp(1j * np.linspace(edge, TWO_PI - edge, points))
    return np.asarray(t / (1.0 - t))


def nichols_coordinates(open_loop: ComplexArray) -> tuple[Array, Array]:
    """Phase in (-360, 0] degrees and magnitude in dB."""
    phase = deg(np.angle(open_loop))
    return np.where(phase > 0.0, phase - 360.0, phase), db(open_loop)


def turns(low_deg: float, high_deg: float) -> list[float]:
    """Whole turns by which something around -180 degrees is repeated to fill a range of phases."""
    first, last = np.floor((low_deg + 180.0) / 360.0), np.ceil((high_deg + 180.0) / 360.0)
    return [360.0 * k for k in range(int(first), int(last) + 1)]
