"""Steps of figures 5.11 and 5.12: indicators of table 5.7, and what the other outputs do meanwhile."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from loopshape.core.units import Array, deg
from loopshape.data.control.controller import Controller
from loopshape.data.signal.experiment import LoopSetup
from loopshape.data.signal.recording import Recording
from loopshape.toolbox.arm.arm2 import Arm2
from loopshape.toolbox.rig.files.study import read_study
from loopshape.toolbox.rig.simulated import measure
from loopshape.toolbox.validation.remeasured import recorded_steps

STEPS = (
    "experiment", "loop", "at_s", "size", "unit", "rise_time_s", "settling_time_s", "settling_time_5_s", "overshoot",
    "steady_state_error", "outcome", "notes",
)  # fmt: skip
INTERACTION = ("experiment", "stepped", "at_s", "moved", "largest_move", "unit")
SETTLES_S = 8.0  # after a step its effect on other outputs is looked at this long


def stepped(study_file: Path, controllers: Mapping[str, Controller]) -> list[Recording]:
    """Both experiments under these controllers, the plant's own where there is none."""
    study = read_study(study_file)
    given = {loop: one.blocks for loop, one in controllers.items()}
    return list(measure(replace(study, controllers=given), Arm2(), threads=1))


def setups() -> tuple[LoopSetup, ...]:
    """The plant's loops with their columns."""
    plant = Arm2()
    return plant.loop_setups(plant.default_controllers(1000.0), "reference")


def in_people_s(loop: LoopSetup) -> tuple[float, str]:
    """Factor from the stored unit to deg or bar, and its name."""
    return (float(deg(1.0)), "deg") if loop.output_unit == "rad" else (1.0, "bar")


def step_rows(runs: Sequence[Recording]) -> list[list]:
    """A line a step; sizes, overshoot and error in deg or bar."""
    rows = []
    for recording in runs:
        for loop in setups():
            scale, unit = in_people_s(loop)
            for one in recorded_steps(recording, loop):
                m, size = one.measured, one.size * scale
                times = [f"{t:.2f}" for t in (m.rise_time_s, m.settling_time_s, m.settling_time_5_s)]
                rows.append([recording.info.name, loop.name, one.at_s, f"{size:.3g}", unit, *times])
                rows[-1] += [f"{m.overshoot * abs(size) * (1.0 - m.steady_state_error):.3g}"]
                rows[-1] += [f"{m.steady_state_error * size:.3f}", m.outcome, "; ".join(one.notes)]
    return rows


def interaction_rows(runs: Sequence[Recording]) -> list[list]:
    """A line a step and other output: how far it moves from where it stood, within `SETTLES_S`."""
    rows = []
    for recording in runs:
        for loop in setups():
            for one in recorded_steps(recording, loop):
                for other in setups():
                    if other.name != loop.name:
                        scale, unit = in_people_s(other)
                        moved = scale * largest_move(recording, other, one.at_s)
                        rows.append([recording.info.name, loop.name, one.at_s, other.name, f"{moved:.3g}", unit])
    return rows


def largest_move(recording: Recording, loop: LoopSetup, at_s: float) -> float:
    """Largest distance of an output from its mean in the second before, smoothed over 20 ms."""
    y, rate = smooth(recording.output(loop.output)), recording.rate_hz
    at = round(at_s * rate)
    before = float(np.mean(y[at - round(rate) : at]))
    return float(np.abs(y[at : at + round(SETTLES_S * rate)] - before).max())


def smooth(y: Array, samples: int = 20) -> Array:
    """Moving mean, which takes the sensor's noise off a peak."""
    return np.asarray(np.convolve(y, np.full(samples, 1.0 / samples), mode="same"))
