"""What the arm remembers beside its states: creep, hysteresis, sliding friction, air in a line, the regulator.

`hold` says before a step what acts on it (offset and slope over the angle, so that a stiff element stays
stable), `move_on` brings the memory after it. Rate-independent elements go by displacement: their answer does
not depend on the step. Creep: parallel Maxwell branches. Bouc-Wen and Dahl elements in their common form
dz = (1 - sign(dx) z) dx/slip, -1..1 (Bouc 1967, Wen 1976, Dahl 1968; LuGre without its bristles' damping).
"""

from __future__ import annotations

import math

from loopshape.core.units import Array
from loopshape.toolbox.arm import parameters as k
from loopshape.toolbox.arm.dynamics import model
from loopshape.toolbox.arm.dynamics.model import Valves, called, in_line
from loopshape.toolbox.arm.effect import effect_parameters as e

#: places in the memory (32,): creep of A and B (3 branches), their Bouc-Wen elements, slip elements (4), Dahl, line's
#: mass of A and B, flow from the supply, sensors' lags (2 poles each), play, slip elements of the joint
CREEP_A, CREEP_B, WEN_A, WEN_B, SLIP_A, SLIP_B, DAHL, LINE_A, LINE_B, SUPPLY = 0, 3, 6, 7, 8, 12, 16, 17, 18, 19
ANGLE_LAG, LAG_A, LAG_B, PLAY, SLIP_JOINT, SIZE = 20, 22, 24, 26, 28, 32
ELEMENTS = 4
TYPICAL_PULL_N = 300.0  # |F_A| + |F_B| at which a load-dependent friction has its named level
ROUNDS = 3  # of the valve's flow against the line's impedance; each brings it four times nearer
NAMED_PA = 5e4  # a muscle's pressure at which its friction has its named level


@in_line
def slipping(z: float, step: float) -> float:
    """An element of -1..1 after a displacement of `step` slip lengths."""
    if step == 0.0:
        return z
    side = math.copysign(1.0, step)
    return side - (side - z) * math.exp(-abs(step))


@in_line
def sticking(z: float, step: float) -> float:
    """An element of -1..1 that sticks until it slips, after a displacement of `step` slip lengths."""
    return min(max(z + step, -1.0), 1.0)


@in_line
def element_slip(slip: float, j: int) -> float:
    """Slip length of element j of the four: 1/4, 1/2, 1 and 2 times the named one."""
    return slip * 0.25 * (1 << j)


@in_line
def braid_level(c: Array, p: float) -> float:
    """Friction in N of one muscle's braid at p."""
    return c[e.BRAID] * (1.0 - c[e.BRAID_SHARE] + c[e.BRAID_SHARE] * max(p, 0.0) / NAMED_PA)


@in_line
def unloading(z: float, step: float, steeper: float) -> float:
    """As `slipping`, where back to nothing the slope is 1 + steeper |z|: 1 is Dahl's, 0 Bouc and Wen's usual one."""
    if steeper == 1.0 or z * step >= 0.0:
        return slipping(z, step)
    side, way, size = math.copysign(1.0, step), abs(step), abs(z)
    back = math.log(1.0 + steeper * size) / steeper if steeper > 0.0 else size
    if way >= back:
        return slipping(0.0, side * (way - back))
    left = ((1.0 + steeper * size) * math.exp(-steeper * way) - 1.0) / steeper if steeper > 0.0 else size - way
    return -side * left


@in_line
def friction(
    m: Array, single: int, first: int, elements: float, slip: float, side: float, steeper: float
) -> tuple[float, float]:
    """Share of its level at which a sliding friction pulls, and its slope over the way; `side` of motion."""
    if elements == 0.0:
        loaded = side * m[single]
        return m[single], (1.0 - (loaded if loaded > 0.0 else steeper * loaded)) / slip
    pull = slope = 0.0
    for j in range(ELEMENTS):
        z = m[first + j]
        pull += z / ELEMENTS
        if z * side < 1.0:
            slope += 1.0 / (ELEMENTS * element_slip(slip, j))
    return pull, slope


@in_line
def slide(m: Array, single: int, first: int, elements: float, slip: float, way: float, steeper: float) -> None:
    """The same friction's elements after a way."""
    if elements == 0.0:
        m[single] = unloading(m[single], way / slip, steeper)
        return
    for j in range(ELEMENTS):
        m[first + j] = sticking(m[first + j], way / element_slip(slip, j))


