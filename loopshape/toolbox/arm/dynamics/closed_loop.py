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

from loopshape.core.kernels import biquads
from loopshape.core.kernels.compiled import compiled
from loopshape.core.units import Array
from loopshape.toolbox.arm.dynamics import memory, model, valves
from loopshape.toolbox.arm.dynamics.model import State, Valves, called, in_line, moving
from loopshape.toolbox.arm.dynamics.pwm import is_open
from loopshape.toolbox.arm.effect import effect_parameters as e
from loopshape.toolbox.arm.parameters import Sensors
from loopshape.toolbox.gap import noise
from loopshape.toolbox.schedules import kernel as scheduled

EDGES, GRID = 0, 1
COMPLETE, LEFT_ANGLE, LEFT_PRESSURE, NOT_FINITE = 0, 1, 2, 3
LEFT_THETA1, LEFT_THETA2 = 4, 5  # where there are two joints
CONTROLLER_INPUT, PLANT_INPUT, CONTROL = 0, 1, 2

#: columns of the log, pressures in Pa: measured angle and pressures, z and u; true states after them if asked
LOGGED = ("theta2", "p_a", "p_b", "z_theta2", "z_p", "u_a", "u_b", "angle", "velocity", "true_a", "true_b", "p_c")
MEASURED = 7
LOWEST_PA, WIDEST = 5e2, 1.2  # a followed state stays inside: a wrong hypothesis shall err, not break


class Mechanism(NamedTuple):
    """An arm under way: constants, state (7,), memory (32,), what it holds (16,), the valves' schedule and edges."""

    c: Array
    x: Array
    m: Array
    held: Array
    schedule: Array
    edges: Array


class Controllers(NamedTuple):
    """The loops' controllers: biquads (n, 5) of each and the states (loops, n, 2) of all, or a schedule.

    `scheduled` says whose schedule it is that answers, which may follow the references, then the outputs, of all loops
    in stored units. `decoupling` is the matrix between the controllers and the plant.
    """

    sections: tuple[Array, ...]
    state: Array
    schedules: tuple[scheduled.Scheduled, ...]
    scheduled: np.ndarray
    decoupling: Array


class Inputs(NamedTuple):
    """What goes in: references and what is injected (n, loops), where, whether the loops are closed; the noise's state.

    References are in rad and Pa. Of open loops the injected signals are what the controllers would answer.
    """

    references: Array
    injected: Array
    injection: int
    closed: bool
    random_state: int


class Pwm(NamedTuple):
    """A controller's tick in s, how many of them are a period, and the size up to which a command opens nothing."""

    tick_s: float
    period_ticks: int
    dead_zone: float


def at_rest(c: Array, x: Array) -> Mechanism:
    """An arm that has long rested in the state `x` (7,), which moves in place."""
    m, held = np.empty(memory.SIZE), np.zeros(model.HELD)
    memory.start(c, x, m)
    held[model.COULOMB] = c[e.COULOMB]
    return Mechanism(c, x, m, held, np.zeros(2 * valves.EACH), np.empty(valves.MOST_EDGES))


def plain_controllers(*sections: Array) -> Controllers:
    """Controllers that stay as they are, each straight on its own input."""
    loops = len(sections)
    state = np.zeros((loops, max(len(one) for one in sections), 2))
    return Controllers(
        sections, state, (scheduled.none(2 * loops),) * loops, np.zeros(loops, dtype=bool), np.eye(loops)
    )


@compiled
def by_schedules(loops: Controllers, signals: Array, errors: Array, z: Array) -> None:
    """Replace what the loops' controllers answer, `z`, where a loop has a schedule."""
    for k in range(z.size):
        if loops.scheduled[k]:
            scheduled.follow(loops.schedules[k], signals)
            z[k] = scheduled.step(loops.schedules[k], errors[k])


@in_line
def decoupled(matrix: Array, v: Array, out: Array) -> None:
    """Fill `out` with the matrix times `v`."""
    for i in range(out.size):
        out[i] = 0.0
        for j in range(v.size):
            out[i] += matrix[i, j] * v[j]


@in_line
def ahead(s: State, h: float, k: State) -> State:
    """A state h s on at the rates `k`."""
    return (
        s[0] + h * k[0], s[1] + h * k[1], s[2] + h * k[2], s[3] + h * k[3], s[4] + h * k[4], s[5] + h * k[5],
        s[6] + h * k[6],
    )  # fmt: skip


