"""How the axis moves: one step of its mass, or of two masses and the coupling between them, and what its sensor sees.

A step of h s takes the smooth forces by the trapezoidal rule and sliding friction implicitly, linearised, so that it
stays stable however sharp the friction is; error of order h^2 where friction is smooth.
"""

from __future__ import annotations

import math

from loopshape.core.kernels.compiled import compiled, compiled_in_line
from loopshape.core.units import Array
from loopshape.toolbox.servo import parameters as k

#: places in the state (4,): drive's position and velocity, the load's beyond a coupling
DRIVE, DRIVE_V, LOAD, LOAD_V, STATES = 0, 1, 2, 3, 4
#: places in the memory (4,): Dahl's element, the play's last position and its element, the lagged force
ELEMENT, PLAYED, PLAY, LAGGED, MEMORY = 0, 1, 2, 3, 4
STEPS = 4  # of integration in a tick


@compiled_in_line
def slipping(z: float, step: float) -> float:
    """Dahl's element of -1..1 after a displacement of `step` yielding lengths (Dahl 1968)."""
    if step == 0.0:
        return z
    side = math.copysign(1.0, step)
    return side - (side - z) * math.exp(-abs(step))


@compiled_in_line
def friction(c: Array, v: float) -> tuple[float, float]:
    """Coulomb friction in N, Stribeck's and the sides' shares with it, and its slope over the speed."""
    if c[k.COULOMB] == 0.0:
        return 0.0, 0.0
    level = c[k.COULOMB] * (1.0 + (c[k.LEVELS] if v >= 0.0 else -c[k.LEVELS]))
    if c[k.STRIBECK] > 0.0:
        level *= 1.0 + c[k.STRIBECK] * math.exp(-(abs(v / c[k.STRIBECK_SPEED]) ** c[k.STRIBECK_POWER]))
    t = math.tanh(v / c[k.SPEED])
    return level * t, level * (1.0 - t * t) / c[k.SPEED]


@compiled_in_line
def presliding(c: Array, z: float, v: float) -> tuple[float, float]:
    """Dahl friction in N and its slope over the position."""
    if c[k.DAHL] == 0.0:
        return 0.0, 0.0
    side = 1.0 if v >= 0.0 else -1.0
    level = c[k.DAHL] * (1.0 + side * c[k.LEVELS])
    return level * z, level * (1.0 - side * z) / c[k.DAHL_M]


@compiled_in_line
def coupling(c: Array, stretch: float, rate: float, h: float) -> tuple[float, float]:
    """Mean force of the coupling in N over a step without acceleration, and how relative acceleration adds to it."""
    half = 0.5 * c[k.DRIVE_PLAY]
    beyond = stretch - min(max(stretch, -half), half)
    if half > 0.0 and beyond == 0.0:
        return 0.0, 0.0
    force = c[k.SPRING] * (beyond + 0.5 * h * rate) + c[k.DAMPER] * rate
    return force, 0.25 * c[k.SPRING] * h * h + 0.5 * c[k.DAMPER] * h


@compiled_in_line
def step(c: Array, x: Array, m: Array, force: float, h: float) -> None:
    """One step of h s under a force in N at the drive; state `x` (4,) and memory `m` (4,) move in place."""
    q, v = x[DRIVE], x[DRIVE_V]
    viscous = c[k.VISCOUS] * (1.0 + (c[k.SIDES] if v >= 0.0 else -c[k.SIDES])) + c[k.DRAG] * abs(v)
    sliding, sliding_slope = friction(c, v)
    yielding, yielding_slope = presliding(c, m[ELEMENT], v)
    ahead = q + 0.5 * h * v
    off = ahead - c[k.CENTRE]
    rest = force - viscous * v - sliding - yielding - yielding_slope * h * v
    rest -= c[k.STIFFNESS] * ahead + c[k.CUBIC] * off * off * off
    held = h * (0.5 * viscous + sliding_slope + 0.5 * h * yielding_slope + 0.25 * h * c[k.STIFFNESS])
    mass = (1.0 - c[k.SHARE]) * c[k.MASS] + held
    if c[k.SHARE] > 0.0:
        load = c[k.SHARE] * c[k.MASS]
        between, grows = coupling(c, q - x[LOAD], v - x[LOAD_V], h)
        a = (rest - between + grows * between / (load + grows)) / (mass + grows - grows * grows / (load + grows))
        a_load = (between + grows * a) / (load + grows)
        x[LOAD] += h * (x[LOAD_V] + 0.5 * h * a_load)
        x[LOAD_V] += h * a_load
    else:
        a = rest / mass
    x[DRIVE] = q + h * (v + 0.5 * h * a)
    x[DRIVE_V] = v + h * a
    if c[k.DAHL] > 0.0:
        m[ELEMENT] = slipping(m[ELEMENT], (x[DRIVE] - q) / c[k.DAHL_M])


@compiled
def advance(c: Array, x: Array, m: Array, force: float, tick_s: float, steps: int) -> None:
    """One tick under a force that is held, in `steps` steps."""
    h = tick_s / steps
    for _ in range(steps):
        step(c, x, m, force, h)


@compiled_in_line
def seen(c: Array, x: Array, m: Array) -> float:
    """Position in m that the sensor sees: the drive's, behind the play; `m` remembers the play."""
    if c[k.PLAY] == 0.0:
        return x[DRIVE]
    half = 0.5 * c[k.PLAY]
    m[PLAY] = min(max(m[PLAY] + (x[DRIVE] - m[PLAYED]) / half, -1.0), 1.0)
    m[PLAYED] = x[DRIVE]
    return x[DRIVE] - half * m[PLAY]


@compiled_in_line
def pushed(c: Array, m: Array, commands: Array, tick: int, tick_s: float) -> float:
    """Force in N that acts in a tick: the command, limited, late or lagged, with its offset."""
    value = commands[tick]
    if c[k.DELAY] > 0.0:
        at = max(tick - c[k.DELAY] / tick_s, 0.0)
        row = int(at)
        share = at - row
        value = commands[row] if share == 0.0 else (1.0 - share) * commands[row] + share * commands[row + 1]
    if c[k.LIMIT] > 0.0:
        limit = c[k.LIMIT]
        value = limit * math.tanh(value / limit) if c[k.LIMIT_SOFT] > 0.0 else min(max(value, -limit), limit)
    if c[k.LAG] > 0.0:
        m[LAGGED] += (value - m[LAGGED]) * (1.0 - math.exp(-tick_s / c[k.LAG]))
        value = m[LAGGED]
    return value + c[k.OFFSET]


@compiled
def start(x: Array, m: Array, position: float, velocity: float, force: float) -> None:
    """State and memory of an axis that moves as a whole; the play stands in its middle, friction pulls no way."""
    x[DRIVE] = x[LOAD] = position
    x[DRIVE_V] = x[LOAD_V] = velocity
    m[ELEMENT] = m[PLAY] = 0.0
    m[PLAYED] = position
    m[LAGGED] = force
