"""What actuators make of commands and sensors of the truth: delay, lag, gain, limits, as arrays in and out."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from scipy.signal import lfilter

from loopshape.core.units import Array

#: number of an actuator or a sensor -> its neutral value, unit
ACTUATOR = {
    "delay_ms": (0.0, "ms"), "lag_ms": (0.0, "ms"), "lag_order": (1.0, "1"), "gain": (0.0, "1"),
    "limit": (np.inf, ""), "knee": (0.0, "1"), "dead": (0.0, ""), "jump": (0.0, ""),
}  # fmt: skip
SENSOR = {
    "delay_ms": (0.0, "ms"), "lag_ms": (0.0, "ms"), "lag_order": (1.0, "1"), "gain": (0.0, "1"), "offset": (0.0, ""),
}  # fmt: skip

#: the same for one sample `value` after another, `dt` s apart, in the order in which they act: code that stands alone
SAMPLE = {
    "dead": "value = np.sign(value) * max(abs(value) - DEAD, 0.0)",
    "jump": "value = 0.0 if abs(value) < JUMP else value",
    "gain": "value = (1.0 + GAIN) * value",
    "lag_ms": """
        for k in range(int(LAG_ORDER)):
            held = state.get(k, value)
            held += dt / (dt + 1e-3 * LAG_MS / LAG_ORDER) * (value - held)
            state[k] = value = held
        """,
    "delay_ms": """
        past = [(s, v) for s, v in state.get("past", []) if s < t] + [(t, value)]
        while len(past) > 2 and past[1][0] <= t - 1e-3 * DELAY_MS:
            past.pop(0)
        state["past"] = past
        value = float(np.interp(t - 1e-3 * DELAY_MS, *zip(*past)))
        """,
    "limit": "value = float(np.clip(value, -LIMIT, LIMIT))",
    "knee": "value = value / (1.0 + min(abs(value) / LIMIT, 1e3) ** (1.0 / KNEE)) ** KNEE",
    "offset": "value = value + OFFSET",
}


def delayed(values: Array, ticks: float) -> Array:
    """Values (..., n) a number of ticks later, linearly between ticks; before the first the first stands."""
    whole, part = int(np.floor(ticks)), float(ticks - np.floor(ticks))
    return (1.0 - part) * _shifted(values, whole) + part * _shifted(values, whole + 1)


def _shifted(values: Array, n: int) -> Array:
    if n == 0:
        return values
    n = min(n, values.shape[-1])
    return np.concatenate([np.repeat(values[..., :1], n, axis=-1), values[..., : values.shape[-1] - n]], axis=-1)


def lagged(values: Array, ticks: float, order: float) -> Array:
    """Values (..., n) behind one first-order lag, or two equal ones, of `ticks` altogether; settled at the first."""
    second_order = 2.0
    times = (0.5 * ticks, 0.5 * ticks) if order == second_order else (ticks,)
    for each in times:
        pole = each / (1.0 + each)  # so that a ramp is late by `each` exactly
        values, _ = lfilter([1.0 - pole], [1.0, -pole], values, axis=-1, zi=pole * values[..., :1])
    return values


def _late(values: Array, m: Mapping[str, float], tick_s: float) -> Array:
    if m["lag_ms"] > 0.0:
        values = lagged(values, 1e-3 * m["lag_ms"] / tick_s, m["lag_order"])
    return delayed(values, 1e-3 * m["delay_ms"] / tick_s) if m["delay_ms"] > 0.0 else values


def actuated(command: Array, m: Mapping[str, float], tick_s: float) -> Array:
    """What an actuator gives (n,) for its command (n,)."""
    if m["dead"] > 0.0:
        command = np.sign(command) * np.maximum(np.abs(command) - m["dead"], 0.0)
    if m["jump"] > 0.0:
        command = np.where(np.abs(command) < m["jump"], 0.0, command)
    command = _late((1.0 + m["gain"]) * command, m, tick_s)
    return _limited(command, m["limit"], m["knee"]) if np.isfinite(m["limit"]) else command


def _limited(values: Array, limit: float, knee: float) -> Array:
    """Values cut at a limit, or bent towards it: a knee near 0 is sharp, 1 is round everywhere."""
    if knee <= 0.0:
        return np.clip(values, -limit, limit)
    share = np.minimum(np.abs(values) / limit, 1e3)
    return np.asarray(values / (1.0 + share ** (1.0 / knee)) ** knee)


def sensed(truth: Array, m: Mapping[str, float], tick_s: float) -> Array:
    """What a sensor reads (..., n) of the truth (..., n)."""
    return (1.0 + m["gain"]) * _late(truth, m, tick_s) + m["offset"]


def noise_rms(values: Array) -> float:
    """White noise's rms from third differences, in which a smooth signal vanishes; the median of blocks (Rice 1984).

    Not below the noise of rounding to the smallest step that occurs.
    """
    third = np.diff(values, 3)
    n = third.size // 50 * 50
    squares = np.mean((third[:n] ** 2).reshape(-1, 50), axis=1)
    steps = np.abs(np.diff(values))
    steps = steps[steps > 1e-9 * np.ptp(values)] if np.ptp(values) > 0.0 else np.array([1e-9])
    rounding = float(np.min(steps)) / np.sqrt(12.0)
    return max(float(np.sqrt(np.median(squares) / 20.0)), rounding, 1e-12)
