"""Steps and a tracked profile of simulated arms, and the step that the printed plant and controller would make."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from arm1_sweeps import Arm
from scipy.signal import cont2discrete
from source_controllers import angle_controller

from loopshape.core.units import Array, deg, rad
from loopshape.data.control.controller import Controller
from loopshape.data.response.model import TransferFunction
from loopshape.data.result.step import Indicators
from loopshape.data.signal.recording import Recording
from loopshape.data.signal.run import Run
from loopshape.loop.predict.indicators import indicators
from loopshape.toolbox.arm.arm1 import Arm1
from loopshape.toolbox.arm.dynamics.equilibrium import rest
from loopshape.toolbox.arm.dynamics.model import derivatives
from loopshape.toolbox.arm.parameters import ARM1_PARAMETERS, P_IN, constants
from loopshape.toolbox.arm.source import value
from loopshape.toolbox.rig.effects import moves
from loopshape.toolbox.rig.simulated import header, measure, plan
from loopshape.toolbox.rig.study import Study
from loopshape.toolbox.validation.nouns import StepComparison
from loopshape.toolbox.validation.remeasured import recorded_steps, tracking

P_AB = "p_a_bar + p_b_bar"


@dataclass(frozen=True, eq=False)
class Moved:
    """One arm under its controllers: steps and profile."""

    arm: Arm
    controllers: str
    run: Run
    steps: Recording
    profile: Recording

    def step(self, loop: str, k: int) -> StepComparison:
        """The k-th step of a loop's setpoint."""
        return recorded_steps(self.steps, self.run.loop(loop))[k]

    @property
    def whole(self) -> bool:
        """Whether it stayed in the model's range to the end."""
        return not (self.steps.info.ended_early or self.profile.info.ended_early)


def moved(study: Study, arm: Arm, words: str, controllers: Sequence[Controller]) -> Moved:
    """Do the steps and the profile."""
    own = arm.of(replace(study, controllers={c.loop: c.blocks for c in controllers}))
    plant, wanted = Arm1(), {"steps", "profile"}
    done = frozenset(p.name for p in plan(own, plant) if p.name not in wanted)
    steps, profile = measure(own, plant, done=done, threads=1)
    return Moved(arm, words, header(own, plant), steps, profile)


def between(recording: Recording, expression: str, start_s: float, end_s: float) -> Array:
    """A column, or a sum of columns, over a stretch."""
    rows = slice(round(start_s * recording.rate_hz), round(end_s * recording.rate_hz))
    return recording.output(expression)[rows]


@dataclass(frozen=True)
class Crossing:
    """How much each output moves while the other one's setpoint steps, and where an infeasible setpoint ends."""

    angle_by_pressure_deg: float
    pressure_by_angle_bar: float
    end_deg: float
    end_bar: float

    @classmethod
    def of(cls, m: Moved, times_s: Mapping[str, Sequence[float]]) -> Crossing:
        """From the steps; `times_s` are those of both setpoints' jumps."""
        up, back, last = times_s["p_ab"][0], times_s["p_ab"][1], times_s["theta2"][-1]
        first, second = times_s["theta2"][0], times_s["theta2"][1]
        still, then = (between(m.steps, "theta2_rad", *span) for span in ((up - 1.0, up), (up, back)))
        angle = _largest(deg(still), deg(then))
        pressure = _largest(between(m.steps, P_AB, first - 0.5, first), between(m.steps, P_AB, first, second))
        end = m.steps.column("t_s")[-1]
        at = max(last, float(end) - 1.0)
        return cls(
            angle,
            pressure,
            float(deg(between(m.steps, "theta2_rad", at, end).mean())),
            float(between(m.steps, P_AB, at, end).mean()),
        )


def _largest(before: Array, after: Array) -> float:
    return float(np.abs(after - before.mean()).max())


@dataclass(frozen=True)
class Followed:
    """A tracked profile: delay in s, overshoot in deg at the ends of its moves, errors, and p_AB's range."""

    delay_s: float
    overshoots_deg: tuple[float, ...]
    largest_error_deg: float
    rms_error_deg: float
    lowest_bar: float
    highest_bar: float

    @classmethod
    def of(cls, m: Moved, longest_s: float) -> Followed:
        """From the profile; delays up to `longest_s` are tried."""
        r, y = (deg(m.profile.column(c)) for c in ("r_theta2_rad", "theta2_rad"))
        t = tracking(m.profile, m.run.loop("theta2"))
        p = m.profile.output(P_AB)
        errors = float(deg(t.largest_error)), float(deg(t.rms_error))
        return cls(best_delay_s(r, y, m.profile.rate_hz, longest_s), overshoots(r, y), *errors, float(p.min()),
                   float(p.max()))  # fmt: skip


