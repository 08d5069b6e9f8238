"""Many short simulations of one right-hand side, with forces of effects at its ports, on bare arrays.

Fixed-step Runge-Kutta of order 4 (Kutta 1901). The state is extended by three numbers a port: deflection of the
friction's bristles (Dahl 1968; with a level that falls with the speed Canudas de Wit 1995), position and speed of the
motor where a coupling stands between motor and load. Bristles slide in less than a step: their equation is linear in
the deflection, and is solved exactly at the speed of each stage (an exponential integrator).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numba
import numpy as np

from loopshape.core.units import Array

PER_PORT = 3
BRISTLE, MOTOR, MOTOR_SPEED = 0, 1, 2


#: what acts at a port, a row of an array (nports, fields); zeros are no effect, an inertia of zero is a rigid joint
FIELDS = (
    "viscous", "coulomb", "coulomb_speed", "bristle", "stribeck", "stribeck_speed", "stiffness", "hardening", "rest",
    "offset", "coupling", "coupling_damping", "play", "inertia",
    "viscous_speed", "viscous_power", "asymmetry", "coupling_hardening", "motor_damping", "viscous_square",
    "load", "driven_back", "load_stribeck", "load_square",
)  # fmt: skip
(
    VISCOUS, COULOMB, COULOMB_SPEED, BRISTLES, STRIBECK, STRIBECK_SPEED, STIFFNESS, HARDENING, REST,
    OFFSET, COUPLING, COUPLING_DAMPING, PLAY, INERTIA,
    VISCOUS_SPEED, VISCOUS_POWER, ASYMMETRY, COUPLING_HARDENING, MOTOR_DAMPING, VISCOUS_SQUARE,
    LOAD, DRIVEN_BACK, LOAD_STRIBECK, LOAD_SQUARE,
) = range(len(FIELDS))  # fmt: skip
#: where a port is: indices of its input, position and speed, its own number, and its first own state, -1 without, a row
DRIVEN, POSITION, SPEED, PORT, OWN = range(5)


class Acting(NamedTuple):
    """A model's parameters, what acts at its ports (nports, fields), and their places (nports, 5)."""

    p: Any
    f: Array
    places: np.ndarray


class Driving(NamedTuple):
    """Rows of the inputs (n, nu) where windows begin, the inputs, seconds a row and the steps taken within it."""

    first: np.ndarray
    u: Array
    tick_s: float
    steps: int


_njit = numba.njit(nogil=True, error_model="numpy", _nrt=False)  # these make no arrays: counting references took most


@_njit
def level(f: Array, j: int, v: float) -> float:
    """Dry friction while sliding at a speed v: higher at break-away, another in each direction."""
    level = f[j, COULOMB]
    if f[j, ASYMMETRY] != 0.0:
        level *= 1.0 + f[j, ASYMMETRY] * np.sign(v)
    if f[j, STRIBECK] != 0.0:
        level *= 1.0 + f[j, STRIBECK] * np.exp(-((v / f[j, STRIBECK_SPEED]) ** 2))
    return level


@_njit
def friction(f: Array, j: int, v: float, z: float, u: float) -> float:
    """Force of dry friction against a speed v, of bristles by their deflection z.

    Without bristles it takes a share of the force u that the joint transmits too, a larger one at break-away, where u
    is against v, or in proportion to u (Duclusaud 2024, arXiv 2410.08650, M3 to M6, has motor and load torques apart:
    in slow motion this share is some twice the K_l of its M3). Misleading where u does not pass a gear.
    """
    if f[j, COULOMB] == 0.0 and f[j, LOAD] == 0.0 and f[j, DRIVEN_BACK] == 0.0 and f[j, LOAD_SQUARE] == 0.0:
        return 0.0
    if f[j, BRISTLES] > 0.0:
        return f[j, COULOMB] * z / f[j, BRISTLES]
    most = level(f, j, v)
    if f[j, LOAD] != 0.0 or f[j, DRIVEN_BACK] != 0.0 or f[j, LOAD_SQUARE] != 0.0:
        share = f[j, LOAD] + f[j, DRIVEN_BACK] * (u * v < 0.0) + f[j, LOAD_SQUARE] * abs(u)
        if f[j, LOAD_STRIBECK] != 0.0:
            share += f[j, LOAD] * f[j, LOAD_STRIBECK] * np.exp(-((v / f[j, STRIBECK_SPEED]) ** 2))
        most += share * abs(u)
    return most * np.tanh(v / f[j, COULOMB_SPEED])


