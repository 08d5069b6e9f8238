"""Where the 2-DoF arm stands still: p_B and p_D from both angles, p_A and p_C."""

from __future__ import annotations

import numpy as np
from scipy.optimize import brentq

from loopshape.errors import WrongUseError
from loopshape.plants.arm.model2 import standing_torques
from loopshape.units import Array, rad

LOWEST_BAR, HIGHEST_BAR = 0.02, 3.0
_B, _D = 2, 4  # places of p_B and p_D in a state


def pressures2(
    c: Array, theta1_deg: float, theta2_deg: float, p_a_bar: float, p_c_bar: float
) -> tuple[float, float, float, float]:
    """Pressures (p_A, p_B, p_C, p_D) in bar that hold both angles with these p_A and p_C.

    A and B alone balance joint 2, C and D joint 1, so each missing one is the root of one torque between 0.02 and
    3 bar; nan where there is none.
    """
    p_a, p_c = 1e5 * p_a_bar, 1e5 * p_c_bar
    x = np.array([0.0, p_a, p_a, p_c, p_c, float(rad(theta1_deg)), float(rad(theta2_deg)), 0.0, 0.0])
    return p_a_bar, _balancing(c, x, _B, 1), p_c_bar, _balancing(c, x, _D, 0)


def _balancing(c: Array, x: Array, place: int, joint: int) -> float:
    def unbalance(p_bar: float) -> float:
        trial = x.copy()
        trial[place] = 1e5 * p_bar
        return float(standing_torques(c, trial)[joint])

    if not unbalance(LOWEST_BAR) * unbalance(HIGHEST_BAR) <= 0.0:  # nan is no sign change
        return float("nan")
    return float(brentq(unbalance, LOWEST_BAR, HIGHEST_BAR, xtol=1e-14, rtol=1e-14))


def rest2(
    c: Array, theta1_deg: float, theta2_deg: float, p_a_bar: float, p_c_bar: float, p_capacity_pa: float
) -> Array:
    """State (9,), SI, of the arm at rest; refuses an operating point without an equilibrium."""
    four = pressures2(c, theta1_deg, theta2_deg, p_a_bar, p_c_bar)
    if not np.all(np.isfinite(four)):
        raise WrongUseError(
            "the 2-DoF arm has no equilibrium there",
            f"theta1 {theta1_deg:g} deg, theta2 {theta2_deg:g} deg, p_A {p_a_bar:g} bar, p_C {p_c_bar:g} bar",
            "choose smaller angles, or pressures between 0.15 and 1.2 bar",
        )
    angles = [float(rad(theta1_deg)), float(rad(theta2_deg))]
    return np.array([p_capacity_pa, *(1e5 * p for p in four), *angles, 0.0, 0.0])
