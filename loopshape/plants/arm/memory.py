"""What the arm remembers beside its states: creep, hysteresis, sliding friction, air in a line, the regulator.

`hold` says before a step what acts on it (offset and slope over the angle, so that a stiff element stays
stable), `move_on` brings the memory after it. Rate-independent elements go by displacement: their answer does
not depend on the step. Creep: parallel Maxwell branches. Bouc-Wen and Dahl elements in their common form
dz = (1 - sign(dx) z) dx/slip, -1..1 (Bouc 1967, Wen 1976, Dahl 1968; LuGre without its bristles' damping).
"""

from __future__ import annotations

import math

from loopshape.kernels.compiled import compiled, compiled_in_line
from loopshape.plants.arm import effect_parameters as e
from loopshape.plants.arm import model
from loopshape.plants.arm import parameters as k
from loopshape.units import Array

#: places in the memory (32,): creep of A and B (3 branches), their Bouc-Wen elements, slip elements (4), Dahl, line's
#: mass of A and B, flow from the supply, sensors' lags (2 poles each), play, slip elements of the joint
CREEP_A, CREEP_B, WEN_A, WEN_B, SLIP_A, SLIP_B, DAHL, LINE_A, LINE_B, SUPPLY = 0, 3, 6, 7, 8, 12, 16, 17, 18, 19
ANGLE_LAG, LAG_A, LAG_B, PLAY, SLIP_JOINT, SIZE = 20, 22, 24, 26, 28, 32
ELEMENTS = 4
TYPICAL_PULL_N = 300.0  # |F_A| + |F_B| at which a load-dependent friction has its named level
NAMED_KG_S = 1e-4  # a line's flow at which its turbulent loss has its named share
NAMED_PA = 5e4  # a muscle's pressure at which its friction has its named level


@compiled_in_line
def slipping(z: float, step: float) -> float:
    """An element of -1..1 after a displacement of `step` slip lengths."""
    if step == 0.0:
        return z
    side = math.copysign(1.0, step)
    return side - (side - z) * math.exp(-abs(step))


@compiled_in_line
def sticking(z: float, step: float) -> float:
    """An element of -1..1 that sticks until it slips, after a displacement of `step` slip lengths."""
    return min(max(z + step, -1.0), 1.0)


@compiled_in_line
def element_slip(slip: float, j: int) -> float:
    """Slip length of element j of the four: 1/4, 1/2, 1 and 2 times the named one."""
    return slip * 0.25 * (1 << j)


@compiled_in_line
def braid_level(c: Array, p: float) -> float:
    """Friction in N of one muscle's braid at p."""
    return c[e.BRAID] * (1.0 - c[e.BRAID_SHARE] + c[e.BRAID_SHARE] * max(p, 0.0) / NAMED_PA)


@compiled_in_line
def friction(m: Array, single: int, first: int, elements: float, slip: float, side: float) -> tuple[float, float]:
    """Share of its level at which a sliding friction pulls, and its slope over the way; `side` of motion."""
    if elements == 0.0:
        return m[single], (1.0 - side * m[single]) / slip
    pull = slope = 0.0
    for j in range(ELEMENTS):
        z = m[first + j]
        pull += z / ELEMENTS
        if z * side < 1.0:
            slope += 1.0 / (ELEMENTS * element_slip(slip, j))
    return pull, slope


@compiled_in_line
def slide(m: Array, single: int, first: int, elements: float, slip: float, way: float) -> None:
    """The same friction's elements after a way."""
    if elements == 0.0:
        m[single] = slipping(m[single], way / slip)
        return
    for j in range(ELEMENTS):
        m[first + j] = sticking(m[first + j], way / element_slip(slip, j))


@compiled_in_line
def creep(c: Array, m: Array, first: int) -> float:
    """Creep in m times the relaxing share: mean of the branches."""
    if c[e.CREEP_2] == 0.0:
        return c[e.CREEP] * m[first]
    return c[e.CREEP] * (m[first] + m[first + 1] + m[first + 2]) / 3.0


