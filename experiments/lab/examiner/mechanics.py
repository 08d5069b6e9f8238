"""Muscles, joint and body: forces and torques, and the rates of the states behind them."""

from __future__ import annotations

import math

from loopshape.core.kernels.compiled import compiled_in_line
from loopshape.core.units import Array

from .arm import (
    BRAID_M,
    BRANCHES,
    DAMP_0,
    DAMP_P,
    END_M,
    FITTING_M,
    FRICTION,
    GRAVITY,
    LEVER_M,
    PAYLOAD_ARM_M,
    SHORTENING_BAR,
    SHORTENING_M,
    SLIPS,
    STIFF_B,
    STIFF_C0,
    STIFF_C1,
    STIFF_K0,
    STIFF_K1,
    STIFF_K2,
    TURNS,
    X_M,
    YA_M,
    YB_M,
    Arm,
)

SLIP_M = (1.5e-4, 3e-4, 6e-4, 1.2e-3, 2.4e-3)  # presliding of the braid's elements
SLIP_SHARE = (0.15, 0.25, 0.25, 0.20, 0.15)
BOUC_WEN_M, BOUC_WEN_POWER = 6e-4, 1.3
CREEP_S = (0.1, 0.46, 2.15, 10.0)  # one branch each two thirds of a decade
PRESLIDE_RAD = 1.5e-3  # of the joint's friction
PRESLIDES_RAD = (4e-4, 1.2e-3, 3.6e-3)
STRIBECK, STRIBECK_RAD_S = 1.25, 0.05
BRISTLE_S = 0.01


@compiled_in_line
def geometry(theta: float) -> tuple[float, float, float, float]:
    """Muscle lengths h_A, h_B in m and their slopes dh/dtheta in m/rad."""
    s, c = math.sin(theta), math.cos(theta)
    ax, ay = X_M - LEVER_M * s, YA_M + LEVER_M * c
    bx, by = X_M + LEVER_M * s, YB_M - LEVER_M * c
    a, b = math.sqrt(ax * ax + ay * ay), math.sqrt(bx * bx + by * by)
    return (
        a - FITTING_M,
        b - FITTING_M,
        -LEVER_M * (X_M * c + YA_M * s) / a,
        LEVER_M * (X_M * c + YB_M * s) / b,
    )


@compiled_in_line
def volume(h: float) -> tuple[float, float]:
    """Volume of a muscle in m³ and its slope dV/dh in m²."""
    root = math.sqrt(4.0 * BRAID_M * BRAID_M - h * h)
    d = root / (TURNS * math.pi)
    section = 3.0 * END_M * END_M + 4.0 * END_M * d + 8.0 * d * d
    bend = (4.0 * END_M + 16.0 * d) * h / (TURNS * math.pi * root)
    return math.pi * h / 60.0 * section, math.pi / 60.0 * (section - h * bend)


@compiled_in_line
def stiffness(p_bar: float, h: float) -> float:
    """Stiffness of a muscle in N/m (4.5)."""
    constant = STIFF_C0 * STIFF_K0 + STIFF_C1 * STIFF_K1 * h + STIFF_K2 * h * h
    return 1e5 * (STIFF_B * constant + p_bar * (STIFF_K0 + STIFF_K1 * h + STIFF_K2 * h * h))


@compiled_in_line
def nominal_length(p_bar: float) -> float:
    """Length without force in m (3.47)."""
    return 2.0 * BRAID_M - SHORTENING_M * p_bar / (SHORTENING_BAR + p_bar)


@compiled_in_line
def slip_rate(x: float, slide: float) -> float:
    """Rate of a slip element that moves by `slide` (its presliding a unit) and stops at +-1."""
    return 0.0 if (x >= 1.0 and slide > 0.0) or (x <= -1.0 and slide < 0.0) else slide


@compiled_in_line
def bouc_wen_rate(x: float, slide: float) -> float:
    """Rate of a Bouc-Wen element with the bound 1."""
    size = abs(x) ** BOUC_WEN_POWER
    return slide - 0.6 * abs(slide) * size * (1.0 if x > 0.0 else -1.0) - 0.4 * slide * size