@_njit
def _bend(f: Array, places: Array, x: Array, stage: Array, h: float) -> None:
    """Deflections of the bristles in `stage`, a time h after those in x, at the mean of both speeds."""
    for j in range(places.shape[0]):
        if f[j, BRISTLES] > 0.0 and f[j, COULOMB] > 0.0:
            k, v = places[j, OWN] + BRISTLE, 0.5 * (x[places[j, SPEED]] + stage[places[j, SPEED]])
            most = f[j, BRISTLES] * level(f, j, v) / f[j, COULOMB]
            slid = np.exp(-abs(v) * h / most)
            stage[k] = slid * x[k] + (1.0 - slid) * most * np.sign(v)


@_njit
def resisting(f: Array, j: int, q: float, v: float) -> float:
    """Springs, further damping and a constant, against the motion."""
    d, viscous = q - f[j, REST], f[j, VISCOUS]
    if f[j, VISCOUS_POWER] != 0.0:
        viscous *= (abs(v) / f[j, VISCOUS_SPEED] + 1e-6) ** f[j, VISCOUS_POWER]
    if f[j, VISCOUS_SQUARE] != 0.0:
        viscous *= 1.0 + f[j, VISCOUS_SQUARE] * (abs(v) / f[j, VISCOUS_SPEED] - 1.0)
    return viscous * v + f[j, STIFFNESS] * d * (1.0 + f[j, HARDENING] * d * d) - f[j, OFFSET]


@_njit
def coupled(f: Array, j: int, twist: float, slip: float) -> float:
    """Force through a coupling with play."""
    half = 0.5 * f[j, PLAY]
    if abs(twist) <= half:
        return 0.0
    bent = twist - np.sign(twist) * half
    return f[j, COUPLING] * bent * (1.0 + f[j, COUPLING_HARDENING] * bent * bent) + f[j, COUPLING_DAMPING] * slip


@_njit
def no_law(j, q, v, x, u, p):  # type: ignore[no-untyped-def]
    """Effort of an actuator's law within the motion at port j, at a position and speed: of a model without any."""
    return 0.0


@_njit
def _driven(law, f, places, x, u, p, drive, dx):  # type: ignore[no-untyped-def]
    """What drives the model, `drive` (nu,), under inputs u and the forces at its ports, whose derivatives go to dx.

    Behind a coupling a law acts on the motor, and what the motion gives of it at the load is taken away.
    """
    for i in range(drive.size):
        drive[i] = u[i]
    for j in range(places.shape[0]):
        q, v, k, a, bent = x[places[j, POSITION]], x[places[j, SPEED]], places[j, OWN], places[j, DRIVEN], 0.0
        if k >= 0:
            dx[k + BRISTLE] = dx[k + MOTOR] = dx[k + MOTOR_SPEED] = 0.0
            bent = x[k + BRISTLE]
            if f[j, INERTIA] > 0.0:
                through = coupled(f, j, x[k + MOTOR] - q, x[k + MOTOR_SPEED] - v)
                dx[k + MOTOR] = x[k + MOTOR_SPEED]
                own = drive[a] + law(places[j, PORT], x[k + MOTOR], x[k + MOTOR_SPEED], x, u, p)
                own -= f[j, MOTOR_DAMPING] * x[k + MOTOR_SPEED]
                dx[k + MOTOR_SPEED] = (own - through) / f[j, INERTIA]
                drive[a] = through - law(places[j, PORT], q, v, x, u, p)
        load = drive[a]
        if f[j, LOAD] != 0.0 or f[j, DRIVEN_BACK] != 0.0 or f[j, LOAD_SQUARE] != 0.0:
            load += law(places[j, PORT], q, v, x, u, p)
        drive[a] -= friction(f, j, v, bent, load) + resisting(f, j, q, v)


@numba.njit(nogil=True, error_model="numpy")
def _buffers(wide: int, nu: int) -> tuple[Array, ...]:
    """Of one window: state, that of a stage, slopes of four stages, its row of the inputs, and what drives it."""
    x, mid, row, drive = np.empty(wide), np.empty(wide), np.empty(nu), np.empty(nu)
    return x, mid, np.empty(wide), np.empty(wide), np.empty(wide), np.empty(wide), row, drive


@numba.njit(nogil=True, error_model="numpy")
def _kept(f: Array, places: np.ndarray, x: Array, out: Array) -> None:
    """States (nx,) of an extended state as they are seen: a port with a motor of its own shows that one's place."""
    for i in range(out.size):
        out[i] = x[i]
    for j in range(places.shape[0] if x.size > out.size else 0):
        if f[j, INERTIA] > 0.0:
            out[places[j, POSITION]] = x[places[j, OWN] + MOTOR]