@compiled_in_line
def branch_on(state: float, target: float, time_s: float, h: float) -> float:
    """A first-order branch h s later."""
    return state if time_s == 0.0 else state + (target - state) * (h / (time_s + 0.5 * h))


@compiled
def hold(
    c: Array, x: Array, m: Array, held: Array, h: float, in_a: float, in_b: float, out_a: float, out_b: float
) -> None:
    """Fill `held` (10,) for a step of h s from state `x` (7,); the air in the lines moves on."""
    angle, velocity = x[3], x[4]
    h_a, h_b, lever_a, lever_b = model.geometry(c, math.sin(angle), math.cos(angle))
    held[model.FROM], held[model.TORQUE], held[model.SLOPE] = angle, 0.0, 0.0
    side = 1.0 if velocity >= 0.0 else -1.0
    if c[e.BRAID] > 0.0:
        for lever, p, single, first in ((lever_a, x[1], WEN_A, SLIP_A), (lever_b, x[2], WEN_B, SLIP_B)):
            level = braid_level(c, p)
            along = side if lever < 0.0 else -side
            pull, slope = friction(m, single, first, c[e.BRAID_ELEMENTS], c[e.BRAID_SLIP], along)
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
        pull, slope = friction(m, DAHL, SLIP_JOINT, c[e.DAHL_ELEMENTS], c[e.DAHL_ANGLE], side)
        fade = velocity / c[e.STRIBECK_SPEED]
        level = load * c[e.DAHL] * (1.0 + c[e.STRIBECK] * math.exp(-fade * fade))
        held[model.TORQUE] -= level * pull
        held[model.SLOPE] -= level * slope
    hold_flows(c, x, m, held, h, in_a, in_b, out_a, out_b)


@compiled_in_line
def hold_flows(
    c: Array, x: Array, m: Array, held: Array, h: float, in_a: float, in_b: float, out_a: float, out_b: float
) -> None:
    """Flows out of the lines into A and B over the step, from the supply into them, and the regulator's drop."""
    if c[e.LINE] == 0.0 and c[e.DROP] == 0.0 and c[e.SPLIT] == 0.0:
        return
    lag_a, back_a = line(c, x[1], m[LINE_A])
    lag_b, back_b = line(c, x[2], m[LINE_B])
    before_a, before_b = x[1], x[2]
    if c[e.LINE] > 0.0:
        before_a += back_a * m[LINE_A] / lag_a
        before_b += back_b * m[LINE_B] / lag_b
    net_a, net_b, drain = model.valve_flows(c, x[0] - held[model.SPLIT], before_a, before_b, in_a, in_b, out_a, out_b)
    held[model.DRAIN] = drain
    if c[e.LINE] > 0.0:
        left_a = net_a * lag_a + (m[LINE_A] - net_a * lag_a) * math.exp(-h / lag_a)
        left_b = net_b * lag_b + (m[LINE_B] - net_b * lag_b) * math.exp(-h / lag_b)
        held[model.LINE_A] = net_a - (left_a - m[LINE_A]) / h
        held[model.LINE_B] = net_b - (left_b - m[LINE_B]) / h
        m[LINE_A], m[LINE_B] = left_a, left_b
    if c[e.DROP] > 0.0 or c[e.SPLIT] > 0.0:
        m[SUPPLY] = branch_on(m[SUPPLY], held[model.DRAIN], c[e.DROP_TIME], h)
        named = model.flow(c, c[k.BETA_S], c[k.P_IN], NAMED_PA)
        held[model.DROP] = c[e.DROP] * m[SUPPLY] / named
        held[model.SPLIT] = c[e.SPLIT] * m[SUPPLY] / named


@compiled_in_line
def line(c: Array, p: float, mass: float) -> tuple[float, float]:
    """Time constant in s of the air in a hose at p that holds `mass` kg back, and its resistance in Pa s/kg."""
    resistance = c[e.LINE_R] / (p + 0.5 * c[k.P_ATM2])
    lag = c[e.LINE_LAG] + resistance * c[e.LINE_V]
    if c[e.LINE_TURBULENT] > 0.0:
        resistance *= 1.0 + c[e.LINE_TURBULENT] * abs(mass) / (lag * NAMED_KG_S)
        lag = c[e.LINE_LAG] + resistance * c[e.LINE_V]
    return lag, resistance


