"""From a first short recording the experiment that reaches a wanted accuracy at the crossover, and its study."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

from loopshape.core.errors import LoopshapeError, WrongUseError, refuse_unknown_keys
from loopshape.data.control.controller import Controller
from loopshape.data.requirement.requirements import Requirements
from loopshape.data.signal.channel import Channel
from loopshape.data.signal.recording import Recording
from loopshape.data.signal.run import Run
from loopshape.identify.frequency_response import excited_recordings
from loopshape.io.files import make_folder, write_text_whole, write_toml
from loopshape.io.write.check_files import controller_of
from loopshape.toolbox.planning.plan import plan as plan_from
from loopshape.toolbox.planning.plan_nouns import Plan, Required
from loopshape.toolbox.planning.plan_record import first_record
from loopshape.toolbox.rig import registry
from loopshape.toolbox.rig.files.excitation_sets import realised
from loopshape.toolbox.rig.simulated import plan as doable
from loopshape.toolbox.rig.steps.enough import Look, Until, look, until_of
from loopshape.toolbox.rig.study import ExperimentTemplate, Study
from loopshape.verbs.files import read


def plan(
    run: Run | str | Path,
    recording: str | None = None,
    *,
    std: float | None = None,
    controllers: Controller | Sequence[Controller] = (),
    **limits: Any,
) -> Plan:
    """The multisine that reaches the relative deviation `std` of |G| at the crossover (0.01 is 1 %, 0.09 dB, 0.6 deg).

    It is planned from one short recording of a run (`recording`, where it has several), whose noise and distortion it
    knows. The crossover is that of the run's own controller, of the loop's among `controllers`, or `at_hz`. `limits`
    are max_amplitude, max_input, max_output (stored units), longest_s, f_low_hz, f_high_hz, kind ("odd", "log", "all").
    Without `std` the experiment is told: `resolution_hz`, `seconds` and the band, as an undecided verdict orders them.
    `reached` tells whether they allow it, `satisfied` that the recording has it already; `ls.planning.write_plan`
    writes the study. Raises WrongUseError for a recording that excites no loop and for limits that noise alone breaks.

    Examples
    --------
    >>> import numpy as np, loopshape as ls
    >>> n, v = np.random.default_rng(1).standard_normal((2, 20_000))
    >>> y = 0.0 * n
    >>> for k in range(1, n.size):
    ...     y[k] = 0.99 * y[k - 1] + 0.02 * (n[k - 1] - y[k - 1])
    >>> run = ls.Run.from_arrays(u=n - y, y=y + 0.001 * v, excitation=n, rate_hz=1000.0)
    >>> found = ls.planning.plan(run, std=0.01, at_hz=5.0)
    >>> bool(found.reached or found.satisfied)
    True
    """
    refuse_unknown_keys("a plan has no such limit", limits, [f.name for f in fields(Required) if f.name != "std"])
    whole = run if isinstance(run, Run) else read(run)
    chosen = _first(whole, recording)
    loop = whole.loop(str(chosen.info.excites))
    own = (controllers,) if isinstance(controllers, Controller) else tuple(controllers)
    return plan_from(
        first_record(chosen, loop), Required(std, **limits), controller_of(own, loop.name) if own else None
    )


def enough(
    run: Run | str | Path,
    until: Until | float | Sequence[Requirements],
    recording: str | None = None,
    *,
    controllers: Controller | Sequence[Controller] = (),
) -> Look:
    """Whether a recording of a run is long enough, and about how much longer it should be.

    `until` is a std of S in every octave (of |S| where that is above 1), requirements whose verdict is to be decided,
    of the loop's own controller or that of `controllers`, or `Until`. `state` is "more", "accurate" or "decided",
    `more_s` the time that is missing if the estimates stay (None: not known), `bands` the accuracy by octaves. Looking
    once at a finished recording needs no wider intervals; `measure --until`, which looks often, has them. Raises
    BadSignalError for a recording from which nothing follows, with how many samples it should have.

    Examples
    --------
    >>> import numpy as np, loopshape as ls
    >>> n, v = np.random.default_rng(1).standard_normal((2, 20_000))
    >>> y = 0.0 * n
    >>> for k in range(1, n.size):
    ...     y[k] = 0.99 * y[k - 1] + 0.02 * (n[k - 1] - y[k - 1])
    >>> run = ls.Run.from_arrays(u=n - y, y=y + 0.001 * v, excitation=n, rate_hz=1000.0)
    >>> str(ls.planning.enough(run, 0.05).state)
    'accurate'
    """
    whole = run if isinstance(run, Run) else read(run)
    chosen = _first(whole, recording)
    loop = whole.loop(str(chosen.info.excites))
    given = (controllers,) if isinstance(controllers, Controller) else tuple(controllers)
    wanted = until_of(until)
    assert wanted is not None
    return look(
        chosen, loop, replace(wanted, controllers={c.loop: c for c in given} | dict(wanted.controllers)), strict=True
    )


def _first(run: Run, name: str | None) -> Recording:
    """The recording to plan from; refuses a run with several where none is named, and one that excites no loop."""
    if name is None:
        found = excited_recordings(run)
        if len(found) > 1:
            names = ", ".join(r.info.name for r in found[:8]) + (", ..." if len(found) > 8 else "")
            raise WrongUseError(
                "the run has several recordings to plan from",
                names,
                "name one: --recording NAME, in Python recording=NAME",
            )
        return found[0]
    chosen = run.recording(name)
    if chosen.info.excites is None:
        raise WrongUseError(
            f"recording {name} excites no loop", chosen.info.kind, "plan from one that does, or say so in run.toml"
        )
    return chosen


def write_plan(run: Run, plan: Plan, path: str | Path) -> tuple[Path, bool, str]:
    """Write the study of a plan (TOML), or the signal alone (CSV) where no rig is known that could do it.

    Gives the path, whether it is a study, and why not. `run` is what it was planned from.
    """
    file = Path(path)
    make_folder(file.parent)
    try:
        study = study_of(run, plan)
    except LoopshapeError as error:
        csv = file.with_suffix(".csv")
        write_text_whole(csv, signal_csv(run, plan))
        return csv, False, f"the signal alone is written, no study can drive this rig ({error.what})"
    table = study.to_table()
    table["effects"] = dict(study.effects) or None
    table["experiment"][0]["realisations"] = plan.realisations if plan.realisations > 1 else None
    table["experiment"][0]["parameters"] = dict(run.recording(plan.recording).info.parameters) or None
    write_toml(file, table)
    return file, True, ""


def study_of(run: Run, plan: Plan) -> Study:
    """The study that does the plan on the run's rig, where the first recording stood; refuses a rig that cannot."""
    if run.plant is None:
        raise WrongUseError("run.toml names no plant", "no key plant", "name one, or play the signal")
    plant, info = registry.plant(run.plant), run.recording(plan.recording).info
    template = ExperimentTemplate(
        f"plan-{plan.loop}".replace("_", "-"),
        "multisine",
        plan.injection,
        plan.loop,
        plan.excitation,
        operating_points=(dict(info.operating_point),),
        parameters=dict(info.parameters),
    )
    unit = Channel.from_column(plan.column).unit
    study = Study(
        rig="simulated",
        plant=plant.name,
        experiments=(template,),
        operating_points=(dict(info.operating_point),),
        rate_hz=run.rate_hz,
        seed=plan.required.seed,
        solver=plant.solvers[0],
        changes=dict(run.extra.get("parameters", {})),
        effects=dict(run.extra.get("effects", {})),  # the rig keeps them; nothing that is planned reads them
        pwm={k: float(run.pwm[k]) for k in ("frequency_hz", "dead_zone") if k in run.pwm},
        controllers={loop.name: loop.controller.blocks for loop in run.loops if loop.controller is not None},
        extra={"units": {template.name: {"excitation": unit, "references": {}, "control": {}}}},
    )
    doable(study, plant)
    return study


def signal_csv(run: Run, plan: Plan) -> str:
    """The signal as a table: time from its start, and what is added where it is injected, a column a realisation."""
    place, count = plan.column, plan.realisations
    made = [realised({plan.loop: plan.excitation}, k)[plan.loop].signal(run.rate_hz) for k in range(count)]
    heads = [place] if count == 1 else [f"r{k + 1}_{place}" for k in range(count)]
    rows = (
        ",".join([f"{k / run.rate_hz:.9g}", *(f"{value:.9g}" for value in values)])
        for k, values in enumerate(zip(*(x.tolist() for x in made), strict=True))
    )
    return "\n".join([",".join(["t_s", *heads]), *rows]) + "\n"
