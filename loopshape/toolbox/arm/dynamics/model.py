"""Right-hand side of the 1-DoF arm: capacity, splitter, two muscles, one body. SI, gauge pressures in Pa.

A state is p_c, p_A, p_B, theta2, its velocity, and angle and velocity of what lies beyond a flexible coupling. Valves
are open areas from 0 to 1 of in A, in B, out A and out B. Equation numbers are the source's (see `parameters`). What
remembers (friction, creep, a line) is held over a step by `memory`.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, TypeVar

import numpy as np

from loopshape.core.kernels.compiled import _compile, compiled
from loopshape.core.units import Array
from loopshape.toolbox.arm import parameters as k
from loopshape.toolbox.arm.effect import effect_parameters as e

F = TypeVar("F", bound=Callable[..., Any])
State = tuple[float, float, float, float, float, float, float]
Valves = tuple[float, float, float, float]

#: what `memory` holds over a step: torque, its slope over the angle from there, creep (m), flows into A and B, from the
#: supply, drop of the supply (Pa), Coulomb torque, drop behind the capacity (Pa); for itself: angle, lengths, levers
TORQUE, SLOPE, FROM, CREEP_A, CREEP_B, LINE_A, LINE_B, DRAIN, DROP, COULOMB, SPLIT = range(11)
AT, LENGTH_A, LENGTH_B, LEVER_A, LEVER_B = range(11, 16)
HELD = 16
LEAK_PA = 5e4  # where a laminar leak equals the orifice


def called(function: F) -> F:
    """As `compiled`, without counting references to arrays, which took half the time: for what makes no array."""
    return _compile(function, _nrt=False)


def in_line(function: F) -> F:
    """As `called`, and put into its callers' code."""
    return _compile(function, _nrt=False, forceinline=True)


@in_line
def flow(c: Array, beta: float, p1: float, p2: float) -> float:
    """Throttle flow (3.16) in kg/s from p1 to p2; `beta` holds the root of 1/(2 R T)."""
    drop = p1 - p2
    return math.copysign(beta * math.sqrt((p1 + p2 + c[k.P_ATM2]) * abs(drop)), drop)


@called
def choked(critical: float, conductance: float, p_atm: float, p1: float, p2: float) -> float:
    """As `flow`, by ISO 6358-1's ellipse with a critical ratio of pressures."""
    high, low = max(p1, p2) + p_atm, min(p1, p2) + p_atm
    bend = max(low / high - critical, 0.0) / (1.0 - critical)
    return math.copysign(conductance * high * math.sqrt(1.0 - bend * bend), p1 - p2)


@in_line
def throttle(c: Array, beta: float, p1: float, p2: float) -> float:
    """Whichever of both holds."""
    if c[e.CRITICAL] == 0.0:
        return flow(c, beta, p1, p2)
    return choked(c[e.CRITICAL], beta * c[e.CONDUCTANCE], 0.5 * c[k.P_ATM2], p1, p2)


@in_line
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


@in_line
def leak(c: Array, beta: float, p: float) -> float:
    """Flow in kg/s out of a muscle at p: orifice, or laminar and equal to the orifice at 0.5 bar."""
    if c[e.LAMINAR] > 0.0:
        return beta * p * (p + c[k.P_ATM2]) / math.sqrt((LEAK_PA + c[k.P_ATM2]) * LEAK_PA)
    return flow(c, beta, p, 0.0)


@in_line
def valve_flows(c: Array, p_c: float, p_a: float, p_b: float, valves: Valves) -> tuple[float, float, float]:
    """Net flows through the valves into A and B, and what comes from the supply, kg/s."""
    in_a, in_b, out_a, out_b = valves
    q_a, q_b = supply_flows(c, p_c, p_a, p_b, in_a if out_a == 0.0 else 0.0, in_b if out_b == 0.0 else 0.0)
    drain = q_a + q_b
    if out_a > 0.0:
        q_a -= out_a * throttle(c, c[k.BETA_OUT], p_a, 0.0)
    if out_b > 0.0:
        q_b -= out_b * throttle(c, c[k.BETA_OUT], p_b, 0.0)
    return q_a, q_b, drain


