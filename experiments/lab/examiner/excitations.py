"""Signals of a session: shaped multisines and sweeps, pulses and moves.

The tables give the size of C n, what the controller makes of the injected signal, so that the arm is excited
evenly; they were read off recordings of real sessions.
"""

from __future__ import annotations

import numpy as np

from loopshape.core.units import TWO_PI, Array, rad
from loopshape.data.control.controller import Controller

RATE_HZ = 1000.0
PERIOD_S, PERIODS, RAMP_S = 10.0, 4, 1.0

_LINE_HZ = np.array([
    0.1, 0.3, 0.5, 0.7, 0.9, 1.1, 1.5, 2.1, 3.1, 4.1, 4.5, 4.9, 5.3, 5.7, 6.1, 6.5, 7.3, 8.1, 9.1, 10.1, 11.3, 12.5,
    13.7, 14.9,
])  # fmt: skip
_WEAK_V = np.array([
    0.5207, 0.1412, 0.0616, 0.0312, 0.0186, 0.0145, 0.0152, 0.0179, 0.0200, 0.0211, 0.0218, 0.0231, 0.0204, 0.0169,
    0.0163, 0.0158, 0.0144, 0.0127, 0.01045, 0.00838, 0.00631, 0.00472, 0.00354, 0.00268,
])  # fmt: skip
_BENT_V = np.array([
    0.658, 0.182, 0.0824, 0.0436, 0.0253, 0.0162, 0.0110, 0.0122, 0.0144, 0.0159, 0.0170, 0.0160, 0.0135, 0.0131,
    0.0128, 0.01234, 0.01122, 0.0099, 0.00817, 0.00657, 0.00497, 0.00374, 0.00281, 0.00213,
])  # fmt: skip
_STIFF_V = np.array([
    0.756, 0.201, 0.0854, 0.0437, 0.0308, 0.0297, 0.0341, 0.0387, 0.0421, 0.0433, 0.0437, 0.0444, 0.0457, 0.0484,
    0.0404, 0.0292, 0.0273, 0.0246, 0.0206, 0.0166, 0.0126, 0.00942, 0.00708, 0.00536,
])  # fmt: skip
_LINES = {"weak": _WEAK_V, "strong": 3.5 * _WEAK_V, "bent": _BENT_V, "stiff": _STIFF_V}

_SWEEP_HZ = np.array([
    0.1, 0.13, 0.2, 0.3, 0.45, 0.7, 1.0, 1.4, 2.0, 3.0, 4.0, 4.5, 5.0, 5.5, 6.0, 7.0, 8.5, 10.0, 12.0, 13.5, 15.0,
])  # fmt: skip
_SWEEPS = {
    "p_ab": np.array([
        3.40, 2.63, 1.729, 1.154, 0.772, 0.501, 0.356, 0.262, 0.195, 0.147, 0.1265, 0.1197, 0.1138, 0.1082, 0.1025,
        0.0902, 0.0700, 0.0510, 0.0319, 0.0223, 0.0158,
    ]),
    "theta2": np.array([
        3.08, 2.35, 1.441, 0.851, 0.446, 0.187, 0.0998, 0.0981, 0.1166, 0.1315, 0.1389, 0.1387, 0.1518, 0.1502, 0.1030,
        0.0941, 0.0755, 0.0553, 0.0345, 0.0241, 0.0170,
    ]),
}  # fmt: skip
_SWEEP_FROM_HZ, _SWEEP_TO_HZ, _SWEEP_S, _SWEEP_START_S = 0.1, 15.0, 40.0, 0.5


def _size(frequency_hz: Array, at_hz: Array, table: Array, controller: Controller) -> Array:
    """Amplitude of n at frequencies, from the table of C n."""
    wanted = np.exp(np.interp(np.log(frequency_hz), np.log(at_hz), np.log(table)))
    return np.asarray(wanted / np.abs(controller.response(frequency_hz)))


def lines(rng: np.random.Generator) -> Array:
    """Lines of a multisine in multiples of 1/period: odd ones to 149, one of each three left out at random."""
    groups = np.arange(3, 147, 2).reshape(-1, 3)
    kept = [np.delete(group, rng.integers(3)) for group in groups]
    return np.concatenate([[1], *kept, [147, 149]])