@numba.njit(nogil=True, error_model="numpy")
def windows(motion, law, acting, x0, driving, out):  # type: ignore[no-untyped-def]
    """Fill out (windows, length, nx): states at each row of the inputs from x0 (windows, extended).

    x0 may be (windows, nx) where no port has bristles or a motor of its own.
    """
    p, f, places = acting
    first, u, tick_s, steps = driving
    wide, nx, nu, h = x0.shape[1], out.shape[2], u.shape[1], tick_s / steps
    x, mid, k1, k2, k3, k4, row, drive = _buffers(wide, nu)
    other_x, other_mid, other_k1, other_k2, other_k3, other_k4, other_row, other_drive = _buffers(wide, nu)
    for one in range(0, x0.shape[0], 2):  # two at a time: while one waits for a result the other is computed
        other = min(one + 1, x0.shape[0] - 1)
        for i in range(wide):
            x[i], other_x[i] = x0[one, i], x0[other, i]
        for n in range(out.shape[1]):
            _kept(f, places, x, out[one, n])
            _kept(f, places, other_x, out[other, n])
            for i in range(nu):
                row[i], other_row[i] = u[first[one] + n, i], u[first[other] + n, i]
            t, other_t = (first[one] + n) * tick_s, (first[other] + n) * tick_s
            for s in range(steps):
                _driven(law, f, places, x, row, p, drive, k1)
                _driven(law, f, places, other_x, other_row, p, other_drive, other_k1)
                moved = motion(t + s * h, x, drive, p)
                other_moved = motion(other_t + s * h, other_x, other_drive, p)
                for i in range(nx):
                    k1[i], other_k1[i] = moved[i], other_moved[i]
                for i in range(wide):
                    mid[i], other_mid[i] = x[i] + 0.5 * h * k1[i], other_x[i] + 0.5 * h * other_k1[i]
                if wide > nx:
                    _bend(f, places, x, mid, 0.5 * h)
                    _bend(f, places, other_x, other_mid, 0.5 * h)
                _driven(law, f, places, mid, row, p, drive, k2)
                _driven(law, f, places, other_mid, other_row, p, other_drive, other_k2)
                moved = motion(t + (s + 0.5) * h, mid, drive, p)
                other_moved = motion(other_t + (s + 0.5) * h, other_mid, other_drive, p)
                for i in range(nx):
                    k2[i], other_k2[i] = moved[i], other_moved[i]
                for i in range(wide):
                    mid[i], other_mid[i] = x[i] + 0.5 * h * k2[i], other_x[i] + 0.5 * h * other_k2[i]
                if wide > nx:
                    _bend(f, places, x, mid, 0.5 * h)
                    _bend(f, places, other_x, other_mid, 0.5 * h)
                _driven(law, f, places, mid, row, p, drive, k3)
                _driven(law, f, places, other_mid, other_row, p, other_drive, other_k3)
                moved = motion(t + (s + 0.5) * h, mid, drive, p)
                other_moved = motion(other_t + (s + 0.5) * h, other_mid, other_drive, p)
                for i in range(nx):
                    k3[i], other_k3[i] = moved[i], other_moved[i]
                for i in range(wide):
                    mid[i], other_mid[i] = x[i] + h * k3[i], other_x[i] + h * other_k3[i]
                if wide > nx:
                    _bend(f, places, x, mid, h)
                    _bend(f, places, other_x, other_mid, h)
                _driven(law, f, places, mid, row, p, drive, k4)
                _driven(law, f, places, other_mid, other_row, p, other_drive, other_k4)
                moved = motion(t + (s + 1) * h, mid, drive, p)
                other_moved = motion(other_t + (s + 1) * h, other_mid, other_drive, p)
                for i in range(nx):
                    k4[i], other_k4[i] = moved[i], other_moved[i]
                for i in range(wide):
                    mid[i] = x[i] + h / 6.0 * (k1[i] + 2.0 * (k2[i] + k3[i]) + k4[i])
                    other_mid[i] = other_x[i] + h / 6.0 * (
                        other_k1[i] + 2.0 * (other_k2[i] + other_k3[i]) + other_k4[i]
                    )
                if wide > nx:
                    _bend(f, places, x, mid, h)
                    _bend(f, places, other_x, other_mid, h)
                for i in range(wide):
                    x[i], other_x[i] = mid[i], other_mid[i]


def compiled(motion: Callable[..., Any]) -> Callable[..., Any]:
    """The right-hand side compiled by numba, or as it is where numba's plain functions run."""
    return motion if isinstance(motion, numba.core.dispatcher.Dispatcher) else numba.njit(nogil=True)(motion)
