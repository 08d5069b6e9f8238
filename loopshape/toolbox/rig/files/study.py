"""Study files: which experiments to do to which rig.

    format = "loopshape-study/1"
    rig = "simulated"
    plant = "servo-axis"
    rate_hz = 1000.0                           # default 1000
    seed = 1                                   # default 0; excitations without a seed of their own take it
    solver = "edges"                           # the plant's word for how it integrates
    operating_points = [{ x_mm = 0.0 }]

    [parameters]                               # of the plant, where they are not its own
    [effects]                                  # of the plant's catalogue, by magnitude: friction = 0.12
    [pwm]                                      # frequency_hz, dead_zone
    [[loop]]                                   # name, and controller or schedule (over, nodes), and decoupling; other
                                               # loops keep the plant's
    [[experiment]]
    name = "sweep"
    excites = "x"
    excitation = { kind = "sweep", f_low_hz = 0.5, f_high_hz = 30.0, duration_s = 60.0, amplitude_mm = 5.0 }

An experiment has an `excitation` (with `lead_s`, `tail_s`), `references` or `control` by loop, or only
`duration_s`; `study_signals` lists their keys. Its kind is the excitation's by default, its injection
"controller_input", "reference" or "control" after what it has.

    [[experiment]]
    name = "both"                              # recordings both-r1-s1, both-r1-s2, both-r2-s1, both-r2-s2
    realisations = 2                           # optional: multisines again with new phases
    excitations = { x = { kind = "multisine", ... }, y = { kind = "multisine", ... } }

`feedforward = { x = "next.csv" }` beside references is added at the plant's input, sample by sample
(`io.trials`, which `loopshape learning` writes); the file lies beside the study.

`excitations` stands for `excites` and `excitation` where several loops are excited at once: multisines become
orthogonal over as many recordings as loops, noises are added in one recording (`excitation_sets`). With rig = "target"
there are `[target]` and `[limits]` too (`study_target`).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from loopshape.core.errors import WrongUseError
from loopshape.data.control.controller import Block
from loopshape.data.control.scheduled import Scheduled
from loopshape.data.signal.experiment import INJECTIONS, KINDS, ROLES
from loopshape.io.config_table import ConfigTable, read_words, refuse_doubles, said_in
from loopshape.io.files import inside, plain_name
from loopshape.io.provenance import file_sha256
from loopshape.io.run.run_tables import SCHEDULE_KEYS, read_loops
from loopshape.io.schema import read
from loopshape.toolbox.learning.files import read_feedforward
from loopshape.toolbox.rig.excitation.excitation import Excitation
from loopshape.toolbox.rig.files.excitation_sets import together
from loopshape.toolbox.rig.files.signals import read_excitation, read_excitations, read_setpoints
from loopshape.toolbox.rig.files.target import read_escalation, read_limits, read_target
from loopshape.toolbox.rig.study import FORMAT, ExperimentTemplate, Setpoint, Study, expanded
from loopshape.toolbox.schedules.table import ScheduleTable

_KEYS = (
    "format", "rig", "plant", "rate_hz", "seed", "solver", "operating_points", "parameters", "effects", "pwm",
    "loop", "experiment", "target", "limits", "escalate",
)  # fmt: skip
_EXPERIMENT_KEYS = (
    "name", "kind", "excites", "injection", "role", "lead_s", "tail_s", "duration_s", "operating_points",
    "excitation", "excitations", "realisations", "references", "control", "feedforward", "parameters",
)  # fmt: skip
Points = tuple[Mapping[str, float], ...]
Setpoints = Mapping[str, Setpoint]


def read_study(path: Path) -> Study:
    """The study in a file; amplitudes and setpoints come in stored units.

    An experiment of several multisines at once, or of several realisations, comes as the experiments that it
    stands for (`study.expanded`). `extra["units"]` says for each experiment the stored unit's suffix of what it has
    (`excitation`, and by loop `excites_also`, `references` and `control`), so that a rig can refuse bar where it
    wants rad. Refuses another format, missing and unknown keys, and words and numbers that do not fit
    (`WrongUseError`).
    """
    words = read_words(path, FORMAT)
    words.only(*_KEYS)
    described = words.table.get("rig") == "target" and "plant" not in words.table
    words.need("rig", *(() if described else ("plant",)), "operating_points", "experiment")
    rate_hz = words.positive("rate_hz", 1000.0)
    seed, target = words.whole("seed", 0), read_target(words)
    read = [one for table in words.tables("experiment") for one in _experiments(table, seed, path.parent, rate_hz)]
    if not read:
        raise WrongUseError(f"{words.where}: no experiment", "an empty list", "write an [[experiment]]")
    refuse_doubles((template.name for template, _ in read), words.where, "experiments")
    return Study(
        rig=words.text("rig"),
        plant="" if described else words.text("plant"),
        experiments=tuple(template for template, _ in read),
        operating_points=_points(words) or (),
        rate_hz=rate_hz,
        seed=seed,
        solver=words.text("solver", "edges"),
        changes=words.numbers("parameters"),
        effects=words.numbers("effects"),
        pwm=_pwm(words),
        controllers={} if described else _controllers(words),
        schedules=_schedules(words, rate_hz),
        decoupling={t.text("name"): t.numbers("decoupling") for t in words.tables("loop") if "decoupling" in t.table},
        extra={
            "units": {t.name: u for t, u in read},
            "files": dict(p for _, u in read for p in u.get("files", {}).items()),
        },
        target=target,
        limits={} if target else read_limits(words),
        escalation=read_escalation(words),
        loops=read_loops(words, rate_hz) if described else (),
    )


def _points(words: ConfigTable) -> Points | None:
    if "operating_points" not in words.table:
        return None
    points = tuple({name: t.number(name) for name in t.table} for t in words.tables("operating_points"))
    if not points:
        raise WrongUseError(f"{words.where}: no operating point", "an empty list", "write at least one table")
    return points


def _pwm(words: ConfigTable) -> dict[str, float]:
    words.inner("pwm").only("frequency_hz", "dead_zone")
    return words.numbers("pwm")


def _controllers(words: ConfigTable) -> dict[str, tuple[Block, ...]]:
    tables = words.tables("loop")
    for table in tables:
        table.only("name", "controller", *SCHEDULE_KEYS, "decoupling")
        table.need("name")
        _refuse_both(table)
    refuse_doubles((table.text("name") for table in tables), words.where, "loops")
    return {t.text("name"): read(_Blocks, own, t.where).controller for t in tables if (own := _only_blocks(t))}


@dataclass(frozen=True)
class _Blocks:
    controller: tuple[Block, ...]


def _only_blocks(table: ConfigTable) -> dict[str, Any]:
    return {key: value for key, value in table.table.items() if key == "controller"}


def _refuse_both(table: ConfigTable) -> None:
    """A loop has a controller or a schedule; with a decoupling alone it keeps the plant's controller."""
    given = [key for key in ("controller", "nodes") if key in table.table]
    if not given and "decoupling" not in table.table:
        table.need("controller")
    if len(given) == 2:
        raise WrongUseError(f"{table.where}: a loop has a controller or a schedule", "both", "write one of them")


