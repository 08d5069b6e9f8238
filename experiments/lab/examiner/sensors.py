"""Sensors and converters: play, lags, the bends that the library does not know, noise and bits."""

from __future__ import annotations

import math

from loopshape.core.kernels.compiled import compiled_in_line
from loopshape.core.units import Array

from .arm import (
    BAR,
    OMEGA,
    P_A,
    P_B,
    SENSE_A,
    SENSE_B,
    SENSE_T,
    STEP_S,
    THETA,
    Arm,
)

ANGLE_BIT_RAD = 270.0 * math.pi / 180.0 / 4096.0
PRESSURE_BIT_BAR = 2.0 / 4096.0
CONTROL_GRID_V = 2.0**-13
SOFT_PLAY_S_RAD = 0.06  # time constant of the ends, a radian of play
SENSOR_DAMPING = 0.8


@compiled_in_line
def lag_rates(form: int, lag_s: float, first: int, y: Array, dy: Array, value: float) -> None:
    """Rates of a sensor's one or two states; its delay at low frequency is `lag_s` in both forms."""
    if form == 1:
        dy[first] = (value - y[first]) / lag_s
    else:
        w = 2.0 * SENSOR_DAMPING / lag_s
        dy[first] = y[first + 1]
        dy[first + 1] = w * w * (value - y[first]) - 2.0 * SENSOR_DAMPING * w * y[first + 1]


@compiled_in_line
def on_grid(arm: Arm, value: float, bit: float) -> float:
    """A value as converters and the log round it."""
    return bit * math.floor(value / bit + 0.5) if arm.converters == 1 else value


@compiled_in_line
def play(arm: Arm, pot_rad: float, theta: float) -> float:
    """Potentiometer's angle after a step of the joint: dragged along at the end of the play, rigidly or softly."""
    over = theta - pot_rad
    half = 0.5 * arm.play_rad
    beyond = over - half if over > half else (over + half if over < -half else 0.0)
    return pot_rad + (beyond if arm.play_form == 1 else beyond * STEP_S / (STEP_S + SOFT_PLAY_S_RAD * arm.play_rad))


@compiled_in_line
def read_angle(arm: Arm, y: Array, pot_rad: float, noise_rad: float) -> float:
    """What the converter gives for the angle, in rad."""
    angle = y[THETA]
    if arm.angle_form > 0:
        angle = y[SENSE_T]
    elif arm.play_form > 0:
        angle = pot_rad
    angle += arm.wave_rad * math.sin(arm.wave_per_rad * angle + arm.wave_phase_rad) + noise_rad
    return on_grid(arm, angle, ANGLE_BIT_RAD)


@compiled_in_line
def bent(arm: Arm, own_pa: float, other_pa: float) -> float:
    """A pressure sensor's value in bar, with curvature and crosstalk."""
    p = (own_pa + arm.crosstalk * (other_pa - own_pa)) / BAR
    return p + 4.0 * arm.gauge_curve_bar * p * (1.0 - p)


@compiled_in_line
def read_pressures(arm: Arm, y: Array, noise_a_bar: float, noise_b_bar: float) -> tuple[float, float]:
    """What the converters give for p_A and p_B, in bar."""
    a, b = (y[SENSE_A], y[SENSE_B]) if arm.pressure_form > 0 else (y[P_A], y[P_B])
    read_a, read_b = bent(arm, a, b) + noise_a_bar, bent(arm, b, a) + noise_b_bar
    return on_grid(arm, read_a, PRESSURE_BIT_BAR), on_grid(arm, read_b, PRESSURE_BIT_BAR)


@compiled_in_line
def in_range(y: Array) -> bool:
    """Whether the arm is where its model holds (ARM.md 5), with room for overshoot."""
    return abs(y[THETA]) < 0.9 and abs(y[OMEGA]) < 40.0 and 0.0 < y[P_A] < 1.4e5 and 0.0 < y[P_B] < 1.4e5
