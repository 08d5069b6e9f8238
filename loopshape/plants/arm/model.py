"""Right-hand side of the 1-DoF arm: capacity, splitter, two muscles, one body. SI, gauge pressures in Pa.

States: p_c, p_A, p_B, theta2, its velocity, and angle and velocity of what lies beyond a flexible coupling. Valves are
open areas from 0 to 1. Equation numbers are the source's (see `parameters`). What remembers (friction, creep, a line)
is held over a step by `memory`.
"""

from __future__ import annotations

import math

import numpy as np

from loopshape.kernels.compiled import compiled, compiled_in_line
from loopshape.plants.arm import effect_parameters as e
from loopshape.plants.arm import parameters as k
from loopshape.units import Array

#: what `memory` holds over a step: torque, its slope over the angle from there, creep (m), flows into A and B, from the
#: supply, drop of the supply (Pa), Coulomb torque, drop behind the capacity (Pa)
TORQUE, SLOPE, FROM, CREEP_A, CREEP_B, LINE_A, LINE_B, DRAIN, DROP, COULOMB, SPLIT = range(11)
HELD = 11


LEAK_PA = 5e4  # where a laminar leak equals the orifice


@compiled_in_line
def flow(c: Array, beta: float, p1: float, p2: float) -> float:
    """Throttle flow (3.16) in kg/s from p1 to p2; `beta` holds the root of 1/(2 R T)."""
    drop = p1 - p2
    return math.copysign(beta * math.sqrt((p1 + p2 + c[k.P_ATM2]) * abs(drop)), drop)


@compiled
def choked(c: Array, beta: float, p1: float, p2: float) -> float:
    """As `flow`, by ISO 6358-1's ellipse with a critical ratio of pressures."""
    high, low = max(p1, p2) + 0.5 * c[k.P_ATM2], min(p1, p2) + 0.5 * c[k.P_ATM2]
    bend = max(low / high - c[e.CRITICAL], 0.0) / (1.0 - c[e.CRITICAL])
    return math.copysign(beta * c[e.CONDUCTANCE] * high * math.sqrt(1.0 - bend * bend), p1 - p2)


@compiled_in_line
def throttle(c: Array, beta: float, p1: float, p2: float) -> float:
    """Whichever of both holds."""
    return flow(c, beta, p1, p2) if c[e.CRITICAL] == 0.0 else choked(c, beta, p1, p2)


@compiled_in_line
def supply_flows(c: Array, p_c: float, p_a: float, p_b: float, in_a: float, in_b: float) -> tuple[float, float]:
    """Flows through the splitter into A and B (3.28-3.34), in-valves open to 0..1.

    With both open the muscle farther from p_c sets the throttle's drop, and the shares go by the
    differences over the sum of their sizes: (3.33) where both lie below p_c, bounded where one does not.
    """
    if in_a > 0.0 and in_b > 0.0:
        drop_a, drop_b = p_c - p_a, p_c - p_b
        total = abs(drop_a) + abs(drop_b)
        if total == 0.0:
            return 0.0, 0.0
        p_s = p_a if abs(drop_a) > abs(drop_b) else p_b
        size = abs(throttle(c, c[k.BETA_S], p_c, p_s)) / total
        return in_a * (size * drop_a), in_b * (size * drop_b)
    if in_a > 0.0:
        return in_a * throttle(c, c[k.BETA_S], p_c, p_a), 0.0
    if in_b > 0.0:
        return 0.0, in_b * throttle(c, c[k.BETA_S], p_c, p_b)
    return 0.0, 0.0


@compiled_in_line
def leak(c: Array, beta: float, p: float) -> float:
    """Flow in kg/s out of a muscle at p: orifice, or laminar and equal to the orifice at 0.5 bar."""
    if c[e.LAMINAR] > 0.0:
        return beta * p * (p + c[k.P_ATM2]) / math.sqrt((LEAK_PA + c[k.P_ATM2]) * LEAK_PA)
    return flow(c, beta, p, 0.0)


