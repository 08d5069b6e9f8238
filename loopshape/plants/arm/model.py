"""Right-hand side of the 1-DoF arm: capacity, splitter, two muscles, one body. SI, gauge pressures in Pa.

States: p_c, p_A, p_B, theta2, its velocity. Equation numbers are the source's (see `parameters`).
"""

from __future__ import annotations

import math

from loopshape.kernels.compiled import compiled_in_line
from loopshape.plants.arm import parameters as k
from loopshape.units import Array


@compiled_in_line
def flow(beta: float, p1: float, p2: float, p_atm2: float) -> float:
    """Throttle flow (3.16) in kg/s from p1 to p2; `beta` holds the root of 1/(2 R T)."""
    drop = p1 - p2
    return math.copysign(beta * math.sqrt((p1 + p2 + p_atm2) * abs(drop)), drop)


@compiled_in_line
def supply_flows(c: Array, p_c: float, p_a: float, p_b: float, in_a: bool, in_b: bool) -> tuple[float, float]:
    """Flows through the splitter into A and B (3.28-3.34).

    With both open the muscle farther from p_c sets the throttle's drop, and the shares go by the
    differences over the sum of their sizes: (3.33) where both lie below p_c, bounded where one does not.
    """
    if in_a and in_b:
        drop_a, drop_b = p_c - p_a, p_c - p_b
        total = abs(drop_a) + abs(drop_b)
        if total == 0.0:
            return 0.0, 0.0
        p_s = p_a if abs(drop_a) > abs(drop_b) else p_b
        size = abs(flow(c[k.BETA_S], p_c, p_s, c[k.P_ATM2])) / total
        return size * drop_a, size * drop_b
    if in_a:
        return flow(c[k.BETA_S], p_c, p_a, c[k.P_ATM2]), 0.0
    if in_b:
        return 0.0, flow(c[k.BETA_S], p_c, p_b, c[k.P_ATM2])
    return 0.0, 0.0


@compiled_in_line
def muscle(c: Array, p: float, h: float, dh: float, factor: float) -> tuple[float, float, float]:
    """Pull F in N, volume V in m3 and dV/dh in m2 of a muscle of length h (3.36-3.52, 4.5)."""
    root = math.sqrt(c[k.FOUR_L2] - h * h)
    d2 = root / c[k.N_PI]
    area = c[k.D1_SQ3] + d2 * (c[k.D1_X4] + 8.0 * d2)
    volume = 0.05235987755982988 * h * area
    slope = 0.05235987755982988 * (area - h * (c[k.D1_X4] + 16.0 * d2) * h / (c[k.N_PI] * root))
    bar = 1e-5 * p
    # stiffness (4.5) as one polynomial in h whose coefficients depend on p
    stiffness = (c[k.BK0] + bar * c[k.K0]) + h * ((c[k.BK1] + bar * c[k.K1]) + h * (c[k.BK2] + bar * c[k.K2]))
    nominal = c[k.TWO_L] - c[k.S1] * bar / (c[k.S2] + bar)
    pull = factor * stiffness * (h - nominal) + (c[k.D0] + c[k.D1] * bar) * dh
    return pull, volume, slope


@compiled_in_line
def derivatives(
    c: Array,
    p_c: float,
    p_a: float,
    p_b: float,
    angle: float,
    velocity: float,
    in_a: bool,
    in_b: bool,
    out_a: bool,
    out_b: bool,
) -> tuple[float, float, float, float]:
    """d p_c, d p_A, d p_B in Pa/s and the angular acceleration in rad/s2; an open out valve overrules."""
    sine, cosine = math.sin(angle), math.cos(angle)
    xa, ya = c[k.X] - c[k.R_A] * sine, c[k.YA] + c[k.R_A] * cosine
    xb, yb = c[k.X] - c[k.R_B] * sine, c[k.YB] + c[k.R_B] * cosine
    length_a, length_b = math.sqrt(xa * xa + ya * ya), math.sqrt(xb * xb + yb * yb)
    lever_a = c[k.R_A] * (c[k.YA] * sine + c[k.X] * cosine) / length_a  # -dh/dtheta
    lever_b = c[k.R_B] * (c[k.YB] * sine + c[k.X] * cosine) / length_b
    dh_a, dh_b = -lever_a * velocity, -lever_b * velocity
    pull_a, volume_a, slope_a = muscle(c, p_a, length_a - c[k.FITTING], dh_a, c[k.FACTOR_A])
    pull_b, volume_b, slope_b = muscle(c, p_b, length_b - c[k.FITTING], dh_b, c[k.FACTOR_B])

    q_a, q_b = supply_flows(c, p_c, p_a, p_b, in_a and not out_a, in_b and not out_b)
    q_in = flow(c[k.BETA_IN], c[k.P_IN], p_c, c[k.P_ATM2])
    d_p_c = c[k.RT] * (q_in - (q_a + q_b)) / c[k.V_C]
    if out_a:
        q_a -= flow(c[k.BETA_OUT], p_a, 0.0, c[k.P_ATM2])
    if out_b:
        q_b -= flow(c[k.BETA_OUT], p_b, 0.0, c[k.P_ATM2])
    d_p_a = c[k.EXPONENT] * (c[k.RT] * q_a - (p_a + c[k.ABSOLUTE]) * slope_a * dh_a) / volume_a
    d_p_b = c[k.EXPONENT] * (c[k.RT] * q_b - (p_b + c[k.ABSOLUTE]) * slope_b * dh_b) / volume_b
    torque = c[k.GRAVITY] * sine + pull_a * lever_a + pull_b * lever_b
    return d_p_c, d_p_a, d_p_b, torque / c[k.INERTIA]
