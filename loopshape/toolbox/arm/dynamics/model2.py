"""Right-hand side of the 2-DoF arm: capacity, splitter, four muscles, two bodies. SI, gauge pressures in Pa.

A state is the pressure of the capacity, p_A, p_B, p_C, p_D, theta1, theta2 and both velocities. A muscle's valves are
one number: 1 filling, -1 letting out, 0 shut; an open out valve overrules, which `derivatives2` settles.

Links, spring and equations of motion are appendix F's, as ARM.md, section 5, restores it. `sine` and `cosine` are of
the joint named. Muscles A and B act between body 1 and body 2 and pull on theta2 alone: their geometry is the 1-DoF
arm's.
"""

from __future__ import annotations

import math

from loopshape.core.kernels.compiled import compiled
from loopshape.core.units import Array
from loopshape.toolbox.arm import parameters as k
from loopshape.toolbox.arm import parameters2 as k2
from loopshape.toolbox.arm.dynamics.model import flow, geometry, in_line, muscle

Four = tuple[float, float, float, float]
State2 = tuple[float, float, float, float, float, float, float, float, float]


@in_line
def link(square: float, along: float, across: float, sine: float, cosine: float) -> tuple[float, float]:
    """Length in m of a vector [x0 + r cos, l0 + r sin] between base and body 1, and its lever -d length/d theta1."""
    length = math.sqrt(square + 2.0 * (along * sine + across * cosine))
    return length, (across * sine - along * cosine) / length


@in_line
def geometry1(c: Array, sine: float, cosine: float) -> tuple[float, float, float, float]:
    """Lengths without fittings and levers -dh/dtheta1 of C and D, m."""
    length_c, lever_c = link(c[k2.SQUARE_C], c[k2.ALONG_C], c[k2.ACROSS_C], sine, cosine)
    length_d, lever_d = link(c[k2.SQUARE_D], c[k2.ALONG_D], c[k2.ACROSS_D], sine, cosine)
    return length_c - c[k2.FITTING_CD], length_d - c[k2.FITTING_CD], lever_c, lever_d


@in_line
def resting_torques(c: Array, sine1: float, cosine1: float, sine2: float, cosine2: float) -> tuple[float, float]:
    """Torques in N m of gravity and spring on theta1 and on theta2."""
    length, lever = link(c[k2.SQUARE_S], c[k2.ALONG_S], c[k2.ACROSS_S], sine1, cosine1)
    spring = c[k2.SPRING] * (length - c[k2.SPRING_LENGTH]) * lever
    upper = c[k.GRAVITY] * (sine1 * cosine2 + cosine1 * sine2)
    return spring + upper - c[k2.WEIGHT_X] * cosine1 + c[k2.WEIGHT_Y] * sine1, upper


@in_line
def accelerations(
    c: Array, torque1: float, torque2: float, sine2: float, cosine2: float, velocity1: float, velocity2: float
) -> tuple[float, float]:
    """Angular accelerations in rad/s2 from the torques on theta1 and theta2 (F.50-F.66): M^-1 (torques - Coriolis).

    M = [[I - 2 a, i - a], [i - a, i]] with a = m2 l12 (l1x sin - l1y cos) and i the upper body's inertia about joint 2.
    """
    a = c[k2.COUPLING_X] * sine2 - c[k2.COUPLING_Y] * cosine2
    slope = c[k2.COUPLING_X] * cosine2 + c[k2.COUPLING_Y] * sine2
    i = c[k.INERTIA]
    t1 = torque1 + slope * (2.0 * velocity1 + velocity2) * velocity2
    t2 = torque2 - slope * velocity1 * velocity1
    per_determinant = 1.0 / (i * c[k2.INERTIA_1] - a * a)
    off = i - a
    return (i * t1 - off * t2) * per_determinant, ((c[k2.INERTIA_1] + i - 2.0 * a) * t2 - off * t1) * per_determinant


@in_line
def wider(drop: float, other: float) -> float:
    """Whichever difference is larger in size, with its sign."""
    return drop if abs(drop) > abs(other) else other


@in_line
def filling(p_s: float, p: float, valves: float) -> float:
    """Difference in Pa that drives gas into a muscle: none where its in-valve is shut."""
    return p_s - p if valves > 0.0 else 0.0


@in_line
def supply_flows2(c: Array, p_s: float, p: Four, valves: Four) -> Four:
    """Flows in kg/s from the capacity at p_s through the splitter into the four muscles at p (D.11-D.23).

    The open muscle farthest from p_s sets the throttle's drop, and the shares go by the differences over the sum of
    their sizes: as printed where all lie below p_s, bounded where one does not, nothing where none differs.
    """
    a, b = filling(p_s, p[0], valves[0]), filling(p_s, p[1], valves[1])
    g, d = filling(p_s, p[2], valves[2]), filling(p_s, p[3], valves[3])
    total = abs(a) + abs(b) + abs(g) + abs(d)
    if total == 0.0:
        return 0.0, 0.0, 0.0, 0.0
    drop = wider(wider(a, b), wider(g, d))
    size = abs(flow(c, c[k.BETA_S], p_s, p_s - drop)) / total
    return size * a, size * b, size * g, size * d


