"""The servo axis under its position controller, and the axis that follows a recording: compiled loops over ticks.

Order inside a tick: measure, control, log, integrate under the force that is held until the next tick.
"""

from __future__ import annotations

import math

from loopshape.core.kernels import biquads, noise
from loopshape.core.kernels.compiled import compiled
from loopshape.core.units import Array
from loopshape.toolbox.servo import motion

COMPLETE, LEFT_RANGE, NOT_FINITE = 0, 1, 2
CONTROLLER_INPUT, PLANT_INPUT, CONTROL = 0, 1, 2
#: columns of the log: measured position, the controller's force, true states after them if asked
LOGGED = ("position", "force", "true_position", "true_velocity", "true_load")
MEASURED = 2


@compiled
def run(
    c: Array,
    sensor: Array,
    x: Array,
    m: Array,
    sections: Array,
    controller_state: Array,
    reference: Array,
    injected: Array,
    injection: int,
    tick_s: float,
    steps: int,
    random_state: int,
    commands: Array,
    out: Array,
) -> tuple[int, int]:
    """Simulate as many ticks as `reference` (n,) in m has; fills `out` (n, 2 or 5) by `LOGGED`.

    `sensor` holds noise, resolution (0: none) and range in m; `commands` (n,) takes the force at the drive in N;
    `x` (4,), `m` (4,) and `controller_state` move in place. Gives why it ended and how many ticks are logged.
    """
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
    c: Array,
    x: Array,
    m: Array,
    commands: Array,
    measured: Array,
    position_gain: float,
    velocity_gain: float,
    tick_s: float,
    steps: int,
    out: Array,
) -> None:
    """The axis driven by logged forces (n,) in N, drawn to the measured positions (n,) in m.

    Gains per tick: of the position, and of the velocity in 1/s; all masses move with them. Fills `out` (n,) with
    measured minus modelled position in m, before each pull.
    """
    for tick in range(commands.shape[0]):
        off = measured[tick] - motion.seen(c, x, m)
        out[tick] = off
        x[motion.DRIVE] += position_gain * off
        x[motion.LOAD] += position_gain * off
        x[motion.DRIVE_V] += velocity_gain * off
        x[motion.LOAD_V] += velocity_gain * off
        m[motion.PLAYED] += position_gain * off
        motion.advance(c, x, m, motion.pushed(c, m, commands, tick, tick_s), tick_s, steps)
