"""The arm driven by a recording's own commands, beside what was measured: two cheap submodels, or the whole arm.

`valves`: the angle follows the measured one, the pressures are the model's (u, theta -> p), drawn back slowly since
they integrate. `muscles`: the pressures follow, the angle is the model's (p -> theta). `whole`: u -> theta. Sensors,
delays and everything else act as in the closed loop; what was recorded is never used as if it were the true state.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from loopshape.core.errors import BadSignalError
from loopshape.core.units import Array, deg
from loopshape.data.signal.recording import Recording
from loopshape.data.signal.run import Run
from loopshape.toolbox.arm import parameters as p
from loopshape.toolbox.arm.dynamics import closed_loop
from loopshape.toolbox.arm.effect import effect_parameters as e

LEAD_S = 1.0  # all states follow for half of it, then the submodel settles; not compared
STRIDE_S = 0.004  # a step between valve edges; halving it moves residuals by a hundredth
P_BLOCK, ANGLE_BLOCK = 1, 2  # rows of STRIDE_S whose mean is one compared value
P_FLOOR, MUSCLES_FLOOR, WHOLE_FLOOR = 1.0, 1.9, 3.0  # of healthy arms over white noise, on validation recordings
_ANGLE_TURN = 40.0  # rad/s: the angle's observer
_SLOW, _FAST = 1.5, 60.0  # 1/s: pressures drawn back, pressures followed
# the capacity's pressure, not measured: where it begins, how long it leads, how it is probed, how far it may be off
_CAPACITY, _CAPACITY_S, _PROBE_PA, _MOST_MBAR = 0.97, 2.0, 1e3, 80.0


@dataclass(frozen=True, eq=False)
class Followed:
    """A recording ready to be followed: commands (n, 2) in V, smoothed measurements (rows, 3) rad, Pa, Pa."""

    name: str
    commands: Array
    measured: Array
    noise: Array
    tick_s: float
    stride: int
    period_ticks: int
    dead_zone: float
    parameters: Mapping[str, float] = field(default_factory=dict)
    capacity: Array | None = None

    @property
    def row_s(self) -> float:
        """Time between rows."""
        return self.stride * self.tick_s


def simulated_along(recording: Recording, run: Run, longest_s: float | None = None) -> Followed:
    """A recording, or its first `longest_s` after the lead, for `answers`."""
    n = len(recording.columns["theta2_rad"])
    if longest_s is not None:
        n = min(n, round((LEAD_S + longest_s) * recording.rate_hz))
    columns = [recording.column(c)[:n] for c in ("theta2_rad", "p_a_bar", "p_b_bar", "u_a_v", "u_b_v")]
    raw = np.stack(columns[:3], axis=1) * np.array([1.0, 1e5, 1e5])
    known = dict(zip(p.ARM1_PARAMETERS.names, p.ARM1_PARAMETERS.vector().tolist(), strict=True))
    ticks = recording.rate_hz / run.pwm.get("frequency_hz", known["pwm_frequency_hz"])
    period = round(ticks)
    if period < 1 or abs(ticks - period) > 1e-6:
        raise BadSignalError(
            f"recording {recording.info.file} has no whole number of samples in a PWM period",
            f"{ticks:g}",
            "record at a multiple of the PWM's frequency",
        )
    longest = max(1, round(STRIDE_S * recording.rate_hz))
    stride = max(k for k in range(1, longest + 1) if period % k == 0)
    return Followed(
        name=recording.info.name,
        commands=np.ascontiguousarray(np.stack(columns[3:], axis=1)),
        measured=thinned(raw, stride),
        noise=np.array([noise_rms(raw[:, k]) for k in range(3)]),
        tick_s=1.0 / recording.rate_hz,
        stride=stride,
        period_ticks=period,
        dead_zone=run.pwm.get("dead_zone", known["pwm_dead_zone"]),
        parameters=dict(run.extra.get("parameters", {})) | dict(recording.info.parameters),
    )


def thinned(raw: Array, stride: int) -> Array:
    """Every `stride`-th sample (rows, channels) of triangular means over the samples between its neighbours."""
    if stride == 1:
        return np.ascontiguousarray(raw)
    weight = np.bartlett(2 * stride + 1)[1:-1] / stride
    padded = np.concatenate([raw[:1].repeat(stride - 1, 0), raw, raw[-1:].repeat(stride - 1, 0)])
    smooth = sum(w * padded[k : k + len(raw)] for k, w in enumerate(weight))
    return np.ascontiguousarray(np.asarray(smooth)[::stride][: len(raw) // stride])


def answers(f: Followed, vector: Array, mode: str, more_pa: float = 0.0) -> Array:
    """What the sensors would give (rows, 3), rad, Pa, Pa, from a parameter vector, in one of the three ways."""
    c = p.constants(vector)
    c[e.COULOMB_SPEED] = max(c[e.COULOMB_SPEED], 0.5 * f.row_s * c[e.COULOMB] / c[p.INERTIA])  # or the step is unstable
    return _follow(f, _start(f, c, more_pa, mode), len(f.measured), round(0.5 * LEAD_S / f.row_s), mode)


def _follow(f: Followed, arm: closed_loop.Mechanism, rows: int, lead: int, mode: str) -> Array:
    lag_s = float(arm.c[e.PRESSURE_LAG])
    both = np.array([gains(one, f.row_s, lag_s) for one in ("both", mode)])
    pwm = closed_loop.Pwm(f.tick_s, f.period_ticks, f.dead_zone)
    return closed_loop.follow(arm, f.commands, f.measured[:rows], both, lead, pwm, f.stride)


def gains(mode: str, row_s: float, lag_s: float = 0.0) -> list[float]:
    """How much per row the pressures, the angle and the velocity (1/s) are drawn to the measured ones.

    Pressures behind a lag are followed no faster than the lag, or following would not be stable.
    """
    angle = [1.4 * _ANGLE_TURN * row_s, _ANGLE_TURN**2 * row_s]
    slow, fast = _SLOW * row_s, min(_FAST, 1.0 / max(lag_s, 1e-3)) * row_s
    table = {"both": [fast, *angle], "valves": [slow, *angle], "muscles": [fast, 0.0, 0.0], "whole": [slow, 0.0, 0.0]}
    return table[mode]


def _start(f: Followed, c: Array, more_pa: float, mode: str) -> closed_loop.Mechanism:
    """The arm at the first sample; the capacity is a guess, `more_pa` above what a short lead gives it."""
    angle, p_a, p_b = f.measured[:3].mean(axis=0)
    x = np.array([_CAPACITY * c[p.P_IN], p_a, p_b, angle, 0.0, angle, 0.0])
    if mode != "muscles":  # there the pressures follow the measured ones, whatever feeds them
        tracked = closed_loop.at_rest(c, x.copy())
        _follow(f, tracked, round(_CAPACITY_S / f.row_s), 0, "both")
        x[0] = tracked.x[0] + more_pa
    return closed_loop.at_rest(c, x)


def with_capacity_slopes(f: Followed, vector: Array) -> Followed:
    """The same with what a higher capacity at the start would change in the pressures (rows, 2), mbar per mbar."""
    low, high = (_off(f, vector, "valves", more) for more in (-_PROBE_PA, _PROBE_PA))
    return replace(f, capacity=np.ascontiguousarray((high - low)[:, 1:] / (2e-2 * _PROBE_PA)))


def _settled(f: Followed, pressures: Array) -> Array:
    """Pressure errors (rows, 2) less what the capacity's pressure at the start, which was not measured, explains."""
    if f.capacity is None:
        return pressures
    most = float(np.sum(f.capacity**2)) + 1e-12
    share = -float(np.sum(f.capacity * pressures)) / most
    return np.asarray(pressures + np.clip(share, -_MOST_MBAR, _MOST_MBAR) * f.capacity)


