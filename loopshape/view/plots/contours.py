"""Constant |S| and |T| and error circles in Nichols coordinates: open-loop phase in degrees, magnitude in dB."""

from __future__ import annotations

import numpy as np

from loopshape.core.units import TWO_PI, Array, ComplexArray, db, deg, from_db

#: radius that holds 95 % of a circular error, in its standard deviations sqrt(E|d|²)
REACH_95 = float(np.sqrt(-np.log(0.05)))


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


def error_region(centre: complex, deviation: float, phase_deg: float, points: int = 73) -> tuple[Array, Array]:
    """Edge (points,) of the 95 % region of a response with a circular error: phase in degrees and magnitude in dB.

    A circle about `centre` of 1.73 times `deviation` = sqrt(E|d|²), carried over point by point: in these coordinates
    it is bent, not an ellipse. `phase_deg` is the centre's own phase on the branch wanted. Where the circle holds the
    origin the phase is not known: the edge is then nan.
    """
    if REACH_95 * deviation >= abs(centre):
        return np.full(points, np.nan), np.full(points, np.nan)
    edge = centre + REACH_95 * deviation * np.exp(1j * np.linspace(0.0, TWO_PI, points))
    return phase_deg + deg(np.angle(edge / centre)), db(edge)