def multisine(design: str, controller: Controller, rng: np.random.Generator) -> Array:
    """Injected angle (41000,) in rad: a ramp of 1 s, four periods of 10 s; phases the best of a few draws."""
    k = lines(rng)
    while design == "strong" and k[1] != 3:  # the lowest line would carry more than the arm's range
        k = lines(rng)
    n = round(PERIOD_S * RATE_HZ)
    gap = np.gradient(k.astype(float)) / 2.0
    size = _size(k / PERIOD_S, _LINE_HZ, _LINES[design], controller) * np.sqrt(gap)
    spectra = np.zeros((8, n // 2 + 1), dtype=complex)
    spectra[:, k] = 0.5 * n * size * np.exp(1j * TWO_PI * rng.random((8, k.size)))
    periods = np.fft.irfft(spectra, n)
    one = periods[np.argmin(np.abs(periods).max(axis=1))]
    rising = round(RAMP_S * RATE_HZ)
    signal = one[np.arange(-rising, PERIODS * n) % n]
    signal[:rising] *= 0.5 - 0.5 * np.cos(0.5 * TWO_PI * (np.arange(rising) + 0.5) / rising)
    return signal


def sweep(loop: str, controller: Controller) -> Array:
    """Injected signal (40500,): half a second of rest, then up from 0.1 to 15 Hz and back, logarithmic in time."""
    n = round((_SWEEP_START_S + _SWEEP_S) * RATE_HZ)
    t = np.maximum(np.arange(n) / RATE_HZ - _SWEEP_START_S, 0.0)
    growth = np.log(_SWEEP_TO_HZ / _SWEEP_FROM_HZ) / (0.5 * _SWEEP_S)
    rising = np.minimum(t, _SWEEP_S - t)
    f = _SWEEP_FROM_HZ * np.exp(growth * rising)
    cycles = (f - _SWEEP_FROM_HZ) / growth
    top = (_SWEEP_TO_HZ - _SWEEP_FROM_HZ) / growth
    cycles = np.where(t > 0.5 * _SWEEP_S, 2.0 * top - cycles, cycles)
    return _size(f, _SWEEP_HZ, _SWEEPS[loop], controller) * np.sin(TWO_PI * cycles)


def pulses(n: int, rng: np.random.Generator) -> Array:
    """Control z (n, 2) in V, loops open: three pairs of opposite pulses on the angle, one on the pressures."""
    z = np.zeros((n, 2))
    sign, at = float(rng.choice([-1.0, 1.0])), 500
    for _ in range(3):
        height = rng.uniform(0.2, 0.42)
        width = round(rng.uniform(0.067, 0.088) / height * RATE_HZ)
        for s in (sign, -sign):
            z[at : at + width, 0] = s * height
            at += width + round(rng.uniform(0.36, 0.58) * RATE_HZ) if s == -sign else width
            at += round(rng.uniform(0.36, 0.58) * RATE_HZ) if s == sign else 0
        sign = -sign
    height, width = rng.uniform(0.15, 0.28), round(rng.uniform(0.15, 0.30) * RATE_HZ)
    for s in (1.0, -1.0):
        z[at : at + width, 1] = s * height
        at += width + 500
    return z


def profile(rng: np.random.Generator) -> Array:
    """Setpoint (n,) in rad: quick moves between -30 and 30 deg in a drawn order, then slow ones over the range."""
    middle = [[15.0, -15.0, 30.0], [-15.0, 30.0], [-15.0, 15.0, 30.0], [15.0, -30.0, 30.0]]
    quick = [30.0, -30.0, *middle[int(rng.integers(len(middle)))], 0.0]
    if rng.random() < 0.5:
        quick = [-x for x in quick]
    sign = float(rng.choice([-1.0, 1.0]))
    slow = [30.0 * sign, -30.0 * sign, 0.0]
    signal, last = np.zeros(round(1.2 * RATE_HZ)), 0.0
    for k, (level, limits) in enumerate([(x, (1.2, 5.0, 50.0)) for x in quick] + [(x, (0.5, 1.5, 7.5)) for x in slow]):
        rest_s = 2.2 if k == len(quick) - 1 else (1.2 if k < len(quick) else 1.0)
        signal = np.concatenate([signal, _move(last, level, limits, rest_s)])
        last = level
    return signal


def _move(from_deg: float, to_deg: float, limits: tuple[float, float, float], rest_s: float) -> Array:
    """A move in rad under limits of speed, acceleration and jerk, and the rest after it."""
    before, after = float(rad(from_deg)), float(rad(to_deg))
    t = np.arange(round(20.0 * RATE_HZ)) / RATE_HZ
    x = np.full(t.size, before) + np.sign(after - before) * _travelled(t, abs(after - before), *limits)
    arrived = int(np.flatnonzero(np.abs(x - after) > 1e-9)[-1]) + 1
    return x[: arrived + round(rest_s * RATE_HZ)]


def _travelled(t: Array, distance: float, speed: float, acceleration: float, jerk: float) -> Array:
    """Way (n,) of the soonest move over a distance at times t (n,): seven stretches of constant jerk."""
    jerks_s = min(acceleration / jerk, np.sqrt(speed / jerk), np.cbrt(distance / (2.0 * jerk)))
    most = jerk * jerks_s  # of the acceleration
    bends_s = 0.5 * (-3.0 * jerks_s + np.sqrt(jerks_s**2 + 4.0 * distance / most))
    steady_s = max(0.0, min(speed / most - jerks_s, bends_s))
    fastest = most * (jerks_s + steady_s)
    cruise_s = max((distance - fastest * (2 * jerks_s + steady_s)) / fastest, 0.0)
    ends = np.cumsum([0.0, jerks_s, steady_s, jerks_s, cruise_s, jerks_s, steady_s, jerks_s])
    late = np.maximum(np.minimum(t, ends[-1])[:, None] - ends, 0.0)
    return np.asarray((late**3 @ (np.array([1, -1, -1, 1, -1, 1, 1, -1]) * jerk)) / 6.0)
