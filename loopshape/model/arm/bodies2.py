"""Both bodies of the 2-DoF arm (appendix F as ARM.md, section 5, restores it): links, spring, equations of motion.

Angles in rad; `sine` and `cosine` are of the joint named. Muscles A and B act between body 1 and body 2 and pull
on theta2 alone: their geometry is the 1-DoF arm's.
"""

from __future__ import annotations

import math

from loopshape.core.units import Array
from loopshape.model.arm import parameters as k
from loopshape.model.arm import parameters2 as k2
from loopshape.model.arm.model import in_line


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
