"""Section 4.3: stiffness by 4.11 from the arm's eigenfrequency, and what models of the muscle predict for it."""

from __future__ import annotations

from dataclasses import astuple, dataclass

import numpy as np
from muscle_law import LAWS, Digits, printed
from muscle_models import closed_slope, cylinder_volume

from loopshape.core.units import angular
from loopshape.toolbox.arm.dynamics.linear import linearise
from loopshape.toolbox.arm.parameters import ARM1_PARAMETERS, INERTIA, R_A, constants
from loopshape.toolbox.arm.source import number, value

ROWS = ("stiffness_b_bar", "stiffness_k0", "stiffness_k1", "stiffness_k2", "stiffness_c0", "stiffness_c1")
JZZ2 = {row.name: row.value for row in ARM1_PARAMETERS.rows}["jzz2_kgm2"]


def arm_constants(digits: Digits, absolute: bool) -> np.ndarray:
    """The arm with these digits and a gas law."""
    moves = dict(zip(ROWS, astuple(digits), strict=True)) | {"gas_absolute_share": 1.0 if absolute else 0.0}
    return constants(ARM1_PARAMETERS.vector(moves))


def joint_inertia() -> float:
    """m2 l12² + Jzz2 in kg m2: the inertia about joint 2."""
    return float(constants(ARM1_PARAMETERS.vector())[INERTIA])


def k_ab(f_hz: float, inertia: float) -> float:
    """k_A + k_B in N/m by 4.11."""
    lever = float(constants(ARM1_PARAMETERS.vector())[R_A])
    return float(angular(f_hz)) ** 2 * inertia / lever**2


def k_ab_rounding(key: str, inertia: float) -> tuple[float, float]:
    """Lowest and highest of it that a printed frequency leaves open."""
    f = number(key)
    return k_ab(f.value - f.half_digit, inertia), k_ab(f.value + f.half_digit, inertia)


def third_order(digits: Digits, absolute: bool, theta2_deg: float, p_ab_bar: float) -> tuple[float, float, float]:
    """kappa, f in Hz and zeta of the linearised arm (4.10)."""
    return linearise(arm_constants(digits, absolute), theta2_deg, p_ab_bar).third_order()


@dataclass(frozen=True)
class ArmReading:
    """Eigenfrequency at (0 deg, 1 bar) and (30 deg, 0.8 bar), zeta, kappa, k_AB by both inertias in kN/m."""

    what: str
    numbers: tuple[float, ...]


def arm_readings(
    nearest: Digits, misread: Digits, places: list[tuple[float, float]], at: tuple[float, float]
) -> list[ArmReading]:
    """What each reading of the muscle says of the arm; `misread` are digits of a fit to slopes with closed valves."""
    nan, f_measured = float("nan"), value("figure_4_12.f")
    source = [value(f"figure_{key}") for key in ("4_12.f", "4_15.measured.f", "4_12.zeta", "4_12.kappa")]
    simulated = [value(f"figure_{key}") for key in ("4_14.f", "4_15.simulated.f", "4_14.zeta", "4_14.kappa")]
    out = [_reading("measured", *source), _reading("the source's simulation", *simulated)]
    for name, digits in (("printed digits", printed()), ("digits nearest the bench", nearest), ("misread", misread)):
        for absolute in (False, True) if name != "misread" else (False,):
            (kappa, f, zeta), (_, f_30, _) = (third_order(digits, absolute, *place) for place in places)
            out.append(_reading(f"{name}, {LAWS[1 + absolute]} gas law", f, f_30, zeta, kappa))
    slopes = {
        "slope = k by printed digits": float(printed().stiffness(np.array(at[0]), np.array(at[1]))),
        "slope = k by digits nearest the bench": float(nearest.stiffness(np.array(at[0]), np.array(at[1]))),
        "slope by first principles": closed_slope(cylinder_volume, *at),
    }
    for name, k in slopes.items():
        f = f_measured * np.sqrt(2.0 * k / k_ab(f_measured, joint_inertia()))
        out.append(_reading(name, float(f), nan, nan, nan))
    return out


def _reading(what: str, f: float, f_30: float, zeta: float, kappa: float) -> ArmReading:
    both = 1e-3 * k_ab(f, joint_inertia()), 1e-3 * k_ab(f, JZZ2)
    return ArmReading(what, (f, f_30, zeta, kappa, *both))