@in_line
def creep(c: Array, m: Array, first: int) -> float:
    """Creep in m times the relaxing share: mean of the branches."""
    if c[e.CREEP_2] == 0.0:
        return c[e.CREEP] * m[first]
    return c[e.CREEP] * (m[first] + m[first + 1] + m[first + 2]) / 3.0


@in_line
def creeping(c: Array, two_l: float, h: float, p: float) -> float:
    """What creep follows: a muscle's length, or its stretch over the nominal length, m."""
    return h if c[e.CREEP_LENGTH] > 0.0 else h - model.nominal_length(c, two_l, p)


@in_line
def branch_on(state: float, target: float, time_s: float, h: float) -> float:
    """A first-order branch h s later."""
    return state + (target - state) * (h / (time_s + 0.5 * h))


@in_line
def place(c: Array, held: Array, angle: float) -> None:
    """Lengths and levers at an angle, unless they are there: a step starts where one has ended."""
    if held[model.AT] == angle and held[model.LENGTH_A] > 0.0:
        return
    held[model.AT] = angle
    h_a, h_b, lever_a, lever_b = model.geometry(c, math.sin(angle), math.cos(angle))
    held[model.LENGTH_A], held[model.LENGTH_B] = h_a, h_b
    held[model.LEVER_A], held[model.LEVER_B] = lever_a, lever_b


@in_line
def hold(c: Array, x: Array, m: Array, held: Array, h: float, valves: Valves) -> None:
    """Fill `held` (16,) for a step of h s from state `x` (7,); the air in the lines moves on."""
    angle, velocity = x[3], x[4]
    place(c, held, angle)
    h_a, h_b, lever_a, lever_b = (
        held[model.LENGTH_A], held[model.LENGTH_B], held[model.LEVER_A], held[model.LEVER_B]
    )  # fmt: skip
    held[model.FROM], held[model.TORQUE], held[model.SLOPE] = angle, 0.0, 0.0
    side = 1.0 if velocity >= 0.0 else -1.0
    if c[e.BRAID] > 0.0:
        for lever, p, single, first in ((lever_a, x[1], WEN_A, SLIP_A), (lever_b, x[2], WEN_B, SLIP_B)):
            level = braid_level(c, p)
            along = side if lever < 0.0 else -side
            pull, slope = friction(m, single, first, c[e.BRAID_ELEMENTS], c[e.BRAID_SLIP], along, c[e.BRAID_STEEPER])
            held[model.TORQUE] += level * pull * lever
            held[model.SLOPE] -= level * slope * lever * lever
    held[model.CREEP_A], held[model.CREEP_B] = creep(c, m, CREEP_A), creep(c, m, CREEP_B)
    load = 1.0
    if c[e.LOAD_SHARE] > 0.0:
        pull_a, _, _ = model.muscle(c, x[1], h_a, 0.0, c[k.FACTOR_A], c[e.TWO_L_A], held[model.CREEP_A])
        pull_b, _, _ = model.muscle(c, x[2], h_b, 0.0, c[k.FACTOR_B], c[e.TWO_L_B], held[model.CREEP_B])
        load += c[e.LOAD_SHARE] * ((abs(pull_a) + abs(pull_b)) / TYPICAL_PULL_N - 1.0)
    held[model.COULOMB] = load * c[e.COULOMB]
    if c[e.DAHL] > 0.0:
        pull, slope = friction(m, DAHL, SLIP_JOINT, c[e.DAHL_ELEMENTS], c[e.DAHL_ANGLE], side, 1.0)
        level = load * c[e.DAHL] * model.stribeck(c, velocity)
        held[model.TORQUE] -= level * (pull + c[e.DAHL_DAMPING] * velocity * slope)
        held[model.SLOPE] -= level * slope
    hold_flows(c, x, m, held, h, valves)


@in_line
def hold_flows(c: Array, x: Array, m: Array, held: Array, h: float, valves: Valves) -> None:
    """Flows over the step out of the lines into A and B and from the supply into them, and the supply's drops."""
    if c[e.LINE] > 0.0:
        hold_lines(c, x, m, held, h, valves)
    elif c[e.DROP] > 0.0 or c[e.SPLIT] > 0.0:
        p_s = x[0] - held[model.SPLIT]
        _, _, held[model.DRAIN] = model.valve_flows(c, p_s, x[1], x[2], valves)
    if c[e.DROP] > 0.0 or c[e.SPLIT] > 0.0:
        m[SUPPLY] = branch_on(m[SUPPLY], held[model.DRAIN], c[e.DROP_TIME], h)
        named = model.flow(c, c[k.BETA_S], c[k.P_IN], NAMED_PA)
        held[model.DROP] = c[e.DROP] * m[SUPPLY] / named
        held[model.SPLIT] = c[e.SPLIT] * m[SUPPLY] / named