@in_line
def flows(c: Array, held: Array, p_c: float, p_a: float, p_b: float, valves: Valves) -> tuple[float, float, float]:
    """As `valve_flows`, with what lines hold back and muscles leak."""
    if c[e.LINE] > 0.0:
        q_a, q_b, drain = held[LINE_A], held[LINE_B], held[DRAIN]
    else:
        q_a, q_b, drain = valve_flows(c, p_c, p_a, p_b, valves)
    if c[e.LEAK_A] > 0.0:
        q_a -= leak(c, c[e.LEAK_A], p_a)
    if c[e.LEAK_B] > 0.0:
        q_b -= leak(c, c[e.LEAK_B], p_b)
    return q_a, q_b, drain


@in_line
def geometry(c: Array, sine: float, cosine: float) -> tuple[float, float, float, float]:
    """Lengths with fittings and levers -dh/dtheta of A and B, m."""
    xa, ya = c[k.X] - c[k.R_A] * sine, c[k.YA] + c[k.R_A] * cosine
    xb, yb = c[k.X] - c[k.R_B] * sine, c[k.YB] + c[k.R_B] * cosine
    length_a, length_b = math.sqrt(xa * xa + ya * ya), math.sqrt(xb * xb + yb * yb)
    lever_a = c[k.R_A] * (c[k.YA] * sine + c[k.X] * cosine) / length_a
    lever_b = c[k.R_B] * (c[k.YB] * sine + c[k.X] * cosine) / length_b
    return length_a - c[k.FITTING], length_b - c[k.FITTING], lever_a, lever_b


@in_line
def nominal_length(c: Array, two_l: float, p: float) -> float:
    """Length in m at which a muscle at p pulls nothing (3.45-3.52)."""
    bar = 1e-5 * p
    return two_l - c[k.S1] * bar / (c[k.S2] + bar)


@in_line
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
    stretch = c[e.CREEP_GAIN] * (h - nominal_length(c, two_l, p)) + (c[e.CREEP_LENGTH] * h - creep)
    return factor * stiffness * stretch + (c[k.D0] + c[k.D1] * bar) * dh, volume, slope


@in_line
def stribeck(c: Array, velocity: float) -> float:
    """Friction over its level at speed, 1 + share at rest."""
    if c[e.STRIBECK] == 0.0:
        return 1.0
    fade = velocity / c[e.STRIBECK_SPEED]
    return 1.0 + c[e.STRIBECK] * math.exp(-fade * fade)


@in_line
def turned(sine: float, cosine: float, turn: float) -> float:
    """Sine of an angle `turn` further on; by series where that is small, as in a coupling: in half the time."""
    if abs(turn) > 0.1:
        return sine * math.cos(turn) + cosine * math.sin(turn)
    t = turn * turn
    of_turn = turn * (1.0 + t * (-1.0 / 6.0 + t * (1.0 / 120.0 - t * (1.0 / 5040.0))))
    return sine * (1.0 + t * (-0.5 + t * (1.0 / 24.0 + t * (-1.0 / 720.0 + t * (1.0 / 40320.0))))) + cosine * of_turn


@in_line
def other_torques(
    c: Array, held: Array, angle: float, sine: float, cosine: float, velocity: float, beyond: float,
    beyond_velocity: float,
) -> tuple[float, float]:  # fmt: skip
    """Torque in N m at the joint of what remembers, friction, hoses and coupling; acceleration beyond it.

    `sine` and `cosine` are those of angle and tilt.
    """
    torque = held[TORQUE] + held[SLOPE] * (angle - held[FROM])
    if held[COULOMB] > 0.0:
        left = math.exp(-2.0 * abs(velocity) / c[e.COULOMB_SPEED])  # tanh by exp: half the time
        size = held[COULOMB] * stribeck(c, velocity) * (1.0 - left) / (1.0 + left)
        torque -= math.copysign(size, velocity)
    if c[e.HOSE_K] > 0.0 or c[e.HOSE_CUBIC] > 0.0:
        turn = angle - c[e.HOSE_ANGLE]
        torque -= turn * (c[e.HOSE_K] + c[e.HOSE_CUBIC] * turn * turn)
    if c[e.FLEX_K] == 0.0:
        return torque, 0.0
    twist = c[e.FLEX_K] * (beyond - angle) + c[e.FLEX_D] * (beyond_velocity - velocity)
    outer = c[e.FLEX_GRAVITY] * turned(sine, cosine, beyond - angle) - twist
    return torque + twist, outer / c[e.FLEX_INERTIA]


