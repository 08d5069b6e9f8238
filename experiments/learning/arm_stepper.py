"""The 1-DoF arm, one action at a time: the package's kernel with its state kept between calls.

Same functions, order and noise as `closed_loop.run` with open loops: a row of the log is what the sensors give at a
tick, the PWM plans a period at its start, `integrate_edges` moves the state. An action lasts whole PWM periods.
Effects that delay commands by earlier rows (`loop_delay`) are not for this stepper.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from loopshape.core.errors import WrongUseError
from loopshape.core.kernels.compiled import compiled
from loopshape.core.kernels.noise import start_state
from loopshape.core.units import Array
from loopshape.toolbox.arm.dynamics import closed_loop as kernel
from loopshape.toolbox.arm.dynamics import memory, model, valves
from loopshape.toolbox.arm.dynamics.equilibrium import rest
from loopshape.toolbox.arm.effect import effect_parameters as e
from loopshape.toolbox.arm.parameters import ARM1_PARAMETERS, P_IN, Sensors, constants, sensor_constants

TICK_S = 1e-3
ROW = 3  # measured angle in rad, pressures in Pa


@compiled
def measure(
    c: Array, sensors: Sensors, x: Array, m: Array, draws: Array, slack: Array, tick_s: float, row: Array
) -> None:
    """What the sensors give now, into `row` (3,); the noise's state (1,) and spare draw (2,) move in place."""
    true, true_a, true_b = memory.sensed(c, x, m, tick_s)
    row[0], row[1], row[2], draws[0], slack[0], kept = kernel.sense(
        true, true_a, true_b, sensors, draws[0], slack[0], slack[1] > 0.0
    )
    slack[1] = 1.0 if kept else 0.0


@compiled
def act(
    c: Array, sensors: Sensors, x: Array, m: Array, held: Array, schedule: Array, edges: Array, draws: Array,
    slack: Array, u_a: float, u_b: float, tick_s: float, period_ticks: int, periods: int, dead_zone: float, out: Array,
) -> tuple[int, int]:  # fmt: skip
    """Hold the commands for `periods` of the PWM; a measured row after each tick into `out` (ticks, 3).

    Gives why it ended (`closed_loop.COMPLETE` where it did not) and how many rows are filled.
    """
    period_s, rows = period_ticks * tick_s, 0
    for _ in range(periods):
        n_edges = valves.plan_period(c, schedule, edges, u_a, u_b, period_s, dead_zone)
        for phase in range(period_ticks):
            start, end = phase * tick_s, (phase + 1) * tick_s
            kernel.integrate_edges(c, held, x, m, start, end, 1, schedule, edges, n_edges)
            ended = kernel.range_left(x, sensors)
            if ended != kernel.COMPLETE:
                return ended, rows
            measure(c, sensors, x, m, draws, slack, tick_s, out[rows])
            rows += 1
    return kernel.COMPLETE, rows


class SteppedArm:
    """One arm that can be put to rest somewhere and driven action by action; `row` is the latest measurement."""

    def __init__(self, action_s: float, changes: Mapping[str, float] | None = None) -> None:
        vector = ARM1_PARAMETERS.vector(dict(changes or {}))
        named = dict(zip(ARM1_PARAMETERS.names, vector.tolist(), strict=True))
        self._c, self._sensors = constants(vector), sensor_constants(vector)
        self._dead_zone = named["pwm_dead_zone"]
        self._period_ticks = round(1.0 / (named["pwm_frequency_hz"] * TICK_S))
        self._periods = round(action_s / (self._period_ticks * TICK_S))
        if abs(self._periods * self._period_ticks * TICK_S - action_s) > 1e-9 or self._periods < 1:
            raise WrongUseError("an action lasts whole PWM periods", f"{action_s:g} s", "use a multiple of 0.02 s")
        if self._c[e.LOOP_DELAY] > 0.0:
            raise WrongUseError("this stepper knows no delay of the loop", "loop_delay", "leave the effect out")
        self.ticks = self._periods * self._period_ticks
        self.row = np.zeros(ROW)

    def start(self, theta2_deg: float, p_ab_bar: float, seed: int) -> Array:
        """Put it to rest; gives the first measurement (3,): rad, Pa, Pa."""
        self._x = rest(self._c, theta2_deg, p_ab_bar, float(self._c[P_IN]))
        self._m = np.empty(memory.SIZE)
        memory.start(self._c, self._x, self._m)
        self._held = np.zeros(model.HELD)
        self._held[model.COULOMB] = self._c[e.COULOMB]
        self._schedule, self._edges = np.zeros(2 * valves.EACH), np.empty(valves.MOST_EDGES)
        self._draws, self._spare = np.array([start_state(seed)], dtype=np.int64), np.zeros(2)
        measure(self._c, self._sensors, self._x, self._m, self._draws, self._spare, TICK_S, self.row)
        return self.row

    def act(self, u_a: float, u_b: float) -> tuple[bool, Array]:
        """Hold the commands for one action: whether the arm is still in its range, and the rows measured meanwhile."""
        out = np.empty((self.ticks, ROW))
        ended, n = act(
            self._c, self._sensors, self._x, self._m, self._held, self._schedule, self._edges, self._draws,
            self._spare, u_a, u_b, TICK_S, self._period_ticks, self._periods, self._dead_zone, out,
        )  # fmt: skip
        if n:
            self.row = out[n - 1]
        return ended == kernel.COMPLETE, out[:n]
