"""The 2-DoF arm under its controllers: one compiled loop over ticks, four loops, four muscles.

Order inside a tick: measure, control, log, start a PWM period if one is due (from this tick's u), integrate by the
classical Runge-Kutta method of order 4, each step split where one of up to four valves closes. Codes of injections
and endings are the 1-DoF arm's.
"""

from __future__ import annotations

import math

import numpy as np

from loopshape.core.kernels import biquads, noise
from loopshape.core.kernels.compiled import compiled
from loopshape.core.units import Array
from loopshape.toolbox.arm.dynamics import pwm
from loopshape.toolbox.arm.dynamics.closed_loop import (
    COMPLETE,
    CONTROLLER_INPUT,
    LEFT_PRESSURE,
    LEFT_THETA1,
    LEFT_THETA2,
    NOT_FINITE,
    PLANT_INPUT,
    Wiring,
    by_schedules,
    converted,
    decoupled,
)
from loopshape.toolbox.arm.dynamics.model import called, in_line
from loopshape.toolbox.arm.dynamics.model2 import moving2
from loopshape.toolbox.arm.parameters import Sensors
from loopshape.toolbox.arm.parameters2 import SHARED

#: columns of the log, pressures in Pa: measured angles and pressures, z and u; true states after them if asked.
#: z_p_a and z_p_c are z_pAB and z_pCD where the strategy is that of pairs
LOGGED = (
    "theta1", "theta2", "p_a", "p_b", "p_c", "p_d", "z_theta1", "z_theta2", "z_p_a", "z_p_c",
    "u_a", "u_b", "u_c", "u_d",
    "capacity", "true_a", "true_b", "true_c", "true_d", "angle1", "angle2", "velocity1", "velocity2",
)  # fmt: skip
LOOPS, Z, U, MEASURED, STATES = 4, 6, 10, 14, 9  # number of loops, places of z, u and true states, and their number