@in_line
def moving(c: Array, held: Array, state: State, valves: Valves) -> State:
    """Rates of a state: Pa/s, rad/s and rad/s2. An open out valve overrules."""
    p_c, p_a, p_b, angle, velocity, beyond, beyond_velocity = state
    sine, cosine = math.sin(angle), math.cos(angle)
    h_a, h_b, lever_a, lever_b = geometry(c, sine, cosine)
    dh_a, dh_b = -lever_a * velocity, -lever_b * velocity
    pull_a, volume_a, slope_a = muscle(c, p_a, h_a, dh_a, c[k.FACTOR_A], c[e.TWO_L_A], held[CREEP_A])
    pull_b, volume_b, slope_b = muscle(c, p_b, h_b, dh_b, c[k.FACTOR_B], c[e.TWO_L_B], held[CREEP_B])

    q_a, q_b, drain = flows(c, held, p_c - held[SPLIT], p_a, p_b, valves)
    d_p_c = c[k.RT] * (throttle(c, c[k.BETA_IN], c[k.P_IN] - held[DROP], p_c) - drain) / c[k.V_C]
    work_a = c[e.COMPRESSION] * (p_a + c[k.ABSOLUTE]) * slope_a * dh_a
    work_b = c[e.COMPRESSION] * (p_b + c[k.ABSOLUTE]) * slope_b * dh_b
    d_p_a = c[k.EXPONENT] * (c[k.RT] * q_a - work_a) / (volume_a + c[e.DEAD_A])
    d_p_b = c[k.EXPONENT] * (c[k.RT] * q_b - work_b) / (volume_b + c[e.DEAD_B])
    upright = sine * c[e.TILT_COSINE] + cosine * c[e.TILT_SINE]
    torque = c[k.GRAVITY] * upright + pull_a * lever_a + pull_b * lever_b
    if c[e.TORQUES] == 0.0:
        return d_p_c, d_p_a, d_p_b, velocity, torque / c[k.INERTIA], beyond_velocity, 0.0
    across = cosine * c[e.TILT_COSINE] - sine * c[e.TILT_SINE]
    more, outer = other_torques(c, held, angle, upright, across, velocity, beyond, beyond_velocity)
    return d_p_c, d_p_a, d_p_b, velocity, (torque + more) / c[k.INERTIA], beyond_velocity, outer


@compiled
def derivatives(
    c: Array, state: tuple[float, ...], valves: tuple[bool, bool, bool, bool]
) -> tuple[float, float, float, float]:
    """d p_c, d p_A, d p_B in Pa/s and the angular acceleration in rad/s2; nothing remembered, a stiff coupling.

    A state is five floats here; `valves` says which are open.
    """
    p_c, p_a, p_b, angle, velocity = state
    in_a, in_b, out_a, out_b = valves
    held = np.zeros(HELD)
    held[COULOMB] = c[e.COULOMB]
    if c[e.CREEP_LENGTH] > 0.0:  # what creeps with the length has long come to rest
        h_a, h_b, _, _ = geometry(c, math.sin(angle), math.cos(angle))
        held[CREEP_A], held[CREEP_B] = c[e.CREEP_LENGTH] * h_a, c[e.CREEP_LENGTH] * h_b
    areas = 1.0 if in_a else 0.0, 1.0 if in_b else 0.0, 1.0 if out_a else 0.0, 1.0 if out_b else 0.0
    d_c, d_a, d_b, _, turn, _, outer = moving(c, held, (p_c, p_a, p_b, angle, velocity, angle, velocity), areas)
    if c[e.FLEX_K] > 0.0:  # a stiff coupling: what lies beyond turns along
        turn = (c[k.INERTIA] * turn + c[e.FLEX_INERTIA] * outer) / (c[k.INERTIA] + c[e.FLEX_INERTIA])
    return d_c, d_a, d_b, turn