@compiled_in_line
def valve_flows(
    c: Array, p_c: float, p_a: float, p_b: float, in_a: float, in_b: float, out_a: float, out_b: float
) -> tuple[float, float, float]:
    """Net flows through the valves into A and B, and what comes from the supply, kg/s."""
    q_a, q_b = supply_flows(c, p_c, p_a, p_b, in_a if out_a == 0.0 else 0.0, in_b if out_b == 0.0 else 0.0)
    drain = q_a + q_b
    if out_a > 0.0:
        q_a -= out_a * throttle(c, c[k.BETA_OUT], p_a, 0.0)
    if out_b > 0.0:
        q_b -= out_b * throttle(c, c[k.BETA_OUT], p_b, 0.0)
    return q_a, q_b, drain


@compiled
def line_and_leaks(
    c: Array, held: Array, p_a: float, p_b: float, q_a: float, q_b: float, drain: float
) -> tuple[float, float, float]:
    """Flows into A and B and from the supply, where lines hold air back or muscles leak."""
    if c[e.LINE] > 0.0:
        q_a, q_b, drain = held[LINE_A], held[LINE_B], held[DRAIN]
    if c[e.LEAK_A] > 0.0:
        q_a -= leak(c, c[e.LEAK_A], p_a)
    if c[e.LEAK_B] > 0.0:
        q_b -= leak(c, c[e.LEAK_B], p_b)
    return q_a, q_b, drain


@compiled_in_line
def geometry(c: Array, sine: float, cosine: float) -> tuple[float, float, float, float]:
    """Lengths with fittings and levers -dh/dtheta of A and B, m."""
    xa, ya = c[k.X] - c[k.R_A] * sine, c[k.YA] + c[k.R_A] * cosine
    xb, yb = c[k.X] - c[k.R_B] * sine, c[k.YB] + c[k.R_B] * cosine
    length_a, length_b = math.sqrt(xa * xa + ya * ya), math.sqrt(xb * xb + yb * yb)
    lever_a = c[k.R_A] * (c[k.YA] * sine + c[k.X] * cosine) / length_a
    lever_b = c[k.R_B] * (c[k.YB] * sine + c[k.X] * cosine) / length_b
    return length_a - c[k.FITTING], length_b - c[k.FITTING], lever_a, lever_b


@compiled_in_line
def nominal_length(c: Array, two_l: float, p: float) -> float:
    """Length in m at which a muscle at p pulls nothing (3.45-3.52)."""
    bar = 1e-5 * p
    return two_l - c[k.S1] * bar / (c[k.S2] + bar)


@compiled_in_line
def muscle(
    c: Array, p: float, h: float, dh: float, factor: float, two_l: float, creep: float
) -> tuple[float, float, float]:
    """Pull F in N, volume V in m3 and dV/dh in m2 of a muscle of length h (3.36-3.52, 4.5)."""
    root = math.sqrt(c[k.FOUR_L2] - h * h)
    d2 = root / c[k.N_PI]
    area = c[k.D1_SQ3] + d2 * (c[k.D1_X4] + 8.0 * d2)
    volume = 0.05235987755982988 * h * area
    slope = 0.05235987755982988 * (area - h * (c[k.D1_X4] + 16.0 * d2) * h / (c[k.N_PI] * root))
    bar = 1e-5 * p
    # stiffness (4.5) as one polynomial in h whose coefficients depend on p
    stiffness = (c[k.BK0] + bar * c[k.K0]) + h * ((c[k.BK1] + bar * c[k.K1]) + h * (c[k.BK2] + bar * c[k.K2]))
    stretch = c[e.CREEP_GAIN] * (h - nominal_length(c, two_l, p)) - creep
    return factor * stiffness * stretch + (c[k.D0] + c[k.D1] * bar) * dh, volume, slope


