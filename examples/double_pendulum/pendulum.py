"""A double pendulum with a drive at each joint, as its data sheet has it: no friction."""

import numpy as np

GRAVITY, LINK = 9.81, 0.3  # m/s2; m, from joint 1 to joint 2


def motion(t, x, u, p):
    """Speeds and accelerations of both joints under torques u; angle 1 hangs at 0, angle 2 is relative to link 1."""
    angle1, angle2, speed1, speed2 = x[0], x[1], x[2], x[3]
    moment2 = p.mass2 * p.centre2
    a11 = p.inertia1 + p.inertia2 + p.mass2 * LINK**2 + 2.0 * LINK * moment2 * np.cos(angle2)
    a12 = p.inertia2 + LINK * moment2 * np.cos(angle2)
    a22 = p.inertia2
    bend = LINK * moment2 * np.sin(angle2)
    low = GRAVITY * moment2 * np.sin(angle1 + angle2)
    b1 = u[0] + bend * (2.0 * speed1 * speed2 + speed2**2)
    b1 -= GRAVITY * (p.moment1 + p.mass2 * LINK) * np.sin(angle1) + low
    b2 = u[1] - bend * speed1**2 - low
    det = a11 * a22 - a12 * a12
    return speed1, speed2, (a22 * b1 - a12 * b2) / det, (a11 * b2 - a12 * b1) / det
