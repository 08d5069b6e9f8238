"""Pulses and valves: when each of the four valves is open, as a share of an integrator's step."""

from __future__ import annotations

import math

from loopshape.core.kernels.compiled import compiled_in_line
from loopshape.core.units import Array

from .arm import DEAD_ZONE, PERIOD_S, STEP_S, Arm

PULSES = 4  # periods back that may still act
RAMP_SHARE = (0.0, 0.4, 0.2)  # movement of the valve in parts of its opening delay, by form
CLOSING = 1.5  # closing delay in parts of the opening delay
LIFT = 0.5  # current at which a solenoid lifts


@compiled_in_line
def pulse_length(u: float) -> float:
    """Length of a command's pulse in s (3.13-3.15)."""
    size = abs(u)
    if size <= DEAD_ZONE:
        return 0.0
    return PERIOD_S if size > 1.0 - DEAD_ZONE else size * PERIOD_S


@compiled_in_line
def start_pulse(pulses: Array, at: int, t: float, u: float) -> None:
    """Enter a period's pulse: `pulses` is (4, 2 muscles, 3) of start in s, length in s, direction."""
    slot = round(t / PERIOD_S) % PULSES
    pulses[slot, at, 0] = t
    pulses[slot, at, 1] = pulse_length(u)
    pulses[slot, at, 2] = 1.0 if u > 0.0 else -1.0


@compiled_in_line
def driven(pulses: Array, at: int, direction: float, t: float, opening_s: float, closing_s: float) -> float:
    """Share of the step from t in which a valve is driven, its edges late by `opening_s` and `closing_s`."""
    share = 0.0
    for k in range(PULSES):
        length = pulses[k, at, 1]
        if length > 0.0 and pulses[k, at, 2] == direction:
            begin = max(pulses[k, at, 0] + opening_s, t)
            end = min(pulses[k, at, 0] + length + closing_s, t + STEP_S)
            share += max(end - begin, 0.0) / STEP_S
    return min(share, 1.0)


@compiled_in_line
def above(before: float, after: float, level: float) -> float:
    """Share of a step in which a signal that goes straight from `before` to `after` lies above a level."""
    if (before >= level) == (after >= level):
        return 1.0 if after >= level else 0.0
    part = (level - before) / (after - before)
    return 1.0 - part if after > before else part


@compiled_in_line
def moved(position: float, target_share: float, travel_s: float) -> tuple[float, float]:
    """Valve's position (0 to 1) after a step in which it is drawn open for `target_share`, and its mean in it."""
    stroke = STEP_S / travel_s
    after = min(max(position + stroke * (2.0 * target_share - 1.0), 0.0), 1.0)
    mean = 0.5 * (position + after)
    if target_share in (0.0, 1.0):  # it moves straight, and rests from where it meets the end
        moving = min(abs(after - position) / stroke, 1.0)
        mean = moving * mean + (1.0 - moving) * after
    return after, mean


@compiled_in_line
def solenoid(arm: Arm, valve: Array, share: float, travel_s: float) -> float:
    """Share of the step in which the armature is drawn; `valve` is position, current, drawn or not.

    The current follows the drive with one time constant; the armature lifts at half the current and falls at
    less, so that long pulses open and close with the wanted delays and short ones do not open at all.
    """
    tau = (arm.valve_open_s - 0.5 * travel_s) / math.log(1.0 / (1.0 - LIFT))
    fall = math.exp(-(CLOSING * arm.valve_open_s - 0.5 * travel_s) / tau)
    before = valve[1]
    valve[1] = share + (before - share) * math.exp(-STEP_S / tau)
    drawn = above(before, valve[1], fall if valve[2] > 0.5 else LIFT)
    valve[2] = 1.0 if valve[1] >= (fall if valve[2] > 0.5 else LIFT) else 0.0
    return drawn


@compiled_in_line
def opening(arm: Arm, pulses: Array, valve: Array, at: int, direction: float, t: float) -> float:
    """Mean opening (0 to 1) of one valve over the step from t."""
    late = arm.transport_s
    if arm.valve_form == 0:
        return driven(pulses, at, direction, t, late, late)
    travel_s = RAMP_SHARE[arm.valve_form] * arm.valve_open_s
    if arm.valve_form == 1:
        early = late - 0.5 * travel_s
        share = driven(pulses, at, direction, t, early + arm.valve_open_s, early + CLOSING * arm.valve_open_s)
    else:
        share = solenoid(arm, valve, driven(pulses, at, direction, t, late, late), travel_s)
    valve[0], mean = moved(valve[0], share, travel_s)
    return mean


@compiled_in_line
def openings(arm: Arm, pulses: Array, valves: Array, t: float, v: Array) -> None:
    """Mean openings `v` of in A, out A, in B, out B over the step from t; `valves` is (4, 3)."""
    for k in range(4):
        v[k] = opening(arm, pulses, valves[k], k // 2, 1.0 if k % 2 == 0 else -1.0, t)
