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
from loopshape.core.units import Array
from loopshape.toolbox.arm.dynamics import closed_loop as kernel
from loopshape.toolbox.arm.dynamics import memory, valves
from loopshape.toolbox.arm.dynamics.equilibrium import rest
from loopshape.toolbox.arm.effect import effect_parameters as e
from loopshape.toolbox.arm.parameters import ARM1_PARAMETERS, P_IN, Sensors, constants, sensor_constants
from loopshape.toolbox.gap.noise import start_state

TICK_S = 1e-3
ROW = 3  # measured angle in rad, pressures in Pa


@compiled
def measure(arm: kernel.Mechanism, sensors: Sensors, draws: Array, slack: Array, tick_s: float, row: Array) -> None:
    """What the sensors give now, into `row` (3,); the noise's state (1,) and spare draw (2,) move in place."""
    true, true_a, true_b = memory.sensed(arm.c, arm.x, arm.m, tick_s)
    row[0], row[1], row[2], draws[0], slack[0], kept = kernel.sense(
        true, true_a, true_b, sensors, draws[0], slack[0], slack[1] > 0.0
    )
    slack[1] = 1.0 if kept else 0.0


@compiled
def act(
    arm: kernel.Mechanism,
    sensors: Sensors,
    draws: Array,
    slack: Array,
    u: tuple[float, float],
    pwm: kernel.Pwm,
    out: Array,
) -> tuple[int, int]:
    """Hold the commands for whole periods of the PWM; a measured row after each tick into `out` (ticks, 3).

    Gives why it ended (`closed_loop.COMPLETE` where it did not) and how many rows are filled.
    """
    tick_s, n_edges = pwm.tick_s, 0
    for row in range(len(out)):
        phase = row % pwm.period_ticks
        if phase == 0:
            period_s = pwm.period_ticks * tick_s
            n_edges = valves.plan_period(arm.c, arm.schedule, arm.edges, u[0], u[1], period_s, pwm.dead_zone)
        kernel.integrate_edges(arm, phase * tick_s, (phase + 1) * tick_s, 1, n_edges)
        ended = kernel.range_left(arm.x, sensors)
        if ended != kernel.COMPLETE:
            return ended, row
        measure(arm, sensors, draws, slack, tick_s, out[row])
    return kernel.COMPLETE, len(out)


class SteppedArm:
    """One arm that can be put to rest somewhere and driven action by action; `row` is the latest measurement."""

    def __init__(self, action_s: float, changes: Mapping[str, float] | None = None) -> None:
        vector = ARM1_PARAMETERS.vector(dict(changes or {}))
        named = dict(zip(ARM1_PARAMETERS.names, vector.tolist(), strict=True))
        self._c, self._sensors = constants(vector), sensor_constants(vector)
        period_ticks = round(1.0 / (named["pwm_frequency_hz"] * TICK_S))
        self._pwm = kernel.Pwm(TICK_S, period_ticks, named["pwm_dead_zone"])
        self.ticks = round(action_s / (period_ticks * TICK_S)) * period_ticks
        if abs(self.ticks * TICK_S - action_s) > 1e-9 or self.ticks < 1:
            raise WrongUseError("an action lasts whole PWM periods", f"{action_s:g} s", "use a multiple of 0.02 s")
        if self._c[e.LOOP_DELAY] > 0.0:
            raise WrongUseError("this stepper knows no delay of the loop", "loop_delay", "leave the effect out")
        self.row = np.zeros(ROW)

    def start(self, theta2_deg: float, p_ab_bar: float, seed: int) -> Array:
        """Put it to rest; gives the first measurement (3,): rad, Pa, Pa."""
        self._arm = kernel.at_rest(self._c, rest(self._c, theta2_deg, p_ab_bar, float(self._c[P_IN])))
        self._draws, self._spare = np.array([start_state(seed)], dtype=np.int64), np.zeros(2)
        measure(self._arm, self._sensors, self._draws, self._spare, TICK_S, self.row)
        return self.row

    def act(self, u_a: float, u_b: float) -> tuple[bool, Array]:
        """Hold the commands for one action: whether the arm is still in its range, and the rows measured meanwhile."""
        out = np.empty((self.ticks, ROW))
        ended, n = act(self._arm, self._sensors, self._draws, self._spare, (u_a, u_b), self._pwm, out)
        if n:
            self.row = out[n - 1]
        return ended == kernel.COMPLETE, out[:n]
