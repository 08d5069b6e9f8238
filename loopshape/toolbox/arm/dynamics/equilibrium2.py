"""Where the 2-DoF arm stands still: all four pressures from both angles and p_A and p_C, or the sums of both pairs."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from scipy.optimize import brentq

from loopshape.core.errors import WrongUseError
from loopshape.core.units import Array, rad
from loopshape.toolbox.arm.dynamics.model2 import standing_torques

LOWEST_BAR, HIGHEST_BAR = 0.02, 3.0
_A, _B, _C, _D = 1, 2, 3, 4  # places of the muscles' pressures in a state


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


def pair_pressures2(
    c: Array, theta1_deg: float, theta2_deg: float, p_ab_bar: float, p_cd_bar: float
) -> tuple[float, float, float, float]:
    """As `pressures2` from the sums p_AB = p_A + p_B and p_CD = p_C + p_D; each pressure at least 0.02 bar."""
    x = np.array([0.0, 0.0, 0.0, 0.0, 0.0, float(rad(theta1_deg)), float(rad(theta2_deg)), 0.0, 0.0])
    p_a = _sharing(c, x, (_A, _B), p_ab_bar, 1)
    p_c = _sharing(c, x, (_C, _D), p_cd_bar, 0)
    return p_a, p_ab_bar - p_a, p_c, p_cd_bar - p_c


def _sharing(c: Array, x: Array, places: tuple[int, int], sum_bar: float, joint: int) -> float:
    """Pressure in bar of a pair's first muscle, with which both together balance their joint; nan where none does."""

    def unbalance(p_bar: float) -> float:
        trial = x.copy()
        trial[list(places)] = 1e5 * p_bar, 1e5 * (sum_bar - p_bar)
        return float(standing_torques(c, trial)[joint])

    return _root(unbalance, LOWEST_BAR, sum_bar - LOWEST_BAR)


def _root(unbalance: Callable[[float], float], low: float, high: float) -> float:
    if not (high > low and unbalance(low) * unbalance(high) <= 0.0):  # nan is no sign change
        return float("nan")
    return float(brentq(unbalance, low, high, xtol=1e-14, rtol=1e-14))


def _balancing(c: Array, x: Array, place: int, joint: int) -> float:
    def unbalance(p_bar: float) -> float:
        trial = x.copy()
        trial[place] = 1e5 * p_bar
        return float(standing_torques(c, trial)[joint])

    return _root(unbalance, LOWEST_BAR, HIGHEST_BAR)


def rest2(
    c: Array, theta1_deg: float, theta2_deg: float, p_a_bar: float, p_c_bar: float, p_capacity_pa: float
) -> Array:
    """State (9,), SI, of the arm at rest; refuses an operating point without an equilibrium."""
    four = pressures2(c, theta1_deg, theta2_deg, p_a_bar, p_c_bar)
    return resting(four, theta1_deg, theta2_deg, p_capacity_pa, f"p_A {p_a_bar:g} bar, p_C {p_c_bar:g} bar")


def pair_rest2(
    c: Array, theta1_deg: float, theta2_deg: float, p_ab_bar: float, p_cd_bar: float, p_capacity_pa: float
) -> Array:
    """As `rest2` from the sums of both pairs."""
    four = pair_pressures2(c, theta1_deg, theta2_deg, p_ab_bar, p_cd_bar)
    return resting(four, theta1_deg, theta2_deg, p_capacity_pa, f"p_AB {p_ab_bar:g} bar, p_CD {p_cd_bar:g} bar")


def resting(four_bar: Sequence[float], theta1_deg: float, theta2_deg: float, p_capacity_pa: float, asked: str) -> Array:
    """State (9,), SI, at rest with these pressures of A to D; refuses those that are none, which `asked` led to."""
    if not np.all(np.isfinite(four_bar)):
        raise WrongUseError(
            "the 2-DoF arm has no equilibrium there",
            f"theta1 {theta1_deg:g} deg, theta2 {theta2_deg:g} deg, {asked}",
            "choose smaller angles, or pressures between 0.15 and 1.2 bar",
        )
    angles = [float(rad(theta1_deg)), float(rad(theta2_deg))]
    return np.array([p_capacity_pa, *(1e5 * p for p in four_bar), *angles, 0.0, 0.0])