@in_line
def hold_lines(c: Array, x: Array, m: Array, held: Array, h: float, valves: Valves) -> None:
    """Flows through lines over the step: the valves see the pressures and the lines' air at its middle.

    First they see those at its start, which tells those at its middle. Between, a line empties exponentially.
    """
    p_s = x[0] - held[model.SPLIT]
    rise_a, rise_b = rises(c, held[model.LENGTH_A], held[model.LENGTH_B])
    lag_a, lag_b, net_a, net_b, drain = through(c, p_s, x[1], x[2], m[LINE_A], m[LINE_B], valves)
    air_a = net_a * lag_a + (m[LINE_A] - net_a * lag_a) * half_kept(h / lag_a)
    air_b = net_b * lag_b + (m[LINE_B] - net_b * lag_b) * half_kept(h / lag_b)
    p_a = x[1] + rise_a * (0.5 * h * net_a - air_a + m[LINE_A])
    p_b = x[2] + rise_b * (0.5 * h * net_b - air_b + m[LINE_B])
    lag_a, lag_b, net_a, net_b, drain = through(c, p_s, p_a, p_b, air_a, air_b, valves)
    left_a = net_a * lag_a + (m[LINE_A] - net_a * lag_a) * math.exp(-h / lag_a)
    left_b = net_b * lag_b + (m[LINE_B] - net_b * lag_b) * math.exp(-h / lag_b)
    held[model.LINE_A] = net_a - (left_a - m[LINE_A]) / h
    held[model.LINE_B] = net_b - (left_b - m[LINE_B]) / h
    held[model.DRAIN] = drain
    m[LINE_A], m[LINE_B] = left_a, left_b


@in_line
def half_kept(steps: float) -> float:
    """Nearly exp(-steps/2), and as stable."""
    return 1.0 / (1.0 + steps * (0.5 + 0.125 * steps))


@in_line
def through(
    c: Array, p_s: float, p_a: float, p_b: float, air_a: float, air_b: float, valves: Valves
) -> tuple[float, float, float, float, float]:
    """Time constants of both lines, net flows into them and what comes from the supply, with so much air in them."""
    lag_a, back_a = line(c, p_a, air_a)
    lag_b, back_b = line(c, p_b, air_b)
    out_of_a, out_of_b = air_a / lag_a, air_b / lag_b
    at_a, at_b = p_a + back_a * out_of_a, p_b + back_b * out_of_b
    net_a, net_b, drain = model.valve_flows(c, p_s, at_a, at_b, valves)
    if c[e.LINE_Z] > 0.0:  # until the front is back, the line answers the valve with its impedance
        for _ in range(ROUNDS):
            front_a, front_b = c[e.LINE_Z] * (net_a - out_of_a), c[e.LINE_Z] * (net_b - out_of_b)
            net_a, net_b, drain = model.valve_flows(c, p_s, at_a + front_a, at_b + front_b, valves)
    return lag_a, lag_b, net_a, net_b, drain


@in_line
def rises(c: Array, h_a: float, h_b: float) -> tuple[float, float]:
    """Rise of pressure in Pa per kg of air let into A and B of these lengths."""
    _, volume_a, _ = model.muscle(c, 0.0, h_a, 0.0, 1.0, c[e.TWO_L_A], 0.0)
    _, volume_b, _ = model.muscle(c, 0.0, h_b, 0.0, 1.0, c[e.TWO_L_B], 0.0)
    per_kg = c[k.EXPONENT] * c[k.RT]
    return per_kg / (volume_a + c[e.DEAD_A]), per_kg / (volume_b + c[e.DEAD_B])


@in_line
def line(c: Array, p: float, mass: float) -> tuple[float, float]:
    """Time constant in s of the air in a hose at p that holds `mass` kg back, and its resistance in Pa s/kg.

    Turbulence adds a loss that goes with the flow; of the flow we know what it would be without.
    """
    resistance = c[e.LINE_R] / (p + 0.5 * c[k.P_ATM2])
    lag = c[e.LINE_LAG] + resistance * c[e.LINE_V]
    if c[e.LINE_TURBULENT] > 0.0:
        named_kg_s = 1e-4  # a line's flow at which its turbulent loss has its named share
        more = c[e.LINE_TURBULENT] * abs(mass) / (lag * named_kg_s)
        resistance *= 0.5 + math.sqrt(0.25 + more)
        lag = c[e.LINE_LAG] + resistance * c[e.LINE_V]
    return lag, resistance


