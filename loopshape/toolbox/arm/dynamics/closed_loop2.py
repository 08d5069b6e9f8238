"""The 2-DoF arm under its controllers: one compiled loop over ticks, four loops, four muscles.

Order inside a tick: measure, control, log, start a PWM period if one is due (from this tick's u), integrate by the
classical Runge-Kutta method of order 4, each step split where one of up to four valves closes. Codes of injections
and endings are the 1-DoF arm's.
"""

from __future__ import annotations

import math

import numpy as np

from loopshape.core.kernels import biquads
from loopshape.core.kernels.compiled import compiled
from loopshape.core.units import Array
from loopshape.toolbox.arm.dynamics.closed_loop import (
    COMPLETE,
    CONTROLLER_INPUT,
    LEFT_PRESSURE,
    LEFT_THETA1,
    LEFT_THETA2,
    NOT_FINITE,
    PLANT_INPUT,
    Controllers,
    Inputs,
    Pwm,
    by_schedules,
    converted,
    decoupled,
)
from loopshape.toolbox.arm.dynamics.model import called, in_line
from loopshape.toolbox.arm.dynamics.model2 import Four, State2, moving2
from loopshape.toolbox.arm.dynamics.pwm import pulse_s
from loopshape.toolbox.arm.parameters import Sensors
from loopshape.toolbox.arm.parameters2 import SHARED
from loopshape.toolbox.gap import noise

#: columns of the log, pressures in Pa: measured angles and pressures, z and u; true states after them if asked.
#: z_p_a and z_p_c are z_pAB and z_pCD where the strategy is that of pairs
LOGGED = (
    "theta1", "theta2", "p_a", "p_b", "p_c", "p_d", "z_theta1", "z_theta2", "z_p_a", "z_p_c",
    "u_a", "u_b", "u_c", "u_d",
    "capacity", "true_a", "true_b", "true_c", "true_d", "angle1", "angle2", "velocity1", "velocity2",
)  # fmt: skip
LOOPS, Z, U, MEASURED, STATES = 4, 6, 10, 14, 9  # number of loops, places of z, u and true states, and their number


@in_line
def ahead2(s: State2, h: float, k: State2) -> State2:
    """A state h s on at the rates `k`."""
    return (
        s[0] + h * k[0], s[1] + h * k[1], s[2] + h * k[2], s[3] + h * k[3], s[4] + h * k[4], s[5] + h * k[5],
        s[6] + h * k[6], s[7] + h * k[7], s[8] + h * k[8],
    )  # fmt: skip


@called
def step_rk4_2(c: Array, x: Array, h: float, valves: Four) -> None:
    """One classical Runge-Kutta step of length h s with the valves as given; `x` (9,) moves in place."""
    s = x[0], x[1], x[2], x[3], x[4], x[5], x[6], x[7], x[8]
    k1 = moving2(c, s, valves)
    k2 = moving2(c, ahead2(s, 0.5 * h, k1), valves)
    k3 = moving2(c, ahead2(s, 0.5 * h, k2), valves)
    k4 = moving2(c, ahead2(s, h, k3), valves)
    sixth = h / 6.0
    x[0] = s[0] + sixth * (k1[0] + 2.0 * (k2[0] + k3[0]) + k4[0])
    x[1] = s[1] + sixth * (k1[1] + 2.0 * (k2[1] + k3[1]) + k4[1])
    x[2] = s[2] + sixth * (k1[2] + 2.0 * (k2[2] + k3[2]) + k4[2])
    x[3] = s[3] + sixth * (k1[3] + 2.0 * (k2[3] + k3[3]) + k4[3])
    x[4] = s[4] + sixth * (k1[4] + 2.0 * (k2[4] + k3[4]) + k4[4])
    x[5] = s[5] + sixth * (k1[5] + 2.0 * (k2[5] + k3[5]) + k4[5])
    x[6] = s[6] + sixth * (k1[6] + 2.0 * (k2[6] + k3[6]) + k4[6])
    x[7] = s[7] + sixth * (k1[7] + 2.0 * (k2[7] + k3[7]) + k4[7])
    x[8] = s[8] + sixth * (k1[8] + 2.0 * (k2[8] + k3[8]) + k4[8])


