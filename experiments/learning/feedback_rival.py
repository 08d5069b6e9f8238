"""The feedback controller on the same trials: the package's simulated arm under two designed loops."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from nine_actions import Rules, Setpoint, Trace

from loopshape.core.units import Array, deg, rad
from loopshape.data.control.controller import Controller
from loopshape.data.signal.experiment import Experiment
from loopshape.data.signal.recording import Recording
from loopshape.toolbox.arm.arm1 import Arm1
from loopshape.toolbox.arm.dynamics.pwm import pulse_s
from loopshape.toolbox.arm.parameters import ARM1_PARAMETERS

RATE_HZ = 1000.0


def feedback(
    controllers: Sequence[Controller],
    rules: Rules,
    trials: list[tuple[float, float]],
    duration_s: float,
    seed: int,
    changes: Mapping[str, float] | None = None,
    moving: Setpoint | None = None,
) -> list[Trace]:
    """As `nine_actions.play`, with the loops closed: the setpoint steps at t = 0, or moves."""
    arm, n = Arm1(), round(duration_s * RATE_HZ) + 1
    loops = arm.loop_setups(controllers, "reference")
    t = np.arange(n) / RATE_HZ
    wanted = [np.array([moving(s) for s in t]) if moving else np.full(n, setpoint) for _, setpoint in trials]
    asked = [
        Experiment(
            f"trial-{k}", "staircase", loops, RATE_HZ, np.c_[rad(wanted[k]), np.full(n, rules.p_ab_bar)],
            np.zeros((n, 2)), "reference", {"theta2_deg": start, "p_ab_bar": rules.p_ab_bar}, seed=seed + k,
        )
        for k, (start, _) in enumerate(trials)
    ]  # fmt: skip
    recordings = arm.simulate(asked, changes=changes, threads=1)
    vector = ARM1_PARAMETERS.vector(dict(changes or {}))
    return [trace(r, w, n, vector) for r, w in zip(recordings, wanted, strict=True)]


def trace(recording: Recording, wanted: Array, samples: int, vector: Array) -> Trace:
    """The log of one trial."""
    theta2 = deg(recording.column("theta2_rad"))
    pressures = np.c_[recording.column("p_a_bar"), recording.column("p_b_bar")]
    edges = valve_edges(recording.column("u_a_v"), vector) + valve_edges(recording.column("u_b_v"), vector)
    return Trace(wanted[: theta2.size], theta2, pressures, edges, theta2.size < samples)


def valve_edges(command: Array, vector: Array) -> Array:
    """Openings and closings of one muscle's valves in each PWM period, put at its first tick."""
    hz, dead_zone = (float(vector[ARM1_PARAMETERS.index(k)]) for k in ("pwm_frequency_hz", "pwm_dead_zone"))
    ticks, edges, before = round(RATE_HZ / hz), np.zeros(command.size), 0.0
    for at in range(0, command.size, ticks):
        length = pulse_s(float(command[at]), 1.0 / hz, dead_zone)
        now = float(np.sign(command[at])) if length > 0.0 else 0.0
        edges[at] = abs(now - before)
        before = now if length >= 1.0 / hz else 0.0
        edges[at] += abs(now - before)
    return edges