@in_line
def outflow(c: Array, p: float, valves: float) -> float:
    """Flow in kg/s out of a muscle to the room."""
    return flow(c, c[k.BETA_OUT], p, 0.0) if valves < 0.0 else 0.0


@in_line
def pull_and_rise(
    c: Array, p: float, h: float, dh: float, factor: float, inflow: float
) -> tuple[float, float]:  # fmt: skip
    """Pull in N of a muscle at p, of length h, and its dp/dt in Pa/s (3.20, 3.41) with this net flow in kg/s."""
    pull, volume, slope = muscle(c, p, h, dh, factor, c[k.TWO_L], 0.0)
    rise = c[k.EXPONENT] * (c[k.RT] * inflow - (p + c[k.ABSOLUTE]) * slope * dh) / volume
    return pull, rise


@in_line
def moving2(c: Array, state: State2, valves: Four) -> State2:
    """Rates of a state: Pa/s, rad/s and rad/s2."""
    p_s, p_a, p_b, p_c, p_d, angle1, angle2, velocity1, velocity2 = state
    sine1, cosine1 = math.sin(angle1), math.cos(angle1)
    sine2, cosine2 = math.sin(angle2), math.cos(angle2)
    h_a, h_b, lever_a, lever_b = geometry(c, sine2, cosine2)
    h_c, h_d, lever_c, lever_d = geometry1(c, sine1, cosine1)
    q_a, q_b, q_c, q_d = supply_flows2(c, p_s, (p_a, p_b, p_c, p_d), valves)
    rise_s = c[k.RT] * (flow(c, c[k.BETA_IN], c[k.P_IN], p_s) - (q_a + q_b + q_c + q_d)) / c[k.V_C]
    q_a, q_b = q_a - outflow(c, p_a, valves[0]), q_b - outflow(c, p_b, valves[1])
    q_c, q_d = q_c - outflow(c, p_c, valves[2]), q_d - outflow(c, p_d, valves[3])
    pull_a, rise_a = pull_and_rise(c, p_a, h_a, -lever_a * velocity2, c[k.FACTOR_A], q_a)
    pull_b, rise_b = pull_and_rise(c, p_b, h_b, -lever_b * velocity2, c[k.FACTOR_B], q_b)
    pull_c, rise_c = pull_and_rise(c, p_c, h_c, -lever_c * velocity1, c[k2.FACTOR_C], q_c)
    pull_d, rise_d = pull_and_rise(c, p_d, h_d, -lever_d * velocity1, c[k2.FACTOR_D], q_d)
    torque1, torque2 = resting_torques(c, sine1, cosine1, sine2, cosine2)
    torque1 += pull_c * lever_c + pull_d * lever_d
    torque2 += pull_a * lever_a + pull_b * lever_b
    turn1, turn2 = accelerations(c, torque1, torque2, sine2, cosine2, velocity1, velocity2)
    return rise_s, rise_a, rise_b, rise_c, rise_d, velocity1, velocity2, turn1, turn2


@compiled
def derivatives2(c: Array, x: Array, valves: tuple[bool, ...]) -> State2:
    """As `moving2` at a state x (9,); which of eight valves are open, in A to D and out A to D, which overrule."""
    in_a, in_b, in_c, in_d, out_a, out_b, out_c, out_d = valves
    four = (
        -1.0 if out_a else 1.0 if in_a else 0.0, -1.0 if out_b else 1.0 if in_b else 0.0,
        -1.0 if out_c else 1.0 if in_c else 0.0, -1.0 if out_d else 1.0 if in_d else 0.0,
    )  # fmt: skip
    return moving2(c, (x[0], x[1], x[2], x[3], x[4], x[5], x[6], x[7], x[8]), four)


@compiled
def standing_torques(c: Array, x: Array) -> tuple[float, float]:
    """Torques in N m on theta1 and theta2 at a state x (9,) with the arm at rest."""
    sine1, cosine1 = math.sin(x[5]), math.cos(x[5])
    sine2, cosine2 = math.sin(x[6]), math.cos(x[6])
    h_a, h_b, lever_a, lever_b = geometry(c, sine2, cosine2)
    h_c, h_d, lever_c, lever_d = geometry1(c, sine1, cosine1)
    torque1, torque2 = resting_torques(c, sine1, cosine1, sine2, cosine2)
    pull_a, _ = pull_and_rise(c, x[1], h_a, 0.0, c[k.FACTOR_A], 0.0)
    pull_b, _ = pull_and_rise(c, x[2], h_b, 0.0, c[k.FACTOR_B], 0.0)
    pull_c, _ = pull_and_rise(c, x[3], h_c, 0.0, c[k2.FACTOR_C], 0.0)
    pull_d, _ = pull_and_rise(c, x[4], h_d, 0.0, c[k2.FACTOR_D], 0.0)
    return torque1 + pull_c * lever_c + pull_d * lever_d, torque2 + pull_a * lever_a + pull_b * lever_b