@called
def step_rk4_2(c: Array, x: Array, h: float, v_a: float, v_b: float, v_c: float, v_d: float) -> None:
    """One classical Runge-Kutta step of length h s with the valves as given; `x` (9,) moves in place."""
    s0, a0, b0, c0, d0, q0, r0, w0, v0 = x[0], x[1], x[2], x[3], x[4], x[5], x[6], x[7], x[8]
    k1s, k1a, k1b, k1c, k1d, k1w, k1v = moving2(c, s0, a0, b0, c0, d0, q0, r0, w0, v0, v_a, v_b, v_c, v_d)
    half = 0.5 * h
    w2, v2 = w0 + half * k1w, v0 + half * k1v
    k2s, k2a, k2b, k2c, k2d, k2w, k2v = moving2(
        c, s0 + half * k1s, a0 + half * k1a, b0 + half * k1b, c0 + half * k1c, d0 + half * k1d,
        q0 + half * w0, r0 + half * v0, w2, v2, v_a, v_b, v_c, v_d,
    )  # fmt: skip
    w3, v3 = w0 + half * k2w, v0 + half * k2v
    k3s, k3a, k3b, k3c, k3d, k3w, k3v = moving2(
        c, s0 + half * k2s, a0 + half * k2a, b0 + half * k2b, c0 + half * k2c, d0 + half * k2d,
        q0 + half * w2, r0 + half * v2, w3, v3, v_a, v_b, v_c, v_d,
    )  # fmt: skip
    w4, v4 = w0 + h * k3w, v0 + h * k3v
    k4s, k4a, k4b, k4c, k4d, k4w, k4v = moving2(
        c, s0 + h * k3s, a0 + h * k3a, b0 + h * k3b, c0 + h * k3c, d0 + h * k3d,
        q0 + h * w3, r0 + h * v3, w4, v4, v_a, v_b, v_c, v_d,
    )  # fmt: skip
    sixth = h / 6.0
    x[0] = s0 + sixth * (k1s + 2.0 * (k2s + k3s) + k4s)
    x[1] = a0 + sixth * (k1a + 2.0 * (k2a + k3a) + k4a)
    x[2] = b0 + sixth * (k1b + 2.0 * (k2b + k3b) + k4b)
    x[3] = c0 + sixth * (k1c + 2.0 * (k2c + k3c) + k4c)
    x[4] = d0 + sixth * (k1d + 2.0 * (k2d + k3d) + k4d)
    x[5] = q0 + sixth * (w0 + 2.0 * (w2 + w3) + w4)
    x[6] = r0 + sixth * (v0 + 2.0 * (v2 + v3) + v4)
    x[7] = w0 + sixth * (k1w + 2.0 * (k2w + k3w) + k4w)
    x[8] = v0 + sixth * (k1v + 2.0 * (k2v + k3v) + k4v)


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
            step_rk4_2(
                c, x, stop - now, valves_at(u[0], closes[0], now), valves_at(u[1], closes[1], now),
                valves_at(u[2], closes[2], now), valves_at(u[3], closes[3], now),
            )  # fmt: skip
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
    c: Array,
    sensors: Sensors,
    x: Array,
    biquads_theta1: Array,
    biquads_theta2: Array,
    biquads_p_a: Array,
    biquads_p_c: Array,
    controller_state: Array,
    wiring: Wiring,
    references: Array,
    injected: Array,
    injection: int,
    closed: bool,
    tick_s: float,
    period_ticks: int,
    dead_zone: float,
    steps: int,
    random_state: int,
    out: Array,
) -> tuple[int, int]:
    """Simulate as many ticks as `references` (n, 4: rad, rad, Pa, Pa) has; fills `out` (n, 14 or 23) by `LOGGED`.

    `x` (9,), `controller_state` (4, sections, 2) and the schedules of `wiring` move in place. Gives why it ended and
    how many ticks are logged.
    The constants' `SHARED` is the strategy: 1 measures and drives both muscles of a pair by its pressure loop, 0 one.
    Sensor spans: angles are centred, pressures start at 0; beyond them the converters clip.
    """
    u, closes, shared, signals = np.zeros(4), np.zeros(4), c[SHARED], np.zeros(2 * LOOPS)
    errors, v, entering, follows = np.zeros(LOOPS), np.zeros(LOOPS), np.zeros(LOOPS), wiring.scheduled.any()
    for tick in range(references.shape[0]):
        random_state = sense2(x, sensors, random_state, out[tick])
        if closed:
            compare2(references, out, tick, shared, errors)
            if injection == CONTROLLER_INPUT:
                add(injected, tick, errors)
            v[0] = biquads.step(biquads_theta1, controller_state[0], errors[0])
            v[1] = biquads.step(biquads_theta2, controller_state[1], errors[1])
            v[2] = biquads.step(biquads_p_a, controller_state[2], errors[2])
            v[3] = biquads.step(biquads_p_c, controller_state[3], errors[3])
            if follows:
                told2(references, out, tick, shared, signals)
                by_schedules(wiring, signals, errors, v)
        else:
            v[0], v[1], v[2], v[3] = injected[tick, 0], injected[tick, 1], injected[tick, 2], injected[tick, 3]
        out[tick, Z], out[tick, Z + 1], out[tick, Z + 2], out[tick, Z + 3] = v[0], v[1], v[2], v[3]
        if closed and injection == PLANT_INPUT:
            add(injected, tick, v)
        decoupled(wiring.decoupling, v, entering)
        log2(out, tick, entering, shared, x)
        phase = tick % period_ticks
        if phase == 0:
            for k in range(4):
                u[k] = out[tick, U + k]
                closes[k] = pwm.pulse_s(u[k], period_ticks * tick_s, dead_zone)
        integrate2(c, x, phase * tick_s, (phase + 1) * tick_s, steps, u, closes)
        ended = range_left2(x, sensors)
        if ended != COMPLETE:
            return ended, tick + 1
    return COMPLETE, references.shape[0]