def blocks(values: Array, length: int) -> Array:
    """Means (n // length,) over blocks."""
    n = len(values) // length * length
    return np.asarray(values[:n].reshape(-1, length).mean(axis=1))


def residuals(f: Followed, vector: Array) -> dict[str, Array]:
    """Measured minus modelled after the lead: `p_a`, `p_b` in mbar (u -> p), `theta2` in deg (p -> theta)."""
    valves, muscles = _settled(f, _off(f, vector, "valves")[:, 1:]), _off(f, vector, "muscles")
    return {
        "p_a": blocks(valves[:, 0], P_BLOCK),
        "p_b": blocks(valves[:, 1], P_BLOCK),
        "theta2": blocks(muscles[:, 0], ANGLE_BLOCK),
    }


def _off(f: Followed, vector: Array, mode: str, more_pa: float = 0.0) -> Array:
    """Measured minus modelled after the lead (rows, 3) in deg, mbar, mbar."""
    off = (f.measured - answers(f, vector, mode, more_pa))[round(LEAD_S / f.row_s) :]
    return np.asarray(off * np.array([float(deg(1.0)), 1e-2, 1e-2]))


def floors(f: Followed) -> dict[str, float]:
    """Rms in the blocks of `residuals` of a healthy arm, mbar and deg: noise, and what it does to the submodels.

    The factors over white noise were measured on healthy arms of the exam's generator.
    """
    angle, p_a, p_b = _white(f)
    return {"p_a": p_a, "p_b": p_b, "theta2": 2.2 * angle / np.sqrt(ANGLE_BLOCK)}


def _white(f: Followed) -> tuple[float, float, float]:
    """Rms that white noise of the sensors leaves in the rows, deg and mbar."""
    angle, p_a, p_b = f.noise / np.sqrt(f.stride)
    return float(deg(angle)), 1e-2 * float(p_a), 1e-2 * float(p_b)


def paths(f: Followed, vector: Array) -> dict[str, Array]:
    """Measured minus simulated outputs relative to their noise floor by path, every ROWS rows after the lead.

    Measured inputs go in: commands (u -> p, with the angle followed; u -> theta), or pressures (p -> theta). Floors
    are what healthy arms with their spread fitted leave, as for `floors`; rms 1 is no gap.
    """
    valves = _settled(f, _off(f, vector, "valves")[:, 1:])
    muscles, whole = _off(f, vector, "muscles"), _off(f, vector, "whole")
    angle, p_a, p_b = _white(f)
    own = {
        "u -> p_a": valves[:, 0] / (P_FLOOR * p_a),
        "u -> p_b": valves[:, 1] / (P_FLOOR * p_b),
        "p -> theta2": muscles[:, 0] / (MUSCLES_FLOOR * angle),
        "u -> theta2": whole[:, 0] / (WHOLE_FLOOR * angle),
    }
    return {name: values[::ANGLE_BLOCK] for name, values in own.items()}


def trace(f: Followed, vector: Array) -> tuple[float, Array, Array]:
    """Step between rows in s, measured and simulated angle (rows,) in deg, the arm driven by its commands alone."""
    simulated = answers(f, vector, "whole")[:, 0]
    return f.row_s, np.asarray(deg(f.measured[:, 0])), np.asarray(deg(simulated))


def noise_rms(values: Array) -> float:
    """White noise's rms from third differences, in which a smooth signal vanishes; the median of blocks (Rice 1984)."""
    squares = blocks(np.diff(values, 3) ** 2, 50)
    steps = np.diff(np.unique(values))
    grid = float(steps.min()) / np.sqrt(12.0) if steps.size else 0.0
    return max(float(np.sqrt(np.median(squares) / 20.0)), grid)