def _schedules(words: ConfigTable, rate_hz: float) -> dict[str, Scheduled]:
    keys = ("name", *SCHEDULE_KEYS)
    own = [(t, {key: t.table[key] for key in keys if key in t.table}) for t in words.tables("loop")]
    made: Any = {t.text("name"): read(ScheduleTable, x, t.where, rate_hz=rate_hz) for t, x in own if "nodes" in x}
    return dict(made)


def _experiments(
    words: ConfigTable, seed: int, folder: Path, rate_hz: float
) -> list[tuple[ExperimentTemplate, dict[str, Any]]]:
    """The experiments that one `[[experiment]]` stands for, each with the stored units of its signals."""
    template, units = _experiment(words, seed)
    if "feedforward" in words.table:
        template, units = _helped(words, template, units, folder, rate_hz)
    realisations = words.whole("realisations", 1) if "realisations" in words.table else None
    with said_in(words.where):
        return [(one, units) for one in expanded(template, realisations)]


def _experiment(words: ConfigTable, seed: int) -> tuple[ExperimentTemplate, dict[str, Any]]:
    """One experiment as it is written, and the stored units of its signals."""
    words.only(*_EXPERIMENT_KEYS)
    signals, signal_units = _excitations(words, seed)
    excites, excitation = next(iter(signals.items()), (None, None))
    references, reference_units = read_setpoints(words.inner("references"))
    control, control_units = read_setpoints(words.inner("control"))
    _check_whole(words, excitation, references, control)
    with said_in(words.where):
        name = plain_name(words.text("name"), "the name of an experiment")
    template = ExperimentTemplate(
        name=name,
        kind=words.one_of("kind", KINDS, _kind(excitation, references, control)),
        injection=words.one_of("injection", INJECTIONS, _injection(excitation, control)),
        excites=excites,
        excitation=excitation,
        references=references,
        control=control,
        role=words.one_of("role", ROLES, "estimation"),
        lead_s=_from_zero(words, "lead_s"),
        tail_s=_from_zero(words, "tail_s"),
        duration_s=words.positive("duration_s") if "duration_s" in words.table else None,
        operating_points=_points(words),
        parameters=words.numbers("parameters"),
        excites_also={loop: signal for loop, signal in signals.items() if loop != excites},
    )
    units: dict[str, Any] = {"excitation": signal_units.pop(excites, None) if excites else None}
    return template, units | {"excites_also": signal_units, "references": reference_units, "control": control_units}


