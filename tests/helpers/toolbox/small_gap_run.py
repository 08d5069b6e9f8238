"""A small run of the arm with a payload, and a small catalogue, for the tests of `loopshape gap`."""

import sys
from collections.abc import Mapping
from dataclasses import replace

import pytest
from simulated_machines import FORMS, Arm1, ExperimentTemplate, header, measure
from study_signals import Multisine, Staircase, Sweep

import loopshape as ls
from loopshape.cli.main import run as command

MIDDLE, SIDE, OTHER = ({"theta2_deg": a, "p_ab_bar": p} for a, p in ((0.0, 1.0), (20.0, 1.0), (10.0, 1.2)))
KNOWN = ("payload", "joint_friction", "angle_sensor_lag")
PAYLOAD = {"payload_kg": 0.06}


def catalogue():
    """The first form of each effect of KNOWN."""
    return tuple(next(f for f in FORMS if f.effect == name) for name in KNOWN)


def _multisine(
    name: str, loop: str, amplitude: float, point: Mapping[str, float], high_hz: float
) -> ExperimentTemplate:
    signal = Multisine(0.25, high_hz, 8.0, amplitude, 1, 3, ramp_s=1.0, crest_iterations=5)
    return ExperimentTemplate(
        name, "multisine", "controller_input", loop, signal, lead_s=1.0, operating_points=(point,)
    )


def _steps(name: str, role: str, point: Mapping[str, float], size: float) -> ExperimentTemplate:
    stairs = {"theta2": Staircase((1.0, 4.0, 7.0), (size, -size, 0.0))}
    return ExperimentTemplate(
        name, "staircase", "reference", references=stairs, role=role, duration_s=9.0, operating_points=(point,)
    )


STUDY = ls.rig.Study(
    "simulated",
    "arm-1dof",
    (
        _multisine("r01", "theta2", 0.45, MIDDLE, 6.0),
        _multisine("r02", "theta2", 0.3, SIDE, 6.0),
        _multisine("r03", "p_ab", 0.3, MIDDLE, 2.0),
        _steps("r04", "estimation", MIDDLE, 0.25),
        replace(
            _multisine("r05", "theta2", 0.3, OTHER, 6.0), role="validation", kind="sweep",
            excitation=Sweep(0.4, 6.0, 8.0, 0.3),
        ),
        _steps("r06", "validation", MIDDLE, 0.15),
    ),
    (MIDDLE,),
    seed=5,
)  # fmt: skip


def recorded(effect: Mapping[str, float] = PAYLOAD) -> ls.Run:
    """The run of an arm with an effect that its run.toml does not tell."""
    plant = Arm1()
    return replace(header(STUDY, plant), recordings=tuple(measure(replace(STUDY, changes=effect), plant, threads=1)))


def loopshape(*words: object) -> int:
    """The command in this process; gives its exit code."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sys, "argv", ["loopshape", *map(str, words)])
        patch.setattr(Arm1, "effects", catalogue())
        with pytest.raises(SystemExit) as ended:
            command()
    return int(ended.value.code or 0)