def best_delay_s(r: Array, y: Array, rate_hz: float, longest_s: float) -> float:
    """Delay of the reference that leaves the least squares."""
    tried = np.arange(round(longest_s * rate_hz))
    left = [float(np.mean((y[k:] - r[: r.size - k]) ** 2)) for k in tried]
    return float(tried[int(np.argmin(left))]) / rate_hz


def overshoots(r: Array, y: Array) -> tuple[float, ...]:
    """How far y goes beyond each place where r comes to rest, in the direction that r came from, until it moves on."""
    still = np.diff(r) == 0.0
    stops = np.flatnonzero(~still[:-1] & still[1:]) + 1
    starts = np.append(np.flatnonzero(still[:-1] & ~still[1:]) + 1, r.size - 1)
    out = []
    for stop in stops:
        until = int(starts[starts > stop][0])
        came = np.sign(r[stop] - r[int(starts[starts < stop][-1])])
        out.append(float(np.max(came * (y[stop:until] - r[stop]), initial=0.0)))
    return tuple(out)


def printed_step(plant: TransferFunction, most_v: float | None, size_deg: float, seconds: float) -> tuple[Array, Array]:
    """Step of the angle by table 5.1 on a printed plant, with |z| at most `most_v`: time (n,), angle in deg (n,).

    Sample by sample at the controller's rate, plant behind a hold, pressures and PWM left out.
    """
    controller = angle_controller()
    A, B, C, _, _ = cont2discrete(_state_space(plant), 1.0 / controller.rate_hz)
    sections, n = controller.biquads(), round(seconds * controller.rate_hz)
    x, memory, out = np.zeros((A.shape[0], 1)), np.zeros((len(sections), 2)), np.empty(n)
    r = float(rad(size_deg))
    for k in range(n):
        out[k] = float((C @ x)[0, 0])
        z = _through(sections, memory, r - out[k])
        x = A @ x + B * (z if most_v is None else float(np.clip(z, -most_v, most_v)))
    return np.arange(n) / controller.rate_hz, np.asarray(deg(out))


def _state_space(plant: TransferFunction) -> tuple[Array, Array, Array, Array]:
    """Companion form of kappa/(s3 + a s2 + b s)."""
    _, a, b, _ = plant.den
    A = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [0.0, -b, -a]])
    return A, np.array([[0.0], [0.0], [plant.num[0]]]), np.array([[1.0, 0.0, 0.0]]), np.zeros((1, 1))


def _through(sections: Array, memory: Array, u: float) -> float:
    """One sample through a cascade of biquads (transposed direct form), changing `memory` in place."""
    for row, s in zip(sections, memory, strict=True):
        b0, b1, b2, a1, a2 = row
        y = b0 * u + s[0]
        s[0] = b1 * u - a1 * y + s[1]
        s[1] = b2 * u - a2 * y
        u = float(y)
    return u


def read_off(time_s: Array, angle_deg: Array, size_deg: float) -> Indicators:
    """Indicators of a computed step."""
    return indicators(time_s, angle_deg / size_deg)


def fastest_rise_s(gain_per_v: float, size: float) -> float:
    """Least time from 10 to 90 % of a step at a rate of `gain_per_v` under the PWM's largest command, 1 V."""
    return 0.8 * size / gain_per_v


def pressure_rates(arm: Arm, point: tuple[float, float] = (0.0, 1.0)) -> tuple[float, float]:
    """Rise and fall of p_AB in bar/s with both in-valves, or both out-valves, wide open at an equilibrium."""
    c = constants(ARM1_PARAMETERS.vector({**moves(Arm1(), arm.effects), **arm.changes}))
    x = rest(c, *point, float(c[P_IN]))
    shut = (False, False)
    up, down = (derivatives(c, tuple(x[:5]), valves) for valves in ((True, True, *shut), (*shut, True, True)))
    return 1e-5 * float(up[1] + up[2]), -1e-5 * float(down[1] + down[2])


def stiffness_line_deg_s(place: str) -> float:
    """deg/s per V of a printed plant below its resonance, kappa/w^2."""
    w = 2.0 * np.pi * value(f"{place}.f")
    return float(deg(value(f"{place}.kappa") / w**2))


def cells(x: Indicators, size: float, unit: float = 1.0) -> list[Any]:
    """Rise, settling to 2 and 5 %, overshoot and remaining error in the step's own unit, and the outcome."""
    times = [f"{t:.2f}" for t in (x.rise_time_s, x.settling_time_s, x.settling_time_5_s)]
    own = abs(size) * unit
    return [*times, f"{x.overshoot * own:.3g}", f"{x.steady_state_error * own:.2g}", x.outcome]
