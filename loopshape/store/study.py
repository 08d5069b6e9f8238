"""Study files: which experiments to do to which rig.

    format = "loopshape-study/1"
    rig = "simulated"
    plant = "arm-1dof"
    rate_hz = 1000.0                           # default 1000
    seed = 1                                   # default 0; excitations without a seed of their own take it
    solver = "edges"                           # the plant's word for how it integrates
    operating_points = [{ theta2_deg = 0.0, p_ab_bar = 1.0 }]

    [parameters]                               # of the plant, where they are not its own
    [effects]                                  # of the plant's catalogue, by magnitude: joint_friction = 0.12
    [pwm]                                      # frequency_hz, dead_zone
    [[loop]]                                   # name and controller; other loops keep the plant's
    [[experiment]]
    name = "sweep"
    excites = "theta2"
    excitation = { kind = "sweep", f_low_hz = 0.5, f_high_hz = 30.0, duration_s = 60.0, amplitude_deg = 5.0 }

An experiment has an `excitation` (with `lead_s`, `tail_s`), `references` or `control` by loop, or only
`duration_s`; `study_signals` lists their keys. Its kind is the excitation's by default, its injection
"controller_input", "reference" or "control" after what it has.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from loopshape.controller import Block
from loopshape.errors import WrongUseError
from loopshape.excitation import Excitation
from loopshape.experiment import INJECTIONS, KINDS, ROLES
from loopshape.store.files import plain_name
from loopshape.store.run_tables import read_blocks
from loopshape.store.study_signals import read_excitation, read_setpoints
from loopshape.store.words import Words, read_words, refuse_doubles, said_in
from loopshape.study import ExperimentTemplate, Setpoint, Study

FORMAT = "loopshape-study/1"
_KEYS = (
    "format", "rig", "plant", "rate_hz", "seed", "solver", "operating_points", "parameters", "effects", "pwm",
    "loop", "experiment",
)  # fmt: skip
_EXPERIMENT_KEYS = (
    "name", "kind", "excites", "injection", "role", "lead_s", "tail_s", "duration_s", "operating_points",
    "excitation", "references", "control", "parameters",
)  # fmt: skip
Points = tuple[Mapping[str, float], ...]
Setpoints = Mapping[str, Setpoint]


def read_study(path: Path) -> Study:
    """The study in a file; amplitudes and setpoints come in stored units.

    `extra["units"]` says for each experiment the stored unit's suffix of what it has (`excitation`, and
    by loop `references` and `control`), so that a rig can refuse bar where it wants rad. Refuses another
    format, missing and unknown keys, and words and numbers that do not fit (`WrongUseError`).
    """
    words = read_words(path, FORMAT)
    words.only(*_KEYS)
    words.need("rig", "plant", "operating_points", "experiment")
    seed = words.whole("seed", 0)
    read = [_experiment(table, seed) for table in words.tables("experiment")]
    if not read:
        raise WrongUseError(f"{words.where}: no experiment", "an empty list", "write an [[experiment]]")
    refuse_doubles((template.name for template, _ in read), words.where, "experiments")
    return Study(
        rig=words.text("rig"),
        plant=words.text("plant"),
        experiments=tuple(template for template, _ in read),
        operating_points=_points(words) or (),
        rate_hz=words.positive("rate_hz", 1000.0),
        seed=seed,
        solver=words.text("solver", "edges"),
        changes=words.numbers("parameters"),
        effects=words.numbers("effects"),
        pwm=_pwm(words),
        controllers=_controllers(words),
        extra={"units": {template.name: units for template, units in read}},
    )


def _points(words: Words) -> Points | None:
    if "operating_points" not in words.table:
        return None
    points = tuple({name: t.number(name) for name in t.table} for t in words.tables("operating_points"))
    if not points:
        raise WrongUseError(f"{words.where}: no operating point", "an empty list", "write at least one table")
    return points


def _pwm(words: Words) -> dict[str, float]:
    words.inner("pwm").only("frequency_hz", "dead_zone")
    return words.numbers("pwm")


def _controllers(words: Words) -> dict[str, tuple[Block, ...]]:
    tables = words.tables("loop")
    for table in tables:
        table.only("name", "controller")
        table.need("name", "controller")
    refuse_doubles((table.text("name") for table in tables), words.where, "loops")
    return {table.text("name"): read_blocks(table) for table in tables}


def _experiment(words: Words, seed: int) -> tuple[ExperimentTemplate, dict[str, Any]]:
    """One experiment, and the stored units of its signals."""
    words.only(*_EXPERIMENT_KEYS)
    excitation, unit = _excitation(words, seed)
    references, reference_units = read_setpoints(words.inner("references"))
    control, control_units = read_setpoints(words.inner("control"))
    _check_whole(words, excitation, references, control)
    with said_in(words.where):
        name = plain_name(words.text("name"), "the name of an experiment")
    template = ExperimentTemplate(
        name=name,
        kind=words.one_of("kind", KINDS, _kind(excitation, references, control)),
        injection=words.one_of("injection", INJECTIONS, _injection(excitation, control)),
        excites=words.maybe_text("excites"),
        excitation=excitation,
        references=references,
        control=control,
        role=words.one_of("role", ROLES, "estimation"),
        lead_s=_from_zero(words, "lead_s"),
        tail_s=_from_zero(words, "tail_s"),
        duration_s=words.positive("duration_s") if "duration_s" in words.table else None,
        operating_points=_points(words),
        parameters=words.numbers("parameters"),
    )
    return template, {"excitation": unit, "references": reference_units, "control": control_units}


def _excitation(words: Words, seed: int) -> tuple[Excitation | None, str | None]:
    if "excitation" not in words.table:
        return None, None
    return read_excitation(words.inner("excitation"), seed)


def _from_zero(words: Words, key: str) -> float:
    value = words.number(key, 0.0)
    if value < 0.0:
        raise WrongUseError(f"{words.where}: {key} must not be negative", f"{value:g}")
    return value


def _check_whole(words: Words, excitation: Excitation | None, references: Setpoints, control: Setpoints) -> None:
    """Refuse an experiment whose length or loop is not said, or said twice."""
    if (excitation is None) != ("excites" not in words.table):
        raise WrongUseError(f"{words.where}: excites and excitation go together", "one of them", "give both or none")
    if (excitation is None) != ("duration_s" in words.table):
        raise WrongUseError(
            f"{words.where}: duration_s is for experiments without an excitation",
            "both" if excitation else "neither",
            "an excitation has its own length, with lead_s and tail_s around it",
        )
    if references and control:
        raise WrongUseError(f"{words.where}: references need closed loops and control opens them", "both", "choose one")


def _kind(excitation: Excitation | None, references: Setpoints, control: Setpoints) -> str:
    if excitation is not None:
        return excitation.kind
    if control:
        return "open_loop"
    return next((setpoint.kind for setpoint in references.values()), "none")


def _injection(excitation: Excitation | None, control: Setpoints) -> str:
    if control:
        return "control"
    return "reference" if excitation is None else "controller_input"
