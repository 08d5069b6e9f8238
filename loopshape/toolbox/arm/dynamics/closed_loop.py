"""The 1-DoF arm under its controllers: one compiled loop over 1 ms ticks.

Order inside a tick: measure, control, log, start a PWM period if one is due (from this tick's u), integrate.
Two ways to integrate: `EDGES` steps by the classical Runge-Kutta method of order 4 and splits each step where
a valve closes; `GRID` is the source's way, Bogacki and Shampine's method of order 3 (1989) with the valves
looked up at each stage's time, so that an edge is seen late or early by up to a stage; it knows no effect that
delays valves, remembers, or bends the coupling.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from loopshape.core.kernels import biquads, noise, scheduled
from loopshape.core.kernels.compiled import compiled
from loopshape.core.units import Array
from loopshape.toolbox.arm.dynamics import memory, model, pwm, valves
from loopshape.toolbox.arm.dynamics.model import called, in_line, moving
from loopshape.toolbox.arm.effect import effect_parameters as e
from loopshape.toolbox.arm.parameters import Sensors

EDGES, GRID = 0, 1
COMPLETE, LEFT_ANGLE, LEFT_PRESSURE, NOT_FINITE = 0, 1, 2, 3
LEFT_THETA1, LEFT_THETA2 = 4, 5  # where there are two joints
CONTROLLER_INPUT, PLANT_INPUT, CONTROL = 0, 1, 2

#: columns of the log, pressures in Pa: measured angle and pressures, z and u; true states after them if asked
LOGGED = ("theta2", "p_a", "p_b", "z_theta2", "z_p", "u_a", "u_b", "angle", "velocity", "true_a", "true_b", "p_c")
MEASURED = 7
LOWEST_PA, WIDEST = 5e2, 1.2  # a followed state stays inside: a wrong hypothesis shall err, not break


class Wiring(NamedTuple):
    """Schedules of the controllers, which of them there are, and the matrix between the controllers and the plant.

    A schedule may follow the references, then the outputs, of all loops in stored units.
    """

    schedules: tuple[scheduled.Scheduled, ...]
    scheduled: np.ndarray
    decoupling: Array


def plain_wiring(loops: int) -> Wiring:
    """Controllers that stay as they are, each straight on its own input."""
    return Wiring((scheduled.none(2 * loops),) * loops, np.zeros(loops, dtype=bool), np.eye(loops))


@compiled
def by_schedules(wiring: Wiring, signals: Array, errors: Array, z: Array) -> None:
    """Replace what the loops' controllers answer, `z`, where a loop has a schedule."""
    for k in range(z.size):
        if wiring.scheduled[k]:
            scheduled.follow(wiring.schedules[k], signals)
            z[k] = scheduled.step(wiring.schedules[k], errors[k])


@in_line
def decoupled(matrix: Array, v: Array, out: Array) -> None:
    """Fill `out` with the matrix times `v`."""
    for i in range(out.size):
        out[i] = 0.0
        for j in range(v.size):
            out[i] += matrix[i, j] * v[j]


@in_line
def step_rk4(c: Array, held: Array, x: Array, h: float, in_a: float, in_b: float, out_a: float, out_b: float) -> None:
    """One classical Runge-Kutta step of length h s with the valves as given; `x` (7,) moves in place."""
    c0, a0, b0, q0, w0, s0, v0 = x[0], x[1], x[2], x[3], x[4], x[5], x[6]
    k1c, k1a, k1b, k1w, k1v = moving(c, held, c0, a0, b0, q0, w0, s0, v0, in_a, in_b, out_a, out_b)
    half = 0.5 * h
    w2, v2 = w0 + half * k1w, v0 + half * k1v
    k2c, k2a, k2b, k2w, k2v = moving(
        c, held, c0 + half * k1c, a0 + half * k1a, b0 + half * k1b, q0 + half * w0, w2, s0 + half * v0, v2,
        in_a, in_b, out_a, out_b,
    )  # fmt: skip
    w3, v3 = w0 + half * k2w, v0 + half * k2v
    k3c, k3a, k3b, k3w, k3v = moving(
        c, held, c0 + half * k2c, a0 + half * k2a, b0 + half * k2b, q0 + half * w2, w3, s0 + half * v2, v3,
        in_a, in_b, out_a, out_b,
    )  # fmt: skip
    w4, v4 = w0 + h * k3w, v0 + h * k3v
    k4c, k4a, k4b, k4w, k4v = moving(
        c, held, c0 + h * k3c, a0 + h * k3a, b0 + h * k3b, q0 + h * w3, w4, s0 + h * v3, v4,
        in_a, in_b, out_a, out_b,
    )  # fmt: skip
    sixth = h / 6.0
    x[0] = c0 + sixth * (k1c + 2.0 * (k2c + k3c) + k4c)
    x[1] = a0 + sixth * (k1a + 2.0 * (k2a + k3a) + k4a)
    x[2] = b0 + sixth * (k1b + 2.0 * (k2b + k3b) + k4b)
    x[3] = q0 + sixth * (w0 + 2.0 * (w2 + w3) + w4)
    x[4] = w0 + sixth * (k1w + 2.0 * (k2w + k3w) + k4w)
    x[5] = s0 + sixth * (v0 + 2.0 * (v2 + v3) + v4)
    x[6] = v0 + sixth * (k1v + 2.0 * (k2v + k3v) + k4v)


