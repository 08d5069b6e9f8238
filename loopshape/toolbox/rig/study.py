"""A study: what to do to which rig, as a person writes it; `rigs` turns it into experiments."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from typing import Any

from loopshape.core.errors import WrongUseError
from loopshape.data.control.controller import Block
from loopshape.data.control.scheduled import Scheduled
from loopshape.data.signal.experiment import ExperimentSettings, LoopSetup
from loopshape.toolbox.diagrams.wired import Wired
from loopshape.toolbox.rig.excitation.excitation import Excitation
from loopshape.toolbox.rig.excitation.setpoints import Profile, Sampled, Staircase
from loopshape.toolbox.rig.files.excitation_sets import MOST_REALISATIONS, realised, together
from loopshape.toolbox.rig.settings import Limit, TargetSettings
from loopshape.toolbox.rig.steps.escalation import Escalation

FORMAT = "loopshape-study/1"
Setpoint = Staircase | Profile


@dataclass(frozen=True, eq=False)
class ExperimentTemplate(ExperimentSettings):
    """One `[[experiment]]` of a study, to be done at each of its operating points.

    `references` moves setpoints by loop, `control` drives z by loop with the loops open; both in stored units.
    `feedforward` is added at the plant's input, by loop. The excitation starts after `lead_s` at rest and is followed
    by `tail_s`; `duration_s` is the whole length where there is no excitation. `excites_also` are excitations of
    further loops at once with that of `excites`, in the unit of the place they enter; `expanded` makes them orthogonal
    over several templates.
    `operating_points` None takes the study's; `parameters` come on top of the study's. Refuses `excites_also` without
    `excites` and `excitation`, or with the loop of `excites`.
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
    excites_also: Mapping[str, Excitation] = field(default_factory=dict)
    feedforward: Mapping[str, Sampled] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if self.excites_also and (self.excites is None or self.excitation is None):
            raise WrongUseError(
                f"experiment {self.name!r} excites further loops and no first one",
                ", ".join(self.excites_also),
                "give excites and excitation too",
            )
        if self.excites in self.excites_also:
            raise WrongUseError(f"experiment {self.name!r} excites a loop twice", repr(self.excites), "name it once")

    @property
    def excited(self) -> dict[str, Excitation]:
        """All that it injects, by loop, `excites` first; empty without an excitation."""
        if self.excites is None or self.excitation is None:
            return {}
        return {self.excites: self.excitation, **self.excites_also}


def expanded(template: ExperimentTemplate, realisations: int | None = None) -> tuple[ExperimentTemplate, ...]:
    """The templates that one stands for, each a recording per operating point.

    `realisations` repeats it with new phases, under the names NAME-r1, NAME-r2, ...; several multisines at
    once become as many templates as loops, NAME-s1, NAME-s2, ... (NAME-r1-s1, ...), orthogonal over them; several
    noises stay one. Refuses what `excitation_sets` refuses, and a number of realisations below 1 or above 1000.
    """
    if realisations is None:
        return _told_apart(template)
    if not 1 <= realisations <= MOST_REALISATIONS:
        raise WrongUseError(
            f"realisations of an experiment are 1 to {MOST_REALISATIONS}", f"{realisations}", "leave it out for one"
        )
    made = (
        _with_signals(template, f"{template.name}-r{k + 1}", realised(template.excited, k)) for k in range(realisations)
    )
    return tuple(one for each in made for one in _told_apart(each))


def _told_apart(template: ExperimentTemplate) -> tuple[ExperimentTemplate, ...]:
    if not template.excites_also:
        return (template,)
    sets = together(template.excited)
    if len(sets) == 1:
        return (template,)
    return tuple(_with_signals(template, f"{template.name}-s{k + 1}", one) for k, one in enumerate(sets))


def _with_signals(template: ExperimentTemplate, name: str, signals: Mapping[str, Excitation]) -> ExperimentTemplate:
    (_, first), *others = signals.items()
    return replace(template, name=name, excitation=first, excites_also=dict(others))


def merged_effects(own: Mapping[str, float], more: Mapping[str, float]) -> dict[str, float]:
    """A study's effects with others: one that both name, in whatever form, is the other's."""
    named = {key.partition(":")[0] for key in more}
    return {key: value for key, value in own.items() if key.partition(":")[0] not in named} | dict(more)


@dataclass(frozen=True, eq=False)
class Study:
    """A whole study. `controllers` by loop name; a loop that it leaves out keeps the plant's default.

    `schedules` stand in place of controllers, and `decoupling` are the weights of all controllers in what enters the
    plant, both by loop. `changes` moves parameters of the plant, as settings that whoever reads the recordings knows;
    `effects` are magnitudes by name (or NAME:FORM) of what its nominal model leaves out. `pwm` may hold frequency_hz
    and dead_zone; `solver` is the plant's word for how it integrates. `target` is for a rig behind a real-time target,
    and `loops` where no plant describes them (`plant` is empty then). `limits` end a simulation's recording where they
    are passed; a target has its own. `escalation` says how `measure --escalate` raises the amplitude.
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
    schedules: Mapping[str, Scheduled] = field(default_factory=dict)
    decoupling: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    extra: Mapping[str, Any] = field(default_factory=dict)
    target: TargetSettings | None = None
    limits: Mapping[str, Limit] = field(default_factory=dict)
    escalation: Escalation | None = None
    loops: tuple[LoopSetup, ...] = ()
    diagram: Wired | None = None

    def to_table(self) -> dict[str, Any]:
        """The study as the TOML file that `loopshape measure` reads, signals in stored units (`extra["units"]`)."""
        units = self.extra["units"]
        return {
            "format": FORMAT,
            "rig": self.rig,
            "plant": self.plant,
            "rate_hz": self.rate_hz,
            "seed": self.seed,
            "solver": self.solver,
            "operating_points": [dict(p) for p in self.operating_points],
            "parameters": dict(self.changes) or None,
            "pwm": dict(self.pwm) or None,
            "loop": [
                {"name": name, "controller": [block.to_table() for block in blocks]}
                for name, blocks in self.controllers.items()
            ],
            "experiment": [_experiment_table(t, units[t.name]) for t in self.experiments],
        }


def _experiment_table(t: ExperimentTemplate, units: Mapping[str, Any]) -> dict[str, Any]:
    """One experiment; keys that have their default are left out."""
    signal = None
    if t.excitation is not None:
        given = asdict(t.excitation)  # type: ignore[call-overload]
        unit = units["excitation"]
        signal = {"kind": given.pop("kind"), f"amplitude_{unit}": given.pop("amplitude"), **given}
    return {
        "name": t.name,
        "excites": t.excites,
        "injection": t.injection,
        "role": t.role,
        "lead_s": t.lead_s or None,
        "tail_s": t.tail_s or None,
        "duration_s": t.duration_s,
        "operating_points": None if t.operating_points is None else [dict(p) for p in t.operating_points],
        "excitation": signal,
        "references": _setpoints(t.references, units["references"]) or None,
        "control": _setpoints(t.control, units["control"]) or None,
    }


def _setpoints(signals: Mapping[str, Setpoint], units: Mapping[str, str]) -> dict[str, Any]:
    """Staircases by loop."""
    return {
        loop: {"kind": s.kind, "times_s": list(s.times_s), f"values_{units[loop]}": list(s.values)}
        for loop, s in signals.items()
    }