@compiled
def move_on(c: Array, x: Array, m: Array, from_angle: float, h: float) -> None:
    """Bring creep and friction after a step of h s that began at `from_angle` and ended in `x`."""
    was_a, was_b, _, _ = model.geometry(c, math.sin(from_angle), math.cos(from_angle))
    h_a, h_b, _, _ = model.geometry(c, math.sin(x[3]), math.cos(x[3]))
    if c[e.CREEP] > 0.0:
        stretch_a = h_a - model.nominal_length(c, c[e.TWO_L_A], x[1])
        stretch_b = h_b - model.nominal_length(c, c[e.TWO_L_B], x[2])
        for j in range(3):
            time_s = c[e.CREEP_1 + j]
            m[CREEP_A + j] = branch_on(m[CREEP_A + j], stretch_a, time_s, h)
            m[CREEP_B + j] = branch_on(m[CREEP_B + j], stretch_b, time_s, h)
    if c[e.BRAID] > 0.0:
        slide(m, WEN_A, SLIP_A, c[e.BRAID_ELEMENTS], c[e.BRAID_SLIP], h_a - was_a)
        slide(m, WEN_B, SLIP_B, c[e.BRAID_ELEMENTS], c[e.BRAID_SLIP], h_b - was_b)
    if c[e.DAHL] > 0.0:
        slide(m, DAHL, SLIP_JOINT, c[e.DAHL_ELEMENTS], c[e.DAHL_ANGLE], x[3] - from_angle)


@compiled
def start(c: Array, x: Array, m: Array) -> None:
    """Memory (32,) of an arm that has long rested in `x`; of friction nothing is known, it pulls no way."""
    m[:] = 0.0
    h_a, h_b, _, _ = model.geometry(c, math.sin(x[3]), math.cos(x[3]))
    for j in range(3):
        m[CREEP_A + j] = h_a - model.nominal_length(c, c[e.TWO_L_A], x[1])
        m[CREEP_B + j] = h_b - model.nominal_length(c, c[e.TWO_L_B], x[2])
    for j in range(2):
        m[ANGLE_LAG + j], m[LAG_A + j], m[LAG_B + j] = x[3], x[1], x[2]


@compiled_in_line
def lagged(m: Array, first: int, value: float, lag_s: float, order: float, tick_s: float) -> float:
    """A sensor's answer a tick later: one pole, or two equal ones of half the delay each."""
    if lag_s == 0.0:
        return value
    each = lag_s if order < 2.0 else 0.5 * lag_s
    share = tick_s / (tick_s + each)
    m[first] += share * (value - m[first])
    if order < 2.0:
        return m[first]
    m[first + 1] += share * (m[first] - m[first + 1])
    return m[first + 1]


@compiled_in_line
def played(c: Array, m: Array, angle: float) -> float:
    """The angle behind the play; m holds the last angle and the element."""
    if c[e.PLAY] == 0.0:
        return angle
    half = 0.5 * c[e.PLAY]
    step = (angle - m[PLAY]) / half
    m[PLAY] = angle
    m[PLAY + 1] = slipping(m[PLAY + 1], step) if c[e.PLAY_SOFT] > 0.0 else sticking(m[PLAY + 1], step)
    return angle - half * m[PLAY + 1]


@compiled
def sensed(c: Array, x: Array, m: Array, tick_s: float) -> tuple[float, float, float]:
    """Angle and pressures as the sensors give them before noise and converters (rad, Pa, Pa)."""
    angle = lagged(m, ANGLE_LAG, played(c, m, x[3]), c[e.ANGLE_LAG], c[e.LAG_ORDER], tick_s)
    p_a = lagged(m, LAG_A, x[1], c[e.PRESSURE_LAG], c[e.LAG_ORDER], tick_s)
    return angle, p_a, lagged(m, LAG_B, x[2], c[e.PRESSURE_LAG], c[e.LAG_ORDER], tick_s)