@in_line
def earlier(edge: float, now: float, stop: float) -> float:
    """The time of an edge, if it comes after `now` and before `stop`; else `stop`."""
    return edge if now < edge < stop else stop


@in_line
def valves_at(u: float, closes: float, now: float) -> float:
    """A muscle's valves at `now`: 1 filling, -1 letting out, 0 shut."""
    return math.copysign(1.0, u) if now < closes else 0.0


@called
def integrate2(c: Array, x: Array, start_s: float, end_s: float, steps: int, u: Array, closes: Array) -> None:
    """Integrate from `start_s` to `end_s` of a PWM period in `steps`, splitting each where a valve closes.

    `u` (4,) are the period's commands and `closes` (4,) the ends of their pulses in s from its start.
    """
    h = (end_s - start_s) / steps
    for k in range(steps):
        now = start_s + k * h
        end = end_s if k == steps - 1 else start_s + (k + 1) * h
        while now < end:
            stop = earlier(closes[0], now, end)
            stop = earlier(closes[1], now, stop)
            stop = earlier(closes[2], now, stop)
            stop = earlier(closes[3], now, stop)
            valves = (
                valves_at(u[0], closes[0], now), valves_at(u[1], closes[1], now),
                valves_at(u[2], closes[2], now), valves_at(u[3], closes[3], now),
            )  # fmt: skip
            step_rk4_2(c, x, stop - now, valves)
            now = stop


@in_line
def sense2(x: Array, sensors: Sensors, random_state: int, row: Array) -> int:
    """Fill a row's first six places with angles and pressures behind noise and converters; gives the noise's state."""
    for k in range(3):
        n1 = n2 = 0.0
        if sensors.noise_rad > 0.0 or sensors.noise_pa > 0.0:
            random_state, n1, n2 = noise.normal_pair(random_state)
        if k == 0:
            row[0] = converted(x[5] + sensors.noise_rad * n1, sensors.step_rad, -sensors.reach_rad, sensors.reach_rad)
            row[1] = converted(x[6] + sensors.noise_rad * n2, sensors.step_rad, -sensors.reach_rad, sensors.reach_rad)
        else:
            row[2 * k] = converted(x[2 * k - 1] + sensors.noise_pa * n1, sensors.step_pa, 0.0, sensors.reach_pa)
            row[2 * k + 1] = converted(x[2 * k] + sensors.noise_pa * n2, sensors.step_pa, 0.0, sensors.reach_pa)
    return random_state


@in_line
def compare2(references: Array, out: Array, tick: int, shared: float, errors: Array) -> None:
    """Fill errors (4,) in rad and bar from the references and a row's six sensors."""
    errors[0], errors[1] = references[tick, 0] - out[tick, 0], references[tick, 1] - out[tick, 1]
    errors[2] = 1e-5 * (references[tick, 2] - (out[tick, 2] + shared * out[tick, 3]))
    errors[3] = 1e-5 * (references[tick, 3] - (out[tick, 4] + shared * out[tick, 5]))


@in_line
def told2(references: Array, out: Array, tick: int, shared: float, signals: Array) -> None:
    """Fill what a schedule may follow (8,), references and outputs in rad and bar."""
    signals[0], signals[1] = references[tick, 0], references[tick, 1]
    signals[2], signals[3] = 1e-5 * references[tick, 2], 1e-5 * references[tick, 3]
    signals[4], signals[5] = out[tick, 0], out[tick, 1]
    signals[6] = 1e-5 * (out[tick, 2] + shared * out[tick, 3])
    signals[7] = 1e-5 * (out[tick, 4] + shared * out[tick, 5])


@in_line
def add(injected: Array, tick: int, signals: Array) -> None:
    """Add what is injected in a tick to signals (4,)."""
    for k in range(LOOPS):
        signals[k] += injected[tick, k]