@called
def integrate_edges(
    c: Array, held: Array, x: Array, m: Array, start_s: float, end_s: float, steps: int, schedule: Array,
    edges: Array, n_edges: int,
) -> None:  # fmt: skip
    """Integrate from `start_s` to `end_s` of a PWM period in `steps`, splitting each where a valve moves."""
    h = (end_s - start_s) / steps
    for k in range(steps):
        now = start_s + k * h
        end = end_s if k == steps - 1 else start_s + (k + 1) * h
        while now < end:
            stop = end
            for j in range(n_edges):
                if now < edges[j] < stop:
                    stop = edges[j]
            middle = 0.5 * (now + stop)
            in_a, in_b, out_a, out_b = valves.areas(c, schedule, middle)
            if c[e.MEMORY] > 0.0:
                memory.hold(c, x, m, held, stop - now, in_a, in_b, out_a, out_b)
            step_rk4(c, held, x, stop - now, in_a, in_b, out_a, out_b)
            if c[e.MEMORY] > 0.0:
                memory.move_on(c, x, m, held, stop - now)
            now = stop


@called
def grid_derivatives(
    c: Array, held: Array, p_c: float, p_a: float, p_b: float, angle: float, velocity: float,
    phase: float, u_a: float, u_b: float, dead_zone: float,
) -> tuple[float, float, float, float]:  # fmt: skip
    """Right-hand side with the valves looked up at `phase` of the PWM period."""
    open_a = 1.0 if pwm.is_open(u_a, phase, dead_zone) else 0.0
    open_b = 1.0 if pwm.is_open(u_b, phase, dead_zone) else 0.0
    d_c, d_a, d_b, turn, _ = moving(
        c, held, p_c, p_a, p_b, angle, velocity, angle, velocity,
        open_a if u_a > 0.0 else 0.0, open_b if u_b > 0.0 else 0.0,
        open_a if u_a < 0.0 else 0.0, open_b if u_b < 0.0 else 0.0,
    )  # fmt: skip
    return d_c, d_a, d_b, turn


@called
def integrate_grid(
    c: Array,
    held: Array,
    x: Array,
    start_s: float,
    end_s: float,
    steps: int,
    u_a: float,
    u_b: float,
    period_s: float,
    dead_zone: float,
) -> None:
    """Integrate by Bogacki and Shampine's third-order method, valves looked up at 0, 1/2 and 3/4 of a step."""
    h = (end_s - start_s) / steps
    for k in range(steps):
        now = start_s + k * h
        c0, a0, b0, q0, w0 = x[0], x[1], x[2], x[3], x[4]
        k1c, k1a, k1b, k1w = grid_derivatives(c, held, c0, a0, b0, q0, w0, now / period_s, u_a, u_b, dead_zone)
        s = 0.5 * h
        w2 = w0 + s * k1w
        k2c, k2a, k2b, k2w = grid_derivatives(
            c,
            held,
            c0 + s * k1c,
            a0 + s * k1a,
            b0 + s * k1b,
            q0 + s * w0,
            w2,
            (now + s) / period_s,
            u_a,
            u_b,
            dead_zone,
        )
        s = 0.75 * h
        w3 = w0 + s * k2w
        k3c, k3a, k3b, k3w = grid_derivatives(
            c,
            held,
            c0 + s * k2c,
            a0 + s * k2a,
            b0 + s * k2b,
            q0 + s * w2,
            w3,
            (now + s) / period_s,
            u_a,
            u_b,
            dead_zone,
        )
        ninth = h / 9.0
        x[0] = c0 + ninth * (2.0 * k1c + 3.0 * k2c + 4.0 * k3c)
        x[1] = a0 + ninth * (2.0 * k1a + 3.0 * k2a + 4.0 * k3a)
        x[2] = b0 + ninth * (2.0 * k1b + 3.0 * k2b + 4.0 * k3b)
        x[3] = q0 + ninth * (2.0 * w0 + 3.0 * w2 + 4.0 * w3)
        x[4] = w0 + ninth * (2.0 * k1w + 3.0 * k2w + 4.0 * k3w)