def _helped(
    words: ConfigTable, template: ExperimentTemplate, units: dict[str, Any], folder: Path, rate_hz: float
) -> tuple[ExperimentTemplate, dict[str, Any]]:
    """The experiment with the feedforwards of files beside the study; refuses them with an excitation or open loops."""
    if template.excitation is not None or template.control or template.injection != "reference":
        raise WrongUseError(
            f"{words.where}: a feedforward goes with references alone", "an excitation, control or injection beside it",
            "leave that out: it enters at the plant's input",
        )  # fmt: skip
    named = words.inner("feedforward")
    files = {loop: inside(folder, named.text(loop), "the file of a feedforward") for loop in named.table}
    read = {loop: read_feedforward(file, rate_hz) for loop, file in files.items()}
    made = replace(template, injection="plant_input", feedforward={loop: one for loop, (one, _) in read.items()})
    digests = {file.name: file_sha256(file) for file in files.values()}
    return made, units | {"feedforward": {loop: unit for loop, (_, unit) in read.items()}, "files": digests}


def _excitations(words: ConfigTable, seed: int) -> tuple[dict[str, Excitation], dict[str, str]]:
    """Excitations by loop, and the suffix of each one's unit; empty where nothing is excited."""
    if "excitations" in words.table:
        if doubled := [key for key in ("excites", "excitation") if key in words.table]:
            raise WrongUseError(
                f"{words.where}: excitations already say which loops are excited and how",
                f"{' and '.join(doubled)} beside it",
                "give excites and excitation for one loop, or excitations for several",
            )
        signals, units = read_excitations(words.inner("excitations"), seed)
        with said_in(words.where):
            together(signals)  # refuses those that cannot be told apart, also a single one
        return signals, units
    if ("excitation" in words.table) != ("excites" in words.table):
        raise WrongUseError(f"{words.where}: excites and excitation go together", "one of them", "give both or none")
    if "excitation" not in words.table:
        return {}, {}
    made, unit = read_excitation(words.inner("excitation"), seed)
    loop = words.text("excites")
    return {loop: made}, {loop: unit}


def _from_zero(words: ConfigTable, key: str) -> float:
    value = words.number(key, 0.0)
    if value < 0.0:
        raise WrongUseError(f"{words.where}: {key} must not be negative", f"{value:g}")
    return value


def _check_whole(words: ConfigTable, excitation: Excitation | None, references: Setpoints, control: Setpoints) -> None:
    """Refuse an experiment whose length is not stated, or stated twice, or whose loops are closed and open."""
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