@in_line
def step_rk4(c: Array, held: Array, x: Array, h: float, areas: Valves) -> None:
    """One classical Runge-Kutta step of length h s with the valves as given; `x` (7,) moves in place."""
    s = x[0], x[1], x[2], x[3], x[4], x[5], x[6]
    k1 = moving(c, held, s, areas)
    k2 = moving(c, held, ahead(s, 0.5 * h, k1), areas)
    k3 = moving(c, held, ahead(s, 0.5 * h, k2), areas)
    k4 = moving(c, held, ahead(s, h, k3), areas)
    sixth = h / 6.0
    x[0] = s[0] + sixth * (k1[0] + 2.0 * (k2[0] + k3[0]) + k4[0])
    x[1] = s[1] + sixth * (k1[1] + 2.0 * (k2[1] + k3[1]) + k4[1])
    x[2] = s[2] + sixth * (k1[2] + 2.0 * (k2[2] + k3[2]) + k4[2])
    x[3] = s[3] + sixth * (k1[3] + 2.0 * (k2[3] + k3[3]) + k4[3])
    x[4] = s[4] + sixth * (k1[4] + 2.0 * (k2[4] + k3[4]) + k4[4])
    x[5] = s[5] + sixth * (k1[5] + 2.0 * (k2[5] + k3[5]) + k4[5])
    x[6] = s[6] + sixth * (k1[6] + 2.0 * (k2[6] + k3[6]) + k4[6])


@called
def integrate_edges(arm: Mechanism, start_s: float, end_s: float, steps: int, n_edges: int) -> None:
    """Integrate from `start_s` to `end_s` of a PWM period in `steps`, splitting each where a valve moves."""
    c, x, m, held = arm.c, arm.x, arm.m, arm.held
    h = (end_s - start_s) / steps
    for k in range(steps):
        now = start_s + k * h
        end = end_s if k == steps - 1 else start_s + (k + 1) * h
        while now < end:
            stop = end
            for j in range(n_edges):
                if now < arm.edges[j] < stop:
                    stop = arm.edges[j]
            middle = 0.5 * (now + stop)
            areas = valves.areas(c, arm.schedule, middle)
            if c[e.MEMORY] > 0.0:
                memory.hold(c, x, m, held, stop - now, areas)
            step_rk4(c, held, x, stop - now, areas)
            if c[e.MEMORY] > 0.0:
                memory.move_on(c, x, m, held, stop - now)
            now = stop


@called
def grid_rates(c: Array, held: Array, s: State, phase: float, u: tuple[float, float], dead_zone: float) -> State:
    """Rates of a state with a stiff coupling, with the valves looked up at `phase` of the PWM period."""
    open_a = 1.0 if is_open(u[0], phase, dead_zone) else 0.0
    open_b = 1.0 if is_open(u[1], phase, dead_zone) else 0.0
    areas = (
        open_a if u[0] > 0.0 else 0.0, open_b if u[1] > 0.0 else 0.0,
        open_a if u[0] < 0.0 else 0.0, open_b if u[1] < 0.0 else 0.0,
    )  # fmt: skip
    return moving(c, held, (s[0], s[1], s[2], s[3], s[4], s[3], s[4]), areas)


