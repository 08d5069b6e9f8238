"""Simulated carts and pendulums of the exam: an engine and forms of their own, nothing of the package or of MuJoCo.

Semi-implicit Euler of 0.05 ms. Play is a contact after Hertz, a limit a sixth-power knee, lags two unequal ones, a
cable and a joint's spring harden with the deflection itself. Friction is LuGre's (Canudas de Wit 1995) and drag a sum
of the speed and its square; in `slips`, for exams since the catalogue has both, friction is five slip elements in
parallel (Iwan 1966, Al-Bender 2005) whose level falls after Tustin (1947), drag the root of the sum of both squares.
"""

from __future__ import annotations

from typing import NamedTuple

import numba
import numpy as np

RATE_HZ, INNER = 1000, 20
STEP_S = 1.0 / (RATE_HZ * INNER)


class Truth(NamedTuple):
    """What a specimen is; zeros are no effect. `weight` in N m (0 for a cart), efforts in N m or N, times in s."""

    load: float = 0.0
    motor: float = 0.0
    damping: float = 0.0
    weight: float = 0.0
    push: float = 0.0  # constant effort
    tilt: float = 0.0
    gain: float = 1.0
    delay: float = 0.0
    lag: float = 0.0
    limit: float = 0.0
    dead: float = 0.0
    friction: float = 0.0
    drag: float = 0.0
    cable: float = 0.0
    rest: float = 0.0
    spring: float = 0.0
    play: float = 0.0
    sensor_gain: float = 0.0
    sensor_offset: float = 0.0
    sensor_delay: float = 0.0
    sensor_lag: float = 0.0
    cogging: float = 0.0
    pitch: float = 1.0
    sag: float = 0.0
    rate: float = 0.0
    scale: float = 1.0  # size of the motion
    slips: bool = False  # slip elements instead of bristles


@numba.njit
def actuated(u: float, m: Truth) -> float:
    """Effort for a command: dead zone with round ends, gain, a sag with the square, a round limit."""
    if m.dead > 0.0:
        u *= 1.0 - np.exp(-((abs(u) / m.dead) ** 3))
        u -= m.dead * np.tanh(u / m.dead)
    u *= m.gain
    u -= m.sag * abs(u) * abs(u)
    if m.limit > 0.0:
        u /= (1.0 + (abs(u) / m.limit) ** 6) ** (1.0 / 6.0)
    return u


@numba.njit
def slipped(v: float, bent: np.ndarray, m: Truth) -> float:
    """Friction of slip elements, whose deflections move on; each holds a share of the level, stiff ones slip first."""
    level = m.friction * (1.0 + 0.3 * np.exp(-abs(v) / (0.04 * m.scale)) + 0.05 * np.sign(v))
    force = 0.0
    for k in range(bent.size):
        most = 2e-4 * m.scale * 2.0**k
        bent[k] = min(max(bent[k] + STEP_S * v, -most), most)
        force += level * bent[k] / most / bent.size
    return force


@numba.njit
def late(line: np.ndarray, k: int, seconds: float) -> float:
    """The value of some seconds ago in a ring of inner steps."""
    return line[(k - round(seconds / STEP_S)) % line.size]


@numba.njit
def recorded(r: np.ndarray, n: np.ndarray, m: Truth, gains: tuple[float, float, float], noise: np.ndarray, step: float):
    """Commands and readings (n,) of a loop u = kp e + kd de/dt (filtered) over references r and injections n."""
    kp, kd, filtered = gains
    u_log, y_log = np.zeros(r.size), np.zeros(r.size)
    lines, seen, bent = np.zeros(4000), np.zeros(4000), np.zeros(5)
    q, v, motor, motor_v, bristle, a1, a2, s1, s2, slope, before, held = (0.0,) * 12
    k = 0
    for i in range(r.size):
        read = late(seen, k - 1, m.sensor_delay) if i else 0.0
        y = step * np.round(((1.0 + m.sensor_gain) * read + m.sensor_offset + noise[i]) / step)
        error = r[i] - y + n[i]
        slope += (1.0 - np.exp(-6.2832 * filtered / RATE_HZ)) * ((error - before) * RATE_HZ - slope)
        before = error
        u = kp * error + kd * slope
        u_log[i], y_log[i] = u, y
        for _ in range(INNER):
            lines[k % 4000] = u
            want = actuated(late(lines, k, m.delay), m)
            if m.lag > 0.0:
                a1 += STEP_S / (0.7 * m.lag) * (want - a1)
                a2 += STEP_S / (0.3 * m.lag) * (a1 - a2)
                want = a2
            if m.rate > 0.0:
                held += min(max(want - held, -m.rate * STEP_S), m.rate * STEP_S)
                want = held
            effort = 0.0
            if m.friction > 0.0 and m.slips:
                effort -= slipped(v, bent, m)
            elif m.friction > 0.0:
                level = m.friction * (1.0 + 0.25 * np.exp(-((v / (0.02 * m.scale)) ** 2)) + 0.05 * np.tanh(v / m.scale))
                bend = 4e-4 * m.scale
                rise = v - abs(v) * bristle * m.friction / (bend * level)
                bristle += STEP_S * rise
                effort -= m.friction * bristle / bend + 0.02 * m.friction / m.scale * rise
            fast = 0.6 * abs(v) / (3.0 * m.scale)
            effort -= m.damping * v + m.drag * v * (np.hypot(0.4, fast) if m.slips else 0.4 + fast)
            effort -= m.weight * np.sin(q + m.tilt) + m.push
            off = q - m.rest
            effort -= m.cable * off * (1.0 + 0.6 * abs(off) / m.scale)
            effort -= m.cogging * np.sin(q / m.pitch)
            if m.spring > 0.0 or m.play > 0.0:
                twist = motor - q
                if m.play > 0.0:
                    deep = max(abs(twist) - 0.5 * m.play, 0.0)
                    through = np.sign(twist) * m.motor * 4e7 / np.sqrt(m.scale) * deep**1.5 * 0.05
                    through += (0.02 * m.motor * 1e4 * (motor_v - v)) if deep > 0.0 else 0.0
                else:
                    through = m.spring * twist * (1.0 + 3.0 * abs(twist) / m.scale) + 0.002 * m.spring * (motor_v - v)
                motor_v += STEP_S * (want - through) / m.motor
                motor += STEP_S * motor_v
                v += STEP_S * (effort + through) / m.load
                q += STEP_S * v
            else:
                v += STEP_S * (effort + want) / (m.load + m.motor)
                q += STEP_S * v
                motor, motor_v = q, v
            out = motor
            if m.sensor_lag > 0.0:
                s1 += STEP_S / (0.6 * m.sensor_lag) * (out - s1)
                s2 += STEP_S / (0.4 * m.sensor_lag) * (s1 - s2)
                out = s2
            seen[k % 4000] = out
            k += 1
    return u_log, y_log
