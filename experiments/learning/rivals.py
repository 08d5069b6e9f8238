"""Everyone who may drive the arm, behind one face: trials in, traces out."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from feedback_rival import feedback
from nine_actions import Policy, Rules, Setpoint, Trace, pairs, play
from trial_outcomes import Summary, reached_s, summary, tracking_deg

from loopshape.data.control.controller import Controller
from loopshape.io.write.controllers import read_controllers
from loopshape.toolbox.arm.arm1 import Arm1

EXAMPLE = Path(__file__).parents[2] / "examples" / "arm"
Trials = list[tuple[float, float]]
#: (trials, duration in s, changes of the arm, moving setpoint or None) to what happened
Rival = Callable[[Trials, float, Mapping[str, float], Setpoint | None], list[Trace]]


def driven(rules: Rules, policy: Policy, seed: int) -> Rival:
    """Someone with nine actions."""
    return lambda trials, seconds, changes, moving: play(policy, rules, trials, seconds, seed, changes, moving)


def steered(rules: Rules, controllers: Sequence[Controller], seed: int) -> Rival:
    """Someone with two loops."""
    return lambda trials, seconds, changes, moving: feedback(controllers, rules, trials, seconds, seed, changes, moving)


def designed() -> dict[str, tuple[Controller, ...]]:
    """The controllers that the workbench tuned for the simulated arm, and the arm's defaults."""
    return {
        "feedback": read_controllers(EXAMPLE / "controller.toml"),
        "feedback, defaults": Arm1().default_controllers(1000.0),
    }


Counts = dict[tuple[float, float], int]


def try_on(
    rival: Rival, rules: Rules, final: Mapping[str, Any], changes: Mapping[str, float]
) -> tuple[Summary, Counts]:
    """The final trials on an arm with changes: their summary, and how many reach by (tolerance, hold)."""
    trials = pairs(rules, final["trials"], final["seed"])
    traces = rival(trials, rules.limit_s + rules.stay_s, changes, None)
    counts = {
        (tolerance, hold): sum(bool(np.isfinite(reached_s(t, rules.limit_s, tolerance, hold))) for t in traces)
        for tolerance in final["tolerances_deg"]
        for hold in final["holds_s"]
    }
    return summary(traces, rules), counts


def sine(settings: Mapping[str, Any], frequency_hz: float) -> Setpoint:
    """The moving setpoint in deg."""
    return lambda t: float(settings["amplitude_deg"] * np.sin(2.0 * np.pi * frequency_hz * t))


def follow(rival: Rival, settings: Mapping[str, Any], frequency_hz: float) -> Trace:
    """One run behind a sine, from rest at 0 deg."""
    return rival([(0.0, 0.0)], settings["duration_s"], {}, sine(settings, frequency_hz))[0]


def track(rival: Rival, settings: Mapping[str, Any], frequency_hz: float) -> tuple[float, float]:
    """Rms and largest error in deg behind a sine."""
    return tracking_deg(follow(rival, settings, frequency_hz), settings["skip_s"])