@in_line
def log2(out: Array, tick: int, v: Array, shared: float, x: Array) -> None:
    """Log the commands that follow from what enters the plant, `v` (4,); true states too where there is room.

    u_A = z_theta2 + z_pA, u_B = -z_theta2, u_C = -z_theta1 + z_pC, u_D = z_theta1 (5.11-5.15, signs of ARM.md). With
    `shared` 1 z_p enters both muscles of its pair: u_B = -z_theta2 + z_pAB, u_D = z_theta1 + z_pCD (5.3-5.7).
    """
    out[tick, U], out[tick, U + 1], out[tick, U + 2], out[tick, U + 3] = v[1] + v[2], -v[1], v[3] - v[0], v[0]
    if shared != 0.0:  # not added as 0 elsewhere, which would make +0 of -0
        out[tick, U + 1] += shared * v[2]
        out[tick, U + 3] += shared * v[3]
    if out.shape[1] > MEASURED:
        for k in range(STATES):
            out[tick, MEASURED + k] = x[k]


@in_line
def range_left2(x: Array, sensors: Sensors) -> int:
    """Which limit of the model's range the state has passed, or COMPLETE."""
    if not math.isfinite(x[0] + x[1] + x[2] + x[3] + x[4] + x[5] + x[6] + x[7] + x[8]):
        return NOT_FINITE
    if abs(x[5]) > sensors.limit1_rad:
        return LEFT_THETA1
    if abs(x[6]) > sensors.limit_rad:
        return LEFT_THETA2
    if min(x[1], x[2], x[3], x[4]) < sensors.lowest_pa or max(x[1], x[2], x[3], x[4]) > sensors.highest_pa:
        return LEFT_PRESSURE
    return COMPLETE


@compiled
def run2(
    c: Array, sensors: Sensors, x: Array, loops: Controllers, inputs: Inputs, pwm: Pwm, steps: int, out: Array
) -> tuple[int, int]:
    """Simulate as many ticks as there are references (n, 4: rad, rad, Pa, Pa); fills `out` (n, 14 or 23) by `LOGGED`.

    `x` (9,), the controllers and their schedules move in place. Gives why it ended and how many ticks are logged.
    The constants' `SHARED` is the strategy: 1 measures and drives both muscles of a pair by its pressure loop, 0 one.
    Sensor spans: angles are centred, pressures start at 0; beyond them the converters clip.
    """
    references, injected, random_state = inputs.references, inputs.injected, inputs.random_state
    sections, state, matrix = loops.sections, loops.state, loops.decoupling
    tick_s, period_ticks = pwm.tick_s, pwm.period_ticks
    u, closes, shared, signals = np.zeros(4), np.zeros(4), c[SHARED], np.zeros(2 * LOOPS)
    errors, v, entering, follows = np.zeros(LOOPS), np.zeros(LOOPS), np.zeros(LOOPS), loops.scheduled.any()
    for tick in range(references.shape[0]):
        random_state = sense2(x, sensors, random_state, out[tick])
        if inputs.closed:
            compare2(references, out, tick, shared, errors)
            if inputs.injection == CONTROLLER_INPUT:
                add(injected, tick, errors)
            v[0] = biquads.step(sections[0], state[0], errors[0])
            v[1] = biquads.step(sections[1], state[1], errors[1])
            v[2] = biquads.step(sections[2], state[2], errors[2])
            v[3] = biquads.step(sections[3], state[3], errors[3])
            if follows:
                told2(references, out, tick, shared, signals)
                by_schedules(loops, signals, errors, v)
        else:
            v[0], v[1], v[2], v[3] = injected[tick, 0], injected[tick, 1], injected[tick, 2], injected[tick, 3]
        out[tick, Z], out[tick, Z + 1], out[tick, Z + 2], out[tick, Z + 3] = v[0], v[1], v[2], v[3]
        if inputs.closed and inputs.injection == PLANT_INPUT:
            add(injected, tick, v)
        decoupled(matrix, v, entering)
        log2(out, tick, entering, shared, x)
        phase = tick % period_ticks
        if phase == 0:
            for k in range(4):
                u[k] = out[tick, U + k]
                closes[k] = pulse_s(u[k], period_ticks * tick_s, pwm.dead_zone)
        integrate2(c, x, phase * tick_s, (phase + 1) * tick_s, steps, u, closes)
        ended = range_left2(x, sensors)
        if ended != COMPLETE:
            return ended, tick + 1
    return COMPLETE, references.shape[0]
