"""A second engine of the exam, in forms unlike those of the first and of the catalogue; nothing of the package.

Runge-Kutta of order 4, steps of 0.1 ms, every element a differential equation. Friction after Dahl with an exponent of
1.5 (Dahl 1976) and a level that changes along the way; drag with the power 1.5 of the speed; play a soft dead zone, its
contact's loss growing with the load; a joint's spring a hyperbolic sine; a cable that softens; a limit with a
fourth-power knee; a dead zone with soft edges; delays after Pade of order 2; lags of three equal stages; cogging a
triangle.
"""

from __future__ import annotations

import numba
import numpy as np
from engine import RATE_HZ, Truth

INNER = 10
STEP_S = 1.0 / (RATE_HZ * INNER)
SIZE = 15
Q, V, M, MV, BEND, D1, D2, L1, L2, L3, S1, S2, S3, P1, P2 = range(SIZE)


@numba.njit
def soft(x: float, half: float, edge: float) -> float:
    """A dead zone of half a width, rounded over `edge`; odd."""
    up, down = (x - half) / edge, (-x - half) / edge
    high = up + np.log1p(np.exp(-up)) if up > 0.0 else np.log1p(np.exp(up))
    low = down + np.log1p(np.exp(-down)) if down > 0.0 else np.log1p(np.exp(down))
    return edge * (high - low)


@numba.njit
def given(u: float, m: Truth) -> float:
    """Effort for a command, before what delays it."""
    if m.dead > 0.0:
        u = soft(u, m.dead, 0.1 * m.dead)
    u *= m.gain
    u -= m.sag * abs(u) * abs(u)
    if m.limit > 0.0:
        u /= (1.0 + (u / m.limit) ** 4) ** 0.25
    return u


@numba.njit
def resisted(q: float, v: float, bend: float, m: Truth) -> float:
    """Effort against the load: damping, drag, weight, friction, cable, cogging."""
    out = m.damping * v + m.weight * np.sin(q + m.tilt) + m.push
    out += 0.6 * m.drag * v * np.sqrt(abs(v) / m.scale)
    out += m.friction * (1.0 + 0.1 * np.sin(q / (0.3 * m.scale))) * bend
    off = q - m.rest
    out += m.cable * off / (1.0 + 0.25 * abs(off) / m.scale)
    phase = q / m.pitch / (2.0 * np.pi)
    return out + m.cogging * (4.0 * abs(phase - np.floor(phase) - 0.5) - 1.0)


@numba.njit
def slope(x: np.ndarray, u: float, held: float, m: Truth, dx: np.ndarray) -> None:
    """Derivatives dx of the whole chain at x under a command u; `held` is an effort with a limited rate."""
    want = given(u, m)
    dx[:] = 0.0
    if m.delay > 0.0:
        a, b = 12.0 / m.delay**2, 6.0 / m.delay
        dx[D1], dx[D2] = x[D2], want - a * x[D1] - b * x[D2]
        want = want - 2.0 * b * x[D2]
    if m.lag > 0.0:
        dx[L1], dx[L2], dx[L3] = (want - x[L1]), (x[L1] - x[L2]), (x[L2] - x[L3])
        dx[L1 : L3 + 1] *= 3.0 / m.lag
        want = x[L3]
    if m.rate > 0.0:
        want = held
    q, v = x[Q], x[V]
    against = resisted(q, v, x[BEND], m)
    if m.friction > 0.0:
        left = 1.0 - x[BEND] * np.sign(v)
        dx[BEND] = v / (2.5e-4 * m.scale) * np.sign(left) * abs(left) ** 1.5
    if m.spring > 0.0 or m.play > 0.0:
        twist, slip = x[M] - q, x[MV] - v
        if m.play > 0.0:
            edge = 0.04 * m.play
            deep = soft(twist, 0.5 * m.play, edge)
            through = m.motor * 2.5e5 * deep + m.motor * 300.0 * slip * min(abs(deep) / (0.02 * m.play), 1.0)
        else:
            wide = 0.15 * m.scale
            through = m.spring * wide * np.sinh(twist / wide) + 0.002 * m.spring * slip
        dx[M], dx[MV] = x[MV], (want - 0.3 * m.damping * x[MV] - through) / m.motor
        dx[Q], dx[V] = v, (through - against + 0.3 * m.damping * v) / m.load
    else:
        dx[Q], dx[V] = v, (want - against) / (m.load + m.motor)
        dx[M], dx[MV] = dx[Q], dx[V]
    seen = x[M]
    if m.sensor_lag > 0.0:
        dx[S1], dx[S2], dx[S3] = (seen - x[S1]), (x[S1] - x[S2]), (x[S2] - x[S3])
        dx[S1 : S3 + 1] *= 3.0 / m.sensor_lag
    if m.sensor_delay > 0.0:
        dx[P1] = x[P2]
        dx[P2] = seen - 12.0 / m.sensor_delay**2 * x[P1] - 6.0 / m.sensor_delay * x[P2]


@numba.njit
def read(x: np.ndarray, m: Truth) -> float:
    """What the sensor gives, before noise and rounding."""
    seen = x[M]
    if m.sensor_lag > 0.0:
        seen = x[S3]
    if m.sensor_delay > 0.0:
        seen = x[M] - 12.0 / m.sensor_delay * x[P2]
    return (1.0 + m.sensor_gain) * seen + m.sensor_offset


@numba.njit
def recorded(r: np.ndarray, n: np.ndarray, m: Truth, gains: tuple[float, float, float], noise: np.ndarray, step: float):
    """Commands and readings (n,) of a loop u = kp e + kd de/dt (filtered) over references r and injections n."""
    kp, kd, filtered = gains
    u_log, y_log = np.zeros(r.size), np.zeros(r.size)
    x, mid, work = np.zeros(SIZE), np.zeros(SIZE), np.zeros((4, SIZE))
    k1, k2, k3, k4 = work[0], work[1], work[2], work[3]
    fast, before, held = 0.0, 0.0, 0.0
    for i in range(r.size):
        y = step * np.round((read(x, m) + noise[i]) / step)
        error = r[i] - y + n[i]
        fast += (1.0 - np.exp(-6.2832 * filtered / RATE_HZ)) * ((error - before) * RATE_HZ - fast)
        before = error
        u = kp * error + kd * fast
        u_log[i], y_log[i] = u, y
        for _ in range(INNER):
            held += min(max(given(u, m) - held, -m.rate * STEP_S), m.rate * STEP_S)
            slope(x, u, held, m, k1)
            mid[:] = x + 0.5 * STEP_S * k1
            slope(mid, u, held, m, k2)
            mid[:] = x + 0.5 * STEP_S * k2
            slope(mid, u, held, m, k3)
            mid[:] = x + STEP_S * k3
            slope(mid, u, held, m, k4)
            x += STEP_S / 6.0 * (k1 + 2.0 * (k2 + k3) + k4)
            x[BEND] = min(max(x[BEND], -1.0), 1.0)
    return u_log, y_log