@compiled
def other_torques(
    c: Array, held: Array, angle: float, velocity: float, beyond: float, beyond_velocity: float
) -> tuple[float, float]:
    """Torque in N m at the joint of what remembers, friction, hoses, tilt and coupling; acceleration beyond it."""
    torque = held[TORQUE] + held[SLOPE] * (angle - held[FROM])
    if held[COULOMB] > 0.0:
        fade = velocity / c[e.STRIBECK_SPEED]
        level = held[COULOMB] * (1.0 + c[e.STRIBECK] * math.exp(-fade * fade))
        torque -= level * math.tanh(velocity / c[e.COULOMB_SPEED])
    if c[e.HOSE_K] > 0.0 or c[e.HOSE_CUBIC] > 0.0:
        turn = angle - c[e.HOSE_ANGLE]
        torque -= turn * (c[e.HOSE_K] + c[e.HOSE_CUBIC] * turn * turn)
    if c[e.TILT] != 0.0:
        torque += c[k.GRAVITY] * (math.sin(angle + c[e.TILT]) - math.sin(angle))
    if c[e.FLEX_K] == 0.0:
        return torque, 0.0
    twist = c[e.FLEX_K] * (beyond - angle) + c[e.FLEX_D] * (beyond_velocity - velocity)
    outer = c[e.FLEX_GRAVITY] * math.sin(beyond + c[e.TILT]) - twist
    return torque + twist, outer / c[e.FLEX_INERTIA]


@compiled_in_line
def moving(
    c: Array, held: Array, p_c: float, p_a: float, p_b: float, angle: float, velocity: float, beyond: float,
    beyond_velocity: float, in_a: float, in_b: float, out_a: float, out_b: float,
) -> tuple[float, float, float, float, float]:  # fmt: skip
    """d p_c, d p_A, d p_B in Pa/s, and the angular accelerations of joint and of what lies beyond, rad/s2.

    An open out valve overrules.
    """
    sine, cosine = math.sin(angle), math.cos(angle)
    h_a, h_b, lever_a, lever_b = geometry(c, sine, cosine)
    dh_a, dh_b = -lever_a * velocity, -lever_b * velocity
    pull_a, volume_a, slope_a = muscle(c, p_a, h_a, dh_a, c[k.FACTOR_A], c[e.TWO_L_A], held[CREEP_A])
    pull_b, volume_b, slope_b = muscle(c, p_b, h_b, dh_b, c[k.FACTOR_B], c[e.TWO_L_B], held[CREEP_B])

    q_a, q_b, drain = valve_flows(c, p_c - held[SPLIT], p_a, p_b, in_a, in_b, out_a, out_b)
    if c[e.AIR] > 0.0:
        q_a, q_b, drain = line_and_leaks(c, held, p_a, p_b, q_a, q_b, drain)
    d_p_c = c[k.RT] * (throttle(c, c[k.BETA_IN], c[k.P_IN] - held[DROP], p_c) - drain) / c[k.V_C]
    work_a = c[e.COMPRESSION] * (p_a + c[k.ABSOLUTE]) * slope_a * dh_a
    work_b = c[e.COMPRESSION] * (p_b + c[k.ABSOLUTE]) * slope_b * dh_b
    d_p_a = c[k.EXPONENT] * (c[k.RT] * q_a - work_a) / (volume_a + c[e.DEAD_A])
    d_p_b = c[k.EXPONENT] * (c[k.RT] * q_b - work_b) / (volume_b + c[e.DEAD_B])
    torque = c[k.GRAVITY] * sine + pull_a * lever_a + pull_b * lever_b
    if c[e.TORQUES] == 0.0:
        return d_p_c, d_p_a, d_p_b, torque / c[k.INERTIA], 0.0
    more, outer = other_torques(c, held, angle, velocity, beyond, beyond_velocity)
    return d_p_c, d_p_a, d_p_b, (torque + more) / c[k.INERTIA], outer


@compiled
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
    """d p_c, d p_A, d p_B in Pa/s and the angular acceleration in rad/s2; nothing remembered, a stiff coupling."""
    held = np.zeros(HELD)
    held[COULOMB] = c[e.COULOMB]
    d_c, d_a, d_b, turn, _ = moving(
        c, held, p_c, p_a, p_b, angle, velocity, angle, velocity,
        1.0 if in_a else 0.0, 1.0 if in_b else 0.0, 1.0 if out_a else 0.0, 1.0 if out_b else 0.0,
    )  # fmt: skip
    return d_c, d_a, d_b, turn
