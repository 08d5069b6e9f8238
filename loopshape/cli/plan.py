"""`loopshape plan`: from a first short recording, the experiment that reaches a wanted accuracy at the crossover."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from loopshape.cli.output import AsJson, Output, Quiet, RunFolder
from loopshape.cli.pictures import figures_of
from loopshape.core.json_ready import named

if TYPE_CHECKING:
    from loopshape.data.controller import Controller
    from loopshape.data.recording import Recording
    from loopshape.data.run import Run
    from loopshape.data.study import Study
    from loopshape.identify.plan_nouns import Plan

#: lines of the table that are shown, the crossover's among them
SHOWN = 12
_LIMIT = "in the unit of its column (rad, V, ...)"


def plan(
    run: RunFolder,
    recording: Annotated[str | None, typer.Option(help="The first recording, where the run has several.")] = None,
    std_db: Annotated[float | None, typer.Option(help="Wanted std of |G| at the crossover in dB.")] = None,
    std_percent: Annotated[float | None, typer.Option(help="The same in percent.")] = None,
    std_deg: Annotated[float | None, typer.Option(help="The same of the phase, in degrees.")] = None,
    at: Annotated[float | None, typer.Option(help="Where it is wanted in Hz; default: the crossover.")] = None,
    controller: Annotated[
        Path | None, typer.Option(help="A controller file for the crossover; default: the run's own.")
    ] = None,
    max_amplitude: Annotated[
        float | None, typer.Option(help=f"Largest injected peak, {_LIMIT}; default: that of the recording.")
    ] = None,
    max_input: Annotated[float | None, typer.Option(help=f"Largest plant input with its rest, {_LIMIT}.")] = None,
    max_output: Annotated[float | None, typer.Option(help=f"Largest excursion of the output, {_LIMIT}.")] = None,
    longest_s: Annotated[float, typer.Option(help="Longest experiment in s.")] = 600.0,
    from_hz: Annotated[
        float | None, typer.Option(help="Lowest frequency; default: known, a decade below at most.")
    ] = None,
    to_hz: Annotated[
        float | None, typer.Option(help="Highest frequency; default: known, a decade above at most.")
    ] = None,
    lines: Annotated[str, typer.Option(help="odd (shows distortion), log, or all.")] = "odd",
    out: Annotated[Path | None, typer.Option(help="The study to write; default: plan_LOOP.toml in the run.")] = None,
    as_json: AsJson = False,
    quiet: Quiet = False,
) -> None:
    """Plan a multisine that reaches a wanted accuracy at the crossover; exit code 1 where it is out of reach.

    Where the first recording has that accuracy already nothing is proposed.
    """
    from loopshape.cli.pictures import save
    from loopshape.identify.plan import plan as planned
    from loopshape.identify.plan_nouns import Wish
    from loopshape.identify.plan_record import first_record
    from loopshape.io.run_folder import read_run
    from loopshape.view.plan import plan_page

    output = Output(as_json, quiet)
    wish = Wish(
        std=_std(std_db, std_percent, std_deg),
        at_hz=at,
        max_amplitude=max_amplitude,
        max_input=max_input,
        max_output=max_output,
        longest_s=longest_s,
        f_low_hz=from_hz,
        f_high_hz=to_hz,
        kind=lines,
    )
    held = read_run(run)
    chosen = _first(held, recording)
    loop = held.loop(str(chosen.info.excites))
    with output.progress("plan", 2) as step:
        first = first_record(chosen, loop)
        step(chosen.info.name)
        found = planned(first, wish, _controller(controller, loop.name))
    if found.met:
        output.say(found.sentence)
        output.json(answer(found) | {"run": str(run), "study": None, "complete": False, "figure": None})
        return
    study, written, why = _write(held, chosen, found, out or run / f"plan_{loop.name}.toml")
    figure = save(plan_page(found), figures_of(run) / f"plan_{loop.name}.png")
    _show(found, output)
    then = "" if found.realisations == 1 else ", then loopshape frf RUN --realisations"
    output.say(f"study written to {study}: loopshape measure {study} --out RUN{then}" if written else f"{why}: {study}")
    output.say(f"figure written to {figure}")
    output.say(found.sentence)
    output.json(answer(found) | {"run": str(run), "study": str(study), "complete": written, "figure": str(figure)})
    if not found.reached:
        raise typer.Exit(1)


def _std(std_db: float | None, std_percent: float | None, std_deg: float | None) -> float:
    """The wish as a relative std of |G|; refuses none, or several."""
    from loopshape.core.errors import WrongUseError
    from loopshape.core.units import from_db, rad

    given = {"--std-db": std_db, "--std-percent": std_percent, "--std-deg": std_deg}
    named = [name for name, value in given.items() if value is not None]
    if len(named) != 1:
        raise WrongUseError(
            "a plan needs one wanted accuracy",
            ", ".join(named) or "none",
            "give --std-db, --std-percent or --std-deg: 0.1 dB is 1.16 % or 0.66 deg",
        )
    if std_db is not None:
        return float(from_db(std_db)) - 1.0
    return float(rad(std_deg)) if std_deg is not None else 0.01 * float(std_percent or 0.0)


def _first(run: Run, name: str | None) -> Recording:
    """The recording to plan from; refuses a run with several where none is named, and one that excites no loop."""
    from loopshape.core.errors import WrongUseError
    from loopshape.identify.frequency_response import excited_recordings

    if name is None:
        found = excited_recordings(run)
        if len(found) > 1:
            names = ", ".join(r.info.name for r in found[:8]) + (", ..." if len(found) > 8 else "")
            raise WrongUseError("the run has several recordings to plan from", names, "name one: --recording NAME")
        return found[0]
    chosen = run.recording(name)
    if chosen.info.excites is None:
        raise WrongUseError(
            f"recording {name} excites no loop", chosen.info.kind, "plan from one that does, or say so in run.toml"
        )
    return chosen


def _controller(path: Path | None, loop: str) -> Controller | None:
    if path is None:
        return None
    from loopshape.io.check_files import controller_of
    from loopshape.io.controllers import read_controllers

    return controller_of(read_controllers(path), loop)


def _write(run: Run, recording: Recording, plan: Plan, path: Path) -> tuple[Path, bool, str]:
    """Write the study, or the signal alone where no rig is known that could do it; the path, which, and why not."""
    from loopshape.core.errors import LoopshapeError
    from loopshape.io.files import make_folder, write_text_whole, write_toml

    make_folder(path.parent)
    try:
        study = study_of(run, recording, plan)
    except LoopshapeError as error:
        csv = path.with_suffix(".csv")
        write_text_whole(csv, signal_csv(run, plan))
        return csv, False, f"the signal alone is written, no study can drive this rig ({error.what})"
    table = study.to_table()
    table["effects"] = dict(study.effects) or None
    table["experiment"][0]["realisations"] = plan.realisations if plan.realisations > 1 else None
    table["experiment"][0]["parameters"] = dict(recording.info.parameters) or None
    write_toml(path, table)
    return path, True, ""


def study_of(run: Run, recording: Recording, plan: Plan) -> Study:
    """The study that does the plan on the run's rig, where the first recording stood; refuses a rig that cannot."""
    from loopshape.core.errors import WrongUseError
    from loopshape.data.channel import Channel
    from loopshape.data.study import ExperimentTemplate, Study
    from loopshape.model import registry
    from loopshape.rig.simulated import plan as doable

    if run.plant is None:
        raise WrongUseError("run.toml names no plant", "no key plant", "name one, or play the signal")
    plant = registry.plant(run.plant)
    template = ExperimentTemplate(
        f"plan-{plan.loop}".replace("_", "-"),
        "multisine",
        plan.injection,
        plan.loop,
        plan.excitation,
        operating_points=(dict(recording.info.operating_point),),
        parameters=dict(recording.info.parameters),
    )
    unit = Channel.from_column(plan.column).unit
    study = Study(
        rig="simulated",
        plant=plant.name,
        experiments=(template,),
        operating_points=(dict(recording.info.operating_point),),
        rate_hz=run.rate_hz,
        seed=plan.wish.seed,
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
    from loopshape.data.excitation_sets import realised

    place, count = plan.column, plan.realisations
    made = [realised({plan.loop: plan.excitation}, k)[plan.loop].signal(run.rate_hz) for k in range(count)]
    heads = [place] if count == 1 else [f"r{k + 1}_{place}" for k in range(count)]
    rows = (
        ",".join([f"{k / run.rate_hz:.9g}", *(f"{value:.9g}" for value in values)])
        for k, values in enumerate(zip(*(x.tolist() for x in made), strict=True))
    )
    return "\n".join([",".join(["t_s", *heads]), *rows]) + "\n"


def _show(plan: Plan, output: Output) -> None:
    """Tables of what is planned."""
    import numpy as np

    e, f = plan.excitation, plan.lines_hz
    before = np.interp(f, plan.before_hz, plan.before_std)
    x = int(np.argmin(np.abs(f - plan.crossover_hz)))
    some = np.unique(np.append(np.round(np.linspace(0, f.size - 1, min(SHOWN, f.size))).astype(int), x))
    rows = [
        [float(f[k]), float(plan.line_amplitude[k]), 100.0 * float(before[k]), 100.0 * float(plan.std[k])] for k in some
    ]
    output.table("Lines, some of them", ["Hz", f"amplitude [{plan.unit}]", "std before [%]", "planned [%]"], rows)
    columns = [
        "realisations",
        "periods",
        "of [s]",
        "whole [s]",
        f"peak [{plan.unit}]",
        "peak u",
        "peak y",
        "binds",
        "std known to",
    ]
    sure = f"{100.0 * plan.sure:.0f} %"
    peaks = [e.amplitude, plan.peak_input, plan.peak_output]
    row = [plan.realisations, e.periods, e.period_s, plan.duration_s, *peaks, plan.binds, sure]
    output.table("Experiment", columns, [row])
    output.warn(plan.notes)


_PLAN = (
    "loop", "recording", "injection", "met", "reached", "crossover_hz", "short_by", "needed_s", "needed_amplitude",
    "binds", "realisations", "duration_s", "peak_input", "peak_output", "lines_hz", "line_amplitude", "std", "notes",
    "sentence",
)  # fmt: skip


def answer(plan: Plan) -> dict[str, Any]:
    """The plan as JSON; every std is relative, 0.01 being 1 % of |G|."""
    signal = named(plan.excitation, "period_s", "periods", "ramp_s", "amplitude")
    return {"format": "loopshape-plan/1", **named(plan, *_PLAN), **signal} | {
        "wished_std": plan.wish.std,
        "std_at_crossover": plan.at_crossover,
        "std_before": plan.before,
        "std_known_to": plan.sure,
        "distortion_std": plan.floor,
    }