@called
def integrate_grid(
    c: Array, held: Array, x: Array, start_s: float, end_s: float, steps: int, u: tuple[float, float], pwm: Pwm
) -> None:
    """Integrate by Bogacki and Shampine's third-order method, valves looked up at 0, 1/2 and 3/4 of a step."""
    h, period_s, dead_zone = (end_s - start_s) / steps, pwm.period_ticks * pwm.tick_s, pwm.dead_zone
    for k in range(steps):
        now = start_s + k * h
        s = x[0], x[1], x[2], x[3], x[4], x[3], x[4]
        k1 = grid_rates(c, held, s, now / period_s, u, dead_zone)
        k2 = grid_rates(c, held, ahead(s, 0.5 * h, k1), (now + 0.5 * h) / period_s, u, dead_zone)
        k3 = grid_rates(c, held, ahead(s, 0.75 * h, k2), (now + 0.75 * h) / period_s, u, dead_zone)
        ninth = h / 9.0
        x[0] = s[0] + ninth * (2.0 * k1[0] + 3.0 * k2[0] + 4.0 * k3[0])
        x[1] = s[1] + ninth * (2.0 * k1[1] + 3.0 * k2[1] + 4.0 * k3[1])
        x[2] = s[2] + ninth * (2.0 * k1[2] + 3.0 * k2[2] + 4.0 * k3[2])
        x[3] = s[3] + ninth * (2.0 * k1[3] + 3.0 * k2[3] + 4.0 * k3[3])
        x[4] = s[4] + ninth * (2.0 * k1[4] + 3.0 * k2[4] + 4.0 * k3[4])


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
def log_states(x: Array, out: Array, tick: int) -> None:
    """The true states in a row of the log, where it has room for them."""
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
    arm: Mechanism, sensors: Sensors, loops: Controllers, inputs: Inputs, pwm: Pwm, solver: int, steps: int, out: Array
) -> tuple[int, int]:
    """Simulate as many ticks as there are references (n, 2: rad, Pa); fills `out` (n, 7 or 12) by `LOGGED`.

    The arm, the controllers and their schedules move in place. Gives why it ended and how many ticks are logged.
    Sensor spans: the angle is centred, the pressure starts at 0; beyond them the converters clip.
    """
    c, x, m, held, schedule, edges = arm  # here: in the loop each reference would be counted
    references, injected, random_state = inputs.references, inputs.injected, inputs.random_state
    biquads_theta, biquads_p, state, matrix = loops.sections[0], loops.sections[1], loops.state, loops.decoupling
    tick_s, period_ticks = pwm.tick_s, pwm.period_ticks
    period_s = period_ticks * tick_s
    signals, errors, v, entering = np.zeros(4), np.zeros(2), np.zeros(2), np.zeros(2)
    follows = loops.scheduled.any()
    n_edges, u_a, u_b = 0, 0.0, 0.0
    slack, has_spare = 0.0, False
    for tick in range(references.shape[0]):
        true, true_a, true_b = memory.sensed(c, x, m, tick_s)
        theta, p_a, p_b, random_state, slack, has_spare = sense(
            true, true_a, true_b, sensors, random_state, slack, has_spare
        )
        if inputs.closed:
            errors[0] = references[tick, 0] - theta
            errors[1] = 1e-5 * (references[tick, 1] - (p_a + p_b))
            if inputs.injection == CONTROLLER_INPUT:
                errors += injected[tick]
            v[0] = biquads.step(biquads_theta, state[0], errors[0])
            v[1] = biquads.step(biquads_p, state[1], errors[1])
            if follows:
                signals[0], signals[1] = references[tick, 0], 1e-5 * references[tick, 1]
                signals[2], signals[3] = theta, 1e-5 * (p_a + p_b)
                by_schedules(loops, signals, errors, v)
        else:
            v[0], v[1] = injected[tick, 0], injected[tick, 1]
        out[tick, 0], out[tick, 1], out[tick, 2], out[tick, 3], out[tick, 4] = theta, p_a, p_b, v[0], v[1]
        if inputs.closed and inputs.injection == PLANT_INPUT:
            v += injected[tick]
        decoupled(matrix, v, entering)
        out[tick, 5], out[tick, 6] = entering[0] + entering[1], entering[1] - entering[0]
        log_states(x, out, tick)

        phase = tick % period_ticks
        if phase == 0:
            u_a, u_b = late(out, 5, tick, c[e.LOOP_DELAY] / tick_s), late(out, 6, tick, c[e.LOOP_DELAY] / tick_s)
            n_edges = valves.plan_period(c, schedule, edges, u_a, u_b, period_s, pwm.dead_zone)
        start, end = phase * tick_s, (phase + 1) * tick_s
        if solver == EDGES:
            integrate_edges(arm, start, end, steps, n_edges)
        else:
            integrate_grid(c, held, x, start, end, steps, (u_a, u_b), pwm)
        ended = range_left(x, sensors)
        if ended != COMPLETE:
            return ended, tick + 1
    return COMPLETE, references.shape[0]


@compiled
def follow(arm: Mechanism, commands: Array, measured: Array, gains: Array, lead: int, pwm: Pwm, stride: int) -> Array:
    """The arm driven by logged commands (n, 2: u_A, u_B), pulled towards what was measured (rows, 3: rad, Pa, Pa).

    A row is `stride` ticks, one step between the valves' edges. Gains (2, 3) per row, of the first `lead` rows and of
    the others: pressures, angle, and velocity per angle in 1/s; zero leaves the model to itself. Gives the sensors'
    answers (rows, 3) before each pull.
    """
    c, x, m, out = arm.c, arm.x, arm.m, np.empty_like(measured)
    period_s, row_s = pwm.period_ticks * pwm.tick_s, stride * pwm.tick_s
    delay = c[e.LOOP_DELAY] / pwm.tick_s
    n_edges = 0
    for row in range(measured.shape[0]):
        theta, p_a, p_b = memory.sensed(c, x, m, row_s)
        out[row, 0], out[row, 1], out[row, 2] = theta, p_a, p_b
        off = measured[row, 0] - theta
        g = gains[0] if row < lead else gains[1]
        x[1] += g[0] * (measured[row, 1] - p_a)
        x[2] += g[0] * (measured[row, 2] - p_b)
        x[3] += g[1] * off
        x[4] += g[2] * off
        x[1], x[2] = max(x[1], LOWEST_PA), max(x[2], LOWEST_PA)
        x[3] = min(max(x[3], -WIDEST), WIDEST)
        phase = (row * stride) % pwm.period_ticks
        if phase == 0:
            u_a, u_b = late(commands, 0, row * stride, delay), late(commands, 1, row * stride, delay)
            n_edges = valves.plan_period(c, arm.schedule, arm.edges, u_a, u_b, period_s, pwm.dead_zone)
        start = phase * pwm.tick_s
        integrate_edges(arm, start, start + row_s, 1, n_edges)
    return out
