"""Where the arm stands still: angle from pressures, pressures from angle, over whole maps."""

from __future__ import annotations

import numpy as np
from scipy.optimize import brentq

from loopshape.core.errors import WrongUseError
from loopshape.core.units import Array, deg, rad
from loopshape.toolbox.arm.dynamics.model import derivatives

LOWEST_BAR = 0.02


def acceleration(c: Array, angle_rad: float, p_a_bar: float, p_b_bar: float) -> float:
    """Angular acceleration in rad/s2 of the arm at rest."""
    state = (0.0, 1e5 * p_a_bar, 1e5 * p_b_bar, angle_rad, 0.0)
    return float(derivatives(c, state, (False, False, False, False))[3])


def pressures(c: Array, theta2_deg: float, p_ab_bar: float) -> tuple[float, float]:
    """Pressures (p_A, p_B) in bar that hold theta2 with the sum p_AB; (nan, nan) where none do."""
    angle = float(rad(theta2_deg))

    def unbalance(p_a: float) -> float:
        return acceleration(c, angle, p_a, p_ab_bar - p_a)

    low, high = LOWEST_BAR, p_ab_bar - LOWEST_BAR
    if high <= low or not unbalance(low) * unbalance(high) <= 0.0:  # nan is no sign change
        return float("nan"), float("nan")
    p_a = float(brentq(unbalance, low, high, xtol=1e-14, rtol=1e-14))
    return p_a, p_ab_bar - p_a


def angle_deg(c: Array, p_a_bar: float, p_b_bar: float, limit_deg: float = 45.0) -> float:
    """Angle theta2 in deg at which the pressures balance, nan where none does within the limit.

    Where there are several the arm would rest in the one nearest to zero; with the nominal parameters
    there is one.
    """
    grid = rad(np.linspace(-limit_deg, limit_deg, 91))
    torque = np.array([acceleration(c, float(q), p_a_bar, p_b_bar) for q in grid])
    crossings = np.flatnonzero(torque[:-1] * torque[1:] <= 0.0)
    if not crossings.size:
        return float("nan")
    k = int(crossings[np.argmin(np.abs(grid[crossings] + grid[crossings + 1]))])
    root = brentq(lambda q: acceleration(c, q, p_a_bar, p_b_bar), float(grid[k]), float(grid[k + 1]), xtol=1e-14)
    return float(deg(root))


def pressure_map(c: Array, theta2_deg: Array, p_ab_bar: Array) -> tuple[Array, Array]:
    """Pressures p_A and p_B (n, m) over theta2 (m,) and p_AB (n,); nan where there is no equilibrium."""
    pairs = np.array([[pressures(c, t, p) for t in theta2_deg] for p in p_ab_bar])
    return pairs[..., 0], pairs[..., 1]


def angle_map(c: Array, p_a_bar: Array, p_b_bar: Array) -> Array:
    """Angle theta2 in deg (n, m) over p_A (m,) and p_B (n,); nan where there is no equilibrium."""
    return np.array([[angle_deg(c, a, b) for a in p_a_bar] for b in p_b_bar])


def rest(c: Array, theta2_deg: float, p_ab_bar: float, p_c_pa: float) -> Array:
    """State (7,), SI, of the arm at rest; refuses an operating point without an equilibrium."""
    p_a, p_b = pressures(c, theta2_deg, p_ab_bar)
    if not np.isfinite(p_a):
        raise WrongUseError(
            "the arm has no equilibrium there",
            f"theta2 {theta2_deg:g} deg, p_AB {p_ab_bar:g} bar",
            "loopshape equilibria draws where it has",
        )
    angle = float(rad(theta2_deg))
    return np.array([p_c_pa, 1e5 * p_a, 1e5 * p_b, angle, 0.0, angle, 0.0])
