"""A study: what to do to which rig, as a person writes it; `rigs` turns it into experiments."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from loopshape.controller import Block
from loopshape.excitation import Excitation, Profile, Staircase

Setpoint = Staircase | Profile


@dataclass(frozen=True, eq=False)
class ExperimentTemplate:
    """One `[[experiment]]` of a study, to be done at each of its operating points.

    `references` moves setpoints by loop, `control` drives z by loop with the loops open; both in stored
    units. The excitation starts after `lead_s` at rest and is followed by `tail_s`; `duration_s` is the
    whole length where there is no excitation. `operating_points` None takes the study's;
    `parameters` are changes of the plant for this experiment, on top of the study's.
    """

    name: str
    kind: str
    injection: str
    excites: str | None = None
    excitation: Excitation | None = None
    references: Mapping[str, Setpoint] = field(default_factory=dict)
    control: Mapping[str, Setpoint] = field(default_factory=dict)
    role: str = "estimation"
    lead_s: float = 0.0
    tail_s: float = 0.0
    duration_s: float | None = None
    operating_points: tuple[Mapping[str, float], ...] | None = None
    parameters: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Study:
    """A whole study. `controllers` by loop name; a loop that it leaves out keeps the plant's default.

    `changes` moves parameters of the plant, as settings that whoever reads the recordings knows; `effects` are
    magnitudes by name (or NAME:FORM) of what its nominal model leaves out. `pwm` may hold frequency_hz and
    dead_zone; `solver` is the plant's word for how it integrates.
    """

    rig: str
    plant: str
    experiments: tuple[ExperimentTemplate, ...]
    operating_points: tuple[Mapping[str, float], ...]
    rate_hz: float = 1000.0
    seed: int = 0
    solver: str = "edges"
    changes: Mapping[str, float] = field(default_factory=dict)
    effects: Mapping[str, float] = field(default_factory=dict)
    pwm: Mapping[str, float] = field(default_factory=dict)
    controllers: Mapping[str, tuple[Block, ...]] = field(default_factory=dict)
    extra: Mapping[str, Any] = field(default_factory=dict)
