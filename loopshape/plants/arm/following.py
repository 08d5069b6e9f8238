"""The arm driven by a recording's own commands, beside what was measured: two cheap submodels, or the whole arm.

`valves`: the angle follows the measured one, the pressures are the model's (u, theta -> p), drawn back slowly since
they integrate. `muscles`: the pressures follow, the angle is the model's (p -> theta). `whole`: u -> theta. Sensors,
delays and everything else act as in the closed loop; what was recorded is never used as if it were the true state.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from loopshape.plants.arm import closed_loop, memory
from loopshape.plants.arm import effect_parameters as e
from loopshape.plants.arm import parameters as p
from loopshape.recording import Recording
from loopshape.run import Run
from loopshape.units import Array, deg

LEAD_S = 1.0  # all states follow for half of it, then the submodel settles; not compared
STRIDE_S = 0.004  # a step between valve edges; halving it moves residuals by a hundredth
P_BLOCK, ANGLE_BLOCK = 1, 2  # rows of STRIDE_S whose mean is one compared value
_ANGLE_TURN = 40.0  # rad/s: the angle's observer
_SLOW, _FAST = 1.5, 60.0  # 1/s: pressures drawn back, pressures followed
_CAPACITY_S = 2.0  # the capacity's pressure, not measured, comes from so much of the recording


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

    @property
    def row_s(self) -> float:
        """Time between rows."""
        return self.stride * self.tick_s


def followed(recording: Recording, run: Run, longest_s: float | None = None) -> Followed:
    """A recording, or its first `longest_s` after the lead, for `answers`."""
    n = len(recording.columns["theta2_rad"])
    if longest_s is not None:
        n = min(n, round((LEAD_S + longest_s) * recording.rate_hz))
    columns = [recording.column(c)[:n] for c in ("theta2_rad", "p_a_bar", "p_b_bar", "u_a_v", "u_b_v")]
    raw = np.stack(columns[:3], axis=1) * np.array([1.0, 1e5, 1e5])
    period = round(recording.rate_hz / run.pwm["frequency_hz"])
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
        dead_zone=run.pwm["dead_zone"],
        parameters=dict(run.extra.get("parameters", {})) | dict(recording.info.parameters),
    )


def thinned(raw: Array, stride: int) -> Array:
    """Every `stride`-th sample (rows, channels) of triangular means over the samples between its neighbours."""
    if stride == 1:
        return np.ascontiguousarray(raw)
    weight = np.bartlett(2 * stride + 1)[1:-1] / stride
    padded = np.concatenate([raw[:1].repeat(stride - 1, 0), raw, raw[-1:].repeat(stride - 1, 0)])
    smooth = sum(w * padded[k : k + len(raw)] for k, w in enumerate(weight))
    return np.ascontiguousarray(np.asarray(smooth)[:: stride][: len(raw) // stride])


def answers(f: Followed, vector: Array, mode: str) -> Array:
    """What the sensors would give (rows, 3), rad, Pa, Pa, from a parameter vector, in one of the three ways."""
    c = p.constants(vector)
    c[e.COULOMB_SPEED] = max(c[e.COULOMB_SPEED], 0.5 * f.row_s * c[e.COULOMB] / c[p.INERTIA])  # or the step is unstable
    x, m = _start(f, c)
    out = np.empty_like(f.measured)
    lead = round(0.5 * LEAD_S / f.row_s)
    _follow(f, c, x, m, out, lead, mode)
    return out


def _follow(f: Followed, c: Array, x: Array, m: Array, out: Array, lead: int, mode: str) -> None:
    closed_loop.follow(
        c, x, m, f.commands, f.measured[: len(out)], gains("both", f.row_s), gains(mode, f.row_s), lead,
        f.tick_s, f.stride, f.period_ticks, f.dead_zone, out,
    )  # fmt: skip


def gains(mode: str, row_s: float) -> Array:
    """How much per row the pressures, the angle and the velocity (1/s) are drawn to the measured ones."""
    angle = [1.4 * _ANGLE_TURN * row_s, _ANGLE_TURN**2 * row_s]
    slow, fast = _SLOW * row_s, _FAST * row_s
    table = {"both": [fast, *angle], "valves": [slow, *angle], "muscles": [fast, 0.0, 0.0], "whole": [slow, 0.0, 0.0]}
    return np.array(table[mode])


def _start(f: Followed, c: Array) -> tuple[Array, Array]:
    """State and memory at the first sample, with the capacity as two seconds of this recording leave it."""
    angle, p_a, p_b = f.measured[:3].mean(axis=0)
    x = np.array([0.97 * c[p.P_IN], p_a, p_b, angle, 0.0, angle, 0.0])
    m = np.empty(memory.SIZE)
    memory.start(c, x, m)
    y, w = x.copy(), m.copy()
    _follow(f, c, y, w, np.empty((min(round(_CAPACITY_S / f.row_s), len(f.measured)), 3)), 0, "both")
    x[0] = y[0]
    return x, m


def blocks(values: Array, length: int) -> Array:
    """Means (n // length,) over blocks."""
    n = len(values) // length * length
    return np.asarray(values[:n].reshape(-1, length).mean(axis=1))


def residuals(f: Followed, vector: Array) -> dict[str, Array]:
    """Measured minus modelled after the lead: `p_a`, `p_b` in mbar (u -> p), `theta2` in deg (p -> theta)."""
    lead = round(LEAD_S / f.row_s)
    pressure = f.measured - answers(f, vector, "valves")
    angle = f.measured[:, 0] - answers(f, vector, "muscles")[:, 0]
    return {
        "p_a": 1e-2 * blocks(pressure[lead:, 1], P_BLOCK),
        "p_b": 1e-2 * blocks(pressure[lead:, 2], P_BLOCK),
        "theta2": np.asarray(deg(blocks(angle[lead:], ANGLE_BLOCK))),
    }


def floors(f: Followed) -> dict[str, float]:
    """Rms in the blocks of `residuals` of a healthy arm, mbar and deg: noise, and what it does to the submodels.

    The factors over white noise were measured on healthy arms of the exam's generator.
    """
    p_noise = 1e-2 * f.noise[1:] / np.sqrt(f.stride * P_BLOCK)
    angle = float(deg(f.noise[0])) / np.sqrt(f.stride * ANGLE_BLOCK)
    return {"p_a": 1.3 * float(p_noise[0]), "p_b": 1.3 * float(p_noise[1]), "theta2": 2.2 * angle}


def noise_rms(values: Array) -> float:
    """White noise's rms from third differences, in which a smooth signal vanishes; the median of blocks (Rice 1984)."""
    squares = blocks(np.diff(values, 3) ** 2, 50)
    return float(np.sqrt(np.median(squares) / 20.0))