@compiled_in_line
def braid(arm: Arm, first: int, y: Array, dy: Array, speed: float) -> float:
    """Sum of the braid's elements (-1 to 1) for a muscle that lengthens at `speed`; sets their rates."""
    if arm.braid_form == 2:
        dy[first] = bouc_wen_rate(y[first], speed / BOUC_WEN_M)
        return y[first]
    total = 0.0
    for k in range(SLIPS):
        dy[first + k] = slip_rate(y[first + k], speed / SLIP_M[k])
        total += SLIP_SHARE[k] * min(max(y[first + k], -1.0), 1.0)
    return total


@compiled_in_line
def creep(first: int, y: Array, dy: Array, stretch: float) -> float:
    """Mean stretch of the relaxing branches in m; sets their rates."""
    total = 0.0
    for k in range(BRANCHES):
        dy[first + k] = (stretch - y[first + k]) / CREEP_S[k]
        total += y[first + k] / BRANCHES
    return total


@compiled_in_line
def muscle_force(
    arm: Arm, k: float, stretch_offset: float, p_pa: float, h: float, speed: float,
    braid_at: int, creep_at: int, y: Array, dy: Array,
) -> float:  # fmt: skip
    """Pull of one muscle in N; `k` is its stiffness factor, `stretch_offset` what its nominal length is longer."""
    p = 1e-5 * p_pa
    stretch = h - nominal_length(p) - stretch_offset
    acting = stretch
    if arm.creep_share > 0.0:
        acting = arm.creep_gain * (stretch - arm.creep_share * creep(creep_at, y, dy, stretch))
    force = k * stiffness(p, h) * acting + arm.damping * (DAMP_0 + DAMP_P * p) * speed
    if arm.braid_form > 0:
        force += arm.braid_n * 2.0 * max(p, 0.0) * braid(arm, braid_at, y, dy, speed)
    return force


@compiled_in_line
def friction(arm: Arm, y: Array, dy: Array, omega: float, load_n: float) -> float:
    """Friction torque in N m (positive with positive speed); sets the rates of its states.

    Form 1: LuGre (Canudas de Wit 1995) whose level follows the joint's load; form 2: three slip elements.
    """
    if arm.friction_form == 1:
        level = arm.friction_nm * (0.4 + 0.6 * max(load_n, 0.0) / arm.load_n)
        stribeck = 1.0 + (STRIBECK - 1.0) * math.exp(-((omega / STRIBECK_RAD_S) ** 2))
        rate = (omega - abs(omega) * y[FRICTION] / stribeck) / PRESLIDE_RAD
        dy[FRICTION] = rate
        return level * (y[FRICTION] + BRISTLE_S * rate * math.exp(-((omega / STRIBECK_RAD_S) ** 2)))
    total = 0.0
    for k in range(3):
        dy[FRICTION + k] = slip_rate(y[FRICTION + k], omega / PRESLIDES_RAD[k])
        total += min(max(y[FRICTION + k], -1.0), 1.0) / 3.0
    return arm.friction_nm * total


@compiled_in_line
def joint_torque(arm: Arm, theta: float, omega: float) -> float:
    """Torque at the joint that does not come from muscles, gravity or dry friction, in N m."""
    off = theta - arm.spring_centre_rad
    torque = -arm.spring_nm_rad * off * (1.0 + arm.spring_hardening * off * off) - arm.viscous_nms_rad * omega
    beyond = abs(theta) - arm.stop_rad
    if beyond > 0.0:
        sign = 1.0 if theta > 0.0 else -1.0
        torque -= sign * arm.stop_nm_rad * beyond * (1.0 + 2.0 * beyond) + 0.02 * arm.stop_nm_rad * omega
    return torque


@compiled_in_line
def body_torque(arm: Arm, theta: float, share: float, payload_kg: float) -> float:
    """Gravity's torque on a share of the body and on the payload, in N m."""
    return (share * arm.body_nm + payload_kg * GRAVITY * PAYLOAD_ARM_M) * math.sin(theta + arm.tilt_rad)