@in_line
def converted(value: float, step: float, low: float, high: float) -> float:
    """Value after a converter of this step (0: none) and span."""
    if step == 0.0:
        return value
    return min(max(step * round(value / step), low), high)


@in_line
def sense(
    theta: float, p_a: float, p_b: float, sensors: Sensors, random_state: int, slack: float, has_spare: bool
) -> tuple[float, float, float, int, float, bool]:
    """Angle and pressures (rad, Pa, Pa) with noise and converters, and the noise's state after."""
    if sensors.noise_rad > 0.0 or sensors.noise_pa > 0.0:
        random_state, n1, n2 = noise.normal_pair(random_state)
        if has_spare:
            n3, has_spare = slack, False
        else:
            random_state, n3, slack = noise.normal_pair(random_state)
            has_spare = True
        theta += sensors.noise_rad * n1
        p_a += sensors.noise_pa * n2
        p_b += sensors.noise_pa * n3
    theta = converted(theta, sensors.step_rad, -sensors.reach_rad, sensors.reach_rad)
    p_a = converted(p_a, sensors.step_pa, 0.0, sensors.reach_pa)
    return theta, p_a, converted(p_b, sensors.step_pa, 0.0, sensors.reach_pa), random_state, slack, has_spare


@in_line
def log(
    out: Array, tick: int, theta: float, p_a: float, p_b: float, z_theta: float, z_p: float, u_a: float, u_b: float,
    x: Array,
) -> None:  # fmt: skip
    """One row of the log; the true states too where `out` has room for them."""
    out[tick, 0], out[tick, 1], out[tick, 2] = theta, p_a, p_b
    out[tick, 3], out[tick, 4], out[tick, 5], out[tick, 6] = z_theta, z_p, u_a, u_b
    if out.shape[1] > MEASURED:
        out[tick, 7], out[tick, 8], out[tick, 9], out[tick, 10], out[tick, 11] = x[3], x[4], x[1], x[2], x[0]


@in_line
def range_left(x: Array, sensors: Sensors) -> int:
    """Which limit of the model's range the state has passed, or COMPLETE."""
    if not math.isfinite(x[0] + x[1] + x[2] + x[3] + x[4]):
        return NOT_FINITE
    if abs(x[3]) > sensors.limit_rad:
        return LEFT_ANGLE
    if min(x[1], x[2]) < sensors.lowest_pa or max(x[1], x[2]) > sensors.highest_pa:
        return LEFT_PRESSURE
    return COMPLETE


@in_line
def late(commands: Array, column: int, tick: int, delay_ticks: float) -> float:
    """A logged command as it was `delay_ticks` ago, between two rows their weighted mean; at first the first row's."""
    if delay_ticks == 0.0:
        return commands[tick, column]
    at = max(tick - delay_ticks, 0.0)
    row = int(at)
    share = at - row
    return (
        commands[row, column]
        if share == 0.0
        else (1.0 - share) * commands[row, column] + share * commands[row + 1, column]
    )


