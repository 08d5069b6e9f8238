"""The servo axis under its position controller, and the axis that follows a recording: compiled loops over ticks.

Order inside a tick: measure, control, log, integrate under the force that is held until the next tick.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from loopshape.core.kernels import biquads
from loopshape.core.kernels.compiled import compiled
from loopshape.core.units import Array
from loopshape.toolbox.gap import noise
from loopshape.toolbox.servo import motion

COMPLETE, LEFT_RANGE, NOT_FINITE = 0, 1, 2
CONTROLLER_INPUT, PLANT_INPUT, CONTROL = 0, 1, 2
#: columns of the log: measured position, the controller's force, true states after them if asked
LOGGED = ("position", "force", "true_position", "true_velocity", "true_load")
MEASURED = 2


class Mechanism(NamedTuple):
    """An axis under way: its constants, state (4,) and memory (4,)."""

    c: Array
    x: Array
    m: Array


class Inputs(NamedTuple):
    """What goes in: reference in m and what is injected (n,), where that enters, and the noise's state."""

    reference: Array
    injected: Array
    injection: int
    random_state: int


def under_way(c: Array, position: float, velocity: float, force: float) -> Mechanism:
    """An axis that moves as a whole, in m, m/s and N."""
    x, m = np.empty(motion.STATES), np.empty(motion.MEMORY)
    motion.start(x, m, position, velocity, force)
    return Mechanism(c, x, m)


@compiled
def run(
    axis: Mechanism, sensor: Array, sections: Array, controller_state: Array, inputs: Inputs, tick_s: float,
    steps: int, out: Array,
) -> tuple[int, int]:  # fmt: skip
    """Simulate as many ticks as the reference has, axis and controller in place; fills `out` (n, 2 or 5) by `LOGGED`.

    `sensor` holds noise, resolution (0: none) and range in m. Gives why it ended and how many ticks are logged.
    """
    c, x, m = axis
    reference, injected, injection, random_state = inputs
    commands = np.empty(reference.size)
    slack, has_spare = 0.0, False
    for tick in range(reference.shape[0]):
        position = motion.seen(c, x, m)
        if sensor[0] > 0.0:
            if has_spare:
                draw, has_spare = slack, False
            else:
                random_state, draw, slack = noise.normal_pair(random_state)
                has_spare = True
            position += sensor[0] * draw
        if sensor[1] > 0.0:
            position = sensor[1] * round(position / sensor[1])
        force = injected[tick]
        if injection != CONTROL:
            error = reference[tick] - position
            if injection == CONTROLLER_INPUT:
                error += injected[tick]
            force = biquads.step(sections, controller_state, error)
        out[tick, 0], out[tick, 1] = position, force
        if out.shape[1] > MEASURED:
            out[tick, 2], out[tick, 3], out[tick, 4] = x[motion.DRIVE], x[motion.DRIVE_V], x[motion.LOAD]
        commands[tick] = force + injected[tick] if injection == PLANT_INPUT else force
        motion.advance(c, x, m, motion.pushed(c, m, commands, tick, tick_s), tick_s, steps)
        if not math.isfinite(x[motion.DRIVE] + x[motion.DRIVE_V]):
            return NOT_FINITE, tick + 1
        if abs(x[motion.DRIVE]) > sensor[2]:
            return LEFT_RANGE, tick + 1
    return COMPLETE, reference.shape[0]


@compiled
def follow(
    axis: Mechanism, commands: Array, measured: Array, gains: tuple[float, float], tick_s: float, steps: int
) -> Array:
    """The axis driven by logged forces (n,) in N, drawn to the measured positions (n,) in m.

    Gains per tick: of the position, and of the velocity in 1/s; all masses move with them. Gives measured minus
    modelled position (n,) in m, before each pull.
    """
    c, x, m = axis
    position_gain, velocity_gain = gains
    out = np.empty(commands.size)
    for tick in range(commands.shape[0]):
        off = measured[tick] - motion.seen(c, x, m)
        out[tick] = off
        x[motion.DRIVE] += position_gain * off
        x[motion.LOAD] += position_gain * off
        x[motion.DRIVE_V] += velocity_gain * off
        x[motion.LOAD_V] += velocity_gain * off
        m[motion.PLAYED] += position_gain * off
        motion.advance(c, x, m, motion.pushed(c, m, commands, tick, tick_s), tick_s, steps)
    return out