@in_line
def move_on(c: Array, x: Array, m: Array, held: Array, h: float) -> None:
    """Bring creep and friction after a step of h s that began as `held` says and ended in `x`."""
    if c[e.DAHL] > 0.0:
        slide(m, DAHL, SLIP_JOINT, c[e.DAHL_ELEMENTS], c[e.DAHL_ANGLE], x[3] - held[model.FROM], 1.0)
    if c[e.CREEP] == 0.0 and c[e.BRAID] == 0.0:
        return
    was_a, was_b = held[model.LENGTH_A], held[model.LENGTH_B]
    place(c, held, x[3])
    h_a, h_b = held[model.LENGTH_A], held[model.LENGTH_B]
    if c[e.CREEP] > 0.0:
        stretch_a, stretch_b = creeping(c, c[e.TWO_L_A], h_a, x[1]), creeping(c, c[e.TWO_L_B], h_b, x[2])
        for j in range(1 if c[e.CREEP_2] == 0.0 else 3):
            m[CREEP_A + j] = branch_on(m[CREEP_A + j], stretch_a, c[e.CREEP_1 + j], h)
            m[CREEP_B + j] = branch_on(m[CREEP_B + j], stretch_b, c[e.CREEP_1 + j], h)
    if c[e.BRAID] > 0.0:
        slide(m, WEN_A, SLIP_A, c[e.BRAID_ELEMENTS], c[e.BRAID_SLIP], h_a - was_a, c[e.BRAID_STEEPER])
        slide(m, WEN_B, SLIP_B, c[e.BRAID_ELEMENTS], c[e.BRAID_SLIP], h_b - was_b, c[e.BRAID_STEEPER])


@called
def start(c: Array, x: Array, m: Array) -> None:
    """Memory (32,) of an arm that has long rested in `x`; of friction nothing is known, it pulls no way."""
    m[:] = 0.0
    h_a, h_b, _, _ = model.geometry(c, math.sin(x[3]), math.cos(x[3]))
    for j in range(3):
        m[CREEP_A + j] = creeping(c, c[e.TWO_L_A], h_a, x[1])
        m[CREEP_B + j] = creeping(c, c[e.TWO_L_B], h_b, x[2])
    m[ANGLE_LAG], m[LAG_A], m[LAG_B] = x[3], x[1], x[2]
    m[PLAY] = x[3]


@in_line
def lagged(c: Array, m: Array, first: int, value: float, lag_s: float, tick_s: float) -> float:
    """A sensor's answer a tick later: one pole, or two of a damping, with `lag_s` of delay at low frequency."""
    if lag_s == 0.0:
        return value
    if c[e.LAG_ORDER] < 2.0:
        m[first] += tick_s / (tick_s + lag_s) * (value - m[first])
        return m[first]
    # the trapezoidal rule adds no damping of its own; held at its end, the input leads by half a tick
    damping, turn = c[e.LAG_DAMPING], 2.0 * c[e.LAG_DAMPING] / (lag_s + 0.5 * tick_s) * tick_s
    was = m[first + 1]
    kept = was * (1.0 - damping * turn - 0.25 * turn * turn)
    m[first + 1] = (kept + turn * turn * (value - m[first])) / (1.0 + damping * turn + 0.25 * turn * turn)
    m[first] += 0.5 * (was + m[first + 1])
    return m[first]


@in_line
def played(c: Array, m: Array, angle: float) -> float:
    """The angle behind the play; m holds the last angle and the element."""
    if c[e.PLAY] == 0.0:
        return angle
    half = 0.5 * c[e.PLAY]
    step = (angle - m[PLAY]) / half
    m[PLAY] = angle
    # the soft one yields half as fast, so that at a turn what is seen stands still and never goes the other way
    m[PLAY + 1] = slipping(m[PLAY + 1], 0.5 * step) if c[e.PLAY_SOFT] > 0.0 else sticking(m[PLAY + 1], step)
    return angle - half * m[PLAY + 1]


@called
def sensed(c: Array, x: Array, m: Array, tick_s: float) -> tuple[float, float, float]:
    """Angle and pressures as the sensors give them before noise and converters (rad, Pa, Pa)."""
    angle = lagged(c, m, ANGLE_LAG, played(c, m, x[3]), c[e.ANGLE_LAG], tick_s)
    p_a = lagged(c, m, LAG_A, x[1], c[e.PRESSURE_LAG], tick_s)
    return angle, p_a, lagged(c, m, LAG_B, x[2], c[e.PRESSURE_LAG], tick_s)
