"""One recording: controllers, converters, pulses and the arm, tick by tick."""

from __future__ import annotations

import math

import numpy as np

from loopshape.core.kernels.compiled import compiled, compiled_in_line
from loopshape.core.units import Array

from . import arm as at
from .arm import PERIOD_S, STATES, STEP_S, SUPPLY_PA, THETA, TICK_S, Arm
from .mechanics import geometry, nominal_length
from .motion import step
from .pneumatics import regulator_target
from .sensors import CONTROL_GRID_V, in_range, on_grid, play, read_angle, read_pressures
from .valves import PULSES, openings, start_pulse

STEPS = round(TICK_S / STEP_S)
TICKS = round(PERIOD_S / TICK_S)
#: columns of what `record` gives
MEASURED = ("theta2_rad", "p_a_bar", "p_b_bar", "z_theta2_v", "z_p_v")


@compiled_in_line
def filtered(sections: Array, past: Array, value: float) -> float:
    """One sample through biquads (n, 5), direct form I; `past` is (n, 4): two inputs, two outputs."""
    for k in range(sections.shape[0]):
        b, x = sections[k], past[k]
        out = b[0] * value + b[1] * x[0] + b[2] * x[1] - b[3] * x[2] - b[4] * x[3]
        x[1], x[0], x[3], x[2] = x[0], value, x[2], out
        value = out
    return value


@compiled_in_line
def supply(arm: Arm, t: float) -> float:
    """Supply pressure in Pa: constant, or a compressor's saw tooth below it."""
    phase = t * arm.ripple_hz
    return SUPPLY_PA - arm.ripple_pa * (phase - math.floor(phase))


@compiled
def record(
    arm: Arm, y: Array, setpoints: Array, injected: Array, forced: Array, open_from: int, noise: Array,
    lost: Array, angle_sections: Array, pressure_sections: Array, session_s: float,
) -> tuple[Array, int]:  # fmt: skip
    """Measured columns (n, 5) as in `MEASURED`, and the row at which the arm left its range (n if it did not).

    `y` (states,) is moved on. `setpoints`, `injected` (n, 2): angle in rad, pressure sum in bar. From row
    `open_from` on the loops are open and z is `forced` (n, 2). `noise` (n, 3) in rad and bar; `lost` (periods,) is
    1 where a period's command does not arrive; `session_s` is the time since the session began.
    """
    n = setpoints.shape[0]
    out = np.zeros((n, 5))
    angle_past, pressure_past = np.zeros((angle_sections.shape[0], 4)), np.zeros((pressure_sections.shape[0], 4))
    pulses, valves, v = np.zeros((PULSES, 2, 3)), np.zeros((4, 3)), np.zeros(4)
    work = np.zeros((2, STATES))
    pot, u_a, u_b = y[THETA], 0.0, 0.0
    for k in range(n):
        out[k, 0] = read_angle(arm, y, pot, noise[k, 0])
        out[k, 1], out[k, 2] = read_pressures(arm, y, noise[k, 1], noise[k, 2])
        e_angle = setpoints[k, 0] - out[k, 0] + injected[k, 0]
        e_pressure = setpoints[k, 1] - out[k, 1] - out[k, 2] + injected[k, 1]
        z_angle = filtered(angle_sections, angle_past, e_angle)
        z_pressure = filtered(pressure_sections, pressure_past, e_pressure)
        if k >= open_from:
            z_angle, z_pressure = forced[k, 0], forced[k, 1]
        else:
            z_angle, z_pressure = on_grid(arm, z_angle, CONTROL_GRID_V), on_grid(arm, z_pressure, CONTROL_GRID_V)
        out[k, 3], out[k, 4] = z_angle, z_pressure
        if k % TICKS == 0:
            old = max(k - arm.stale_ticks, 0)
            if lost[k // TICKS] == 0.0:
                u_a, u_b = out[old, 3] + out[old, 4], out[old, 4] - out[old, 3]
            start_pulse(pulses, 0, k * TICK_S, u_a)
            start_pulse(pulses, 1, k * TICK_S, u_b)
        gain = 1.0 - arm.flow_drift * (1.0 - math.exp(-(session_s + k * TICK_S) / 200.0))
        for i in range(STEPS):
            t = k * TICK_S + i * STEP_S
            openings(arm, pulses, valves, t, v)
            step(arm, y, work, v, supply(arm, session_s + t), gain, pot)
            if arm.play_form > 0:
                pot = play(arm, pot, y[THETA])
        if not in_range(y):
            return out, k
    return out, n


def at_rest(arm: Arm, theta_rad: float, p_a_pa: float, p_b_pa: float) -> Array:
    """States (53,) of an arm that has stood long at an angle and at two pressures."""
    y = np.zeros(STATES)
    y[THETA] = y[at.THETA_L] = y[at.SENSE_T] = theta_rad
    y[at.P_C] = y[at.P_REG] = regulator_target(arm, SUPPLY_PA, 0.0) if arm.droop_form == 1 else SUPPLY_PA
    ha, hb, *_ = geometry(theta_rad)
    muscles = (
        (at.P_A, at.SIDE_A, at.SENSE_A, at.LINE_A, at.CREEP_A, p_a_pa, ha - arm.offset_a_m),
        (at.P_B, at.SIDE_B, at.SENSE_B, at.LINE_B, at.CREEP_B, p_b_pa, hb),
    )
    for p, side, sense, line, creep, value, h in muscles:
        y[[p, side, sense, *range(line, line + at.SEGMENTS)]] = value
        y[creep : creep + at.BRANCHES] = h - nominal_length(value / at.BAR)
    return y