@compiled
def run(
    c: Array,
    sensors: Sensors,
    x: Array,
    m: Array,
    biquads_theta: Array,
    biquads_p: Array,
    controller_state: Array,
    wiring: Wiring,
    references: Array,
    injected: Array,
    injection: int,
    closed: bool,
    tick_s: float,
    period_ticks: int,
    dead_zone: float,
    solver: int,
    steps: int,
    random_state: int,
    out: Array,
) -> tuple[int, int]:
    """Simulate as many ticks as `references` (n, 2: rad, Pa) has; fills `out` (n, 7 or 12) by `LOGGED`.

    `x` (7,), the memory `m` (32,), `controller_state` (2, sections, 2) and the schedules of `wiring` move in place.
    Gives why it ended and how many ticks are logged. Sensor spans: the angle is centred, the pressure starts at 0;
    beyond them the converters clip.
    """
    period_s = period_ticks * tick_s
    held, schedule, edges = np.zeros(model.HELD), np.zeros(2 * valves.EACH), np.empty(valves.MOST_EDGES)
    held[model.COULOMB] = c[e.COULOMB]
    signals, errors, v, entering = np.zeros(4), np.zeros(2), np.zeros(2), np.zeros(2)
    follows = wiring.scheduled.any()
    n_edges, u_a, u_b = 0, 0.0, 0.0
    slack, has_spare = 0.0, False
    for tick in range(references.shape[0]):
        true, true_a, true_b = memory.sensed(c, x, m, tick_s)
        theta, p_a, p_b, random_state, slack, has_spare = sense(
            true, true_a, true_b, sensors, random_state, slack, has_spare
        )
        if closed:
            errors[0] = references[tick, 0] - theta
            errors[1] = 1e-5 * (references[tick, 1] - (p_a + p_b))
            if injection == CONTROLLER_INPUT:
                errors += injected[tick]
            v[0] = biquads.step(biquads_theta, controller_state[0], errors[0])
            v[1] = biquads.step(biquads_p, controller_state[1], errors[1])
            if follows:
                signals[0], signals[1] = references[tick, 0], 1e-5 * references[tick, 1]
                signals[2], signals[3] = theta, 1e-5 * (p_a + p_b)
                by_schedules(wiring, signals, errors, v)
        else:
            v[0], v[1] = injected[tick, 0], injected[tick, 1]
        z_theta, z_p = v[0], v[1]
        if closed and injection == PLANT_INPUT:
            v += injected[tick]
        decoupled(wiring.decoupling, v, entering)

        log(out, tick, theta, p_a, p_b, z_theta, z_p, entering[0] + entering[1], entering[1] - entering[0], x)
        phase = tick % period_ticks
        if phase == 0:
            u_a, u_b = late(out, 5, tick, c[e.LOOP_DELAY] / tick_s), late(out, 6, tick, c[e.LOOP_DELAY] / tick_s)
            n_edges = valves.plan_period(c, schedule, edges, u_a, u_b, period_s, dead_zone)
        start, end = phase * tick_s, (phase + 1) * tick_s
        if solver == EDGES:
            integrate_edges(c, held, x, m, start, end, steps, schedule, edges, n_edges)
        else:
            integrate_grid(c, held, x, start, end, steps, u_a, u_b, period_s, dead_zone)
        ended = range_left(x, sensors)
        if ended != COMPLETE:
            return ended, tick + 1
    return COMPLETE, references.shape[0]


@compiled
def follow(
    c: Array,
    x: Array,
    m: Array,
    commands: Array,
    measured: Array,
    first_gains: Array,
    gains: Array,
    lead: int,
    tick_s: float,
    stride: int,
    period_ticks: int,
    dead_zone: float,
    out: Array,
) -> None:
    """The arm driven by logged commands (n, 2: u_A, u_B), pulled towards what was measured (rows, 3: rad, Pa, Pa).

    A row is `stride` ticks, one step between the valves' edges. Gains (3,) per row: pressures, angle, and velocity
    per angle in 1/s; zero leaves the model to itself; the first `lead` rows have their own. Fills `out` (rows, 3)
    with the sensors' answers before each pull.
    """
    period_s, row_s = period_ticks * tick_s, stride * tick_s
    held, schedule, edges = np.zeros(model.HELD), np.zeros(2 * valves.EACH), np.empty(valves.MOST_EDGES)
    held[model.COULOMB] = c[e.COULOMB]
    delay = c[e.LOOP_DELAY] / tick_s
    n_edges = 0
    for row in range(measured.shape[0]):
        theta, p_a, p_b = memory.sensed(c, x, m, row_s)
        out[row, 0], out[row, 1], out[row, 2] = theta, p_a, p_b
        off = measured[row, 0] - theta
        g = first_gains if row < lead else gains
        x[1] += g[0] * (measured[row, 1] - p_a)
        x[2] += g[0] * (measured[row, 2] - p_b)
        x[3] += g[1] * off
        x[4] += g[2] * off
        x[1], x[2] = max(x[1], LOWEST_PA), max(x[2], LOWEST_PA)
        x[3] = min(max(x[3], -WIDEST), WIDEST)
        phase = (row * stride) % period_ticks
        if phase == 0:
            u_a, u_b = late(commands, 0, row * stride, delay), late(commands, 1, row * stride, delay)
            n_edges = valves.plan_period(c, schedule, edges, u_a, u_b, period_s, dead_zone)
        start = phase * tick_s
        integrate_edges(c, held, x, m, start, start + row_s, 1, schedule, edges, n_edges)
