"""`loopshape plan`: from a first short recording, the experiment that reaches a wanted accuracy at the crossover."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from loopshape.cli.output import AsJson, Output, Quiet, RunFolder
from loopshape.verbs.pictures import figures_of

if TYPE_CHECKING:
    from collections.abc import Sequence

    from loopshape.data.control.controller import Controller
    from loopshape.data.signal.run import Run
    from loopshape.toolbox.planning.plan_nouns import Plan

#: lines of the table that are shown, the crossover's among them
SHOWN = 12
_LIMIT = "in its column's unit"


def plan(
    run: RunFolder,
    recording: Annotated[str | None, typer.Option(help="The first recording, where the run has several.")] = None,
    std_db: Annotated[float | None, typer.Option(help="Required std of |G| at the crossover in dB.")] = None,
    std_percent: Annotated[float | None, typer.Option(help="The same in percent.")] = None,
    std_deg: Annotated[float | None, typer.Option(help="The same of the phase, in degrees.")] = None,
    at: Annotated[float | None, typer.Option(help="Where it is required, in Hz; default: the crossover.")] = None,
    controller: Annotated[
        Path | None, typer.Option(help="A controller file for the crossover; default: the run's own.")
    ] = None,
    max_amplitude: Annotated[
        float | None, typer.Option(help=f"Largest injected peak, {_LIMIT}; default: the recording's.")
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
    resolution_hz: Annotated[
        float | None, typer.Option(help="Frequency resolution in Hz; with --seconds, in place of an accuracy.")
    ] = None,
    seconds: Annotated[float | None, typer.Option(help="Length in s; with --resolution-hz.")] = None,
    lines: Annotated[str, typer.Option(help="odd (shows distortion), log, or all.")] = "odd",
    until: Annotated[
        str | None, typer.Option(help="Say whether it is enough: S=PERCENT, P=PERCENT, or a requirements file.")
    ] = None,
    out: Annotated[Path | None, typer.Option(help="The study to write; default: plan_LOOP.toml in the run.")] = None,
    as_json: AsJson = False,
    quiet: Quiet = False,
) -> None:
    """Plan a multisine for a given accuracy at the crossover. Exit code 1 where it is out of reach.

    Where the first recording has that accuracy already nothing is proposed. With --resolution-hz and --seconds, as
    `check` prints them for an undecided verdict, the experiment is that, in the band from --from-hz to --to-hz.
    With --until nothing is planned: it says whether the recording is long enough, or about how much more it takes (1).
    """
    from loopshape.io.run.run_folder import read_run
    from loopshape.io.write.controllers import read_controllers
    from loopshape.toolbox.planning.verbs import plan as planned

    output = Output(as_json, quiet)
    held = read_run(run)
    own = () if controller is None else read_controllers(controller)
    if until is not None:
        long_enough(held, recording, until, own, output)
        return
    with output.progress("plan", 1) as step:
        found = planned(
            held, recording, std=_std(std_db, std_percent, std_deg, resolution_hz is not None or seconds is not None),
            controllers=own, at_hz=at, max_amplitude=max_amplitude, max_input=max_input, max_output=max_output,
            longest_s=longest_s, f_low_hz=from_hz, f_high_hz=to_hz, kind=lines, resolution_hz=resolution_hz,
            seconds=seconds,
        )  # fmt: skip
        step(found.recording)
    if found.satisfied:
        output.say(found.sentence)
        output.json(found.to_dict() | {"run": str(run), "study": None, "complete": False, "figure": None})
        return
    _written(held, found, run, out, output)
    if not found.reached:
        raise typer.Exit(1)


def _written(held: Run, found: Plan, run: Path, out: Path | None, output: Output) -> None:
    """Write a plan's study and figure, and report both."""
    from loopshape.toolbox.planning.plan_pictures import plan_page
    from loopshape.toolbox.planning.verbs import write_plan
    from loopshape.verbs.pictures import save

    study, written, why = write_plan(held, found, out or run / f"plan_{found.loop}.toml")
    figure = save(plan_page(found), figures_of(run) / f"plan_{found.loop}.png")
    _show(found, output)
    then = "" if found.realisations == 1 else ", then loopshape frf RUN --realisations"
    output.say(f"study written to {study}: loopshape measure {study} --out RUN{then}" if written else f"{why}: {study}")
    output.say(f"figure written to {figure}")
    output.say(found.sentence)
    output.json(found.to_dict() | {"run": str(run), "study": str(study), "complete": written, "figure": str(figure)})


def long_enough(
    run: Run, recording: str | None, until: str, controllers: Sequence[Controller], output: Output
) -> None:  # fmt: skip
    """Say how accurate a recording is, and whether it is enough. Exit code 1 where it takes more."""
    from loopshape.toolbox.planning.verbs import enough
    from loopshape.toolbox.rig.commands.measure import until_in
    from loopshape.toolbox.rig.steps.enough import State

    wanted = until_in(until)
    assert wanted is not None
    found = enough(run, wanted, recording, controllers=controllers)
    rows = [
        (x.low_hz, x.high_hz, "-" if x.sensitivity_std is None else 100.0 * x.sensitivity_std, 100.0 * x.plant_std)
        for x in found.bands
    ]
    output.table("Accuracy so far", ["from [Hz]", "to [Hz]", "std of S [%]", "std of P [%]"], rows)
    output.say(found.sentence)
    output.json(found.to_dict())
    if found.state is State.MORE:
        raise typer.Exit(1)


def _std(std_db: float | None, std_percent: float | None, std_deg: float | None, stated: bool) -> float | None:
    """The required accuracy as a relative std of |G|, None where the experiment is told; refuses none, or several."""
    from loopshape.core.errors import WrongUseError
    from loopshape.core.units import from_db, rad

    given = {"--std-db": std_db, "--std-percent": std_percent, "--std-deg": std_deg}
    named = [name for name, value in given.items() if value is not None]
    if stated and not named:
        return None
    if len(named) != 1:
        raise WrongUseError(
            "a plan needs one wanted accuracy",
            ", ".join(named) or "none",
            "give --std-db, --std-percent or --std-deg (0.1 dB: 1.16 % or 0.66 deg), or --resolution-hz and --seconds",
        )
    if std_db is not None:
        return float(from_db(std_db)) - 1.0
    return float(rad(std_deg)) if std_deg is not None else 0.01 * float(std_percent or 0.0)


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
