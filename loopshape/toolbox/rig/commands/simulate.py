"""`loopshape simulate`: time responses of a study's plant, with the true states beside what is measured."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from loopshape.cli.output import AsJson, Output, Quiet, point
from loopshape.toolbox.rig.commands.measure import ControllersFile, StudyFile, record
from loopshape.verbs.pictures import figures_of


def simulate(
    study: StudyFile,
    out: Annotated[Path | None, typer.Option(help="The run folder to write; default: the study's name.")] = None,
    effect: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME[=MAGNITUDE]",
            help="An effect that the nominal model leaves out (loopshape effects).",
        ),
    ] = None,
    controllers: ControllersFile = None,
    as_json: AsJson = False,
    quiet: Quiet = False,
) -> None:
    """Simulate steps, profiles or open-loop experiments.

    They are those of a study; a run and a figure of each are written.
    """
    from loopshape.toolbox.rig.pictures import responses
    from loopshape.toolbox.rig.verbs.machine import ended_early
    from loopshape.verbs.pictures import save

    output = Output(as_json, quiet)
    folder = out or Path(f"{study.stem}-run")
    run = record(study, folder, output, states=True, effects=effect or (), controllers=controllers)
    ended = ended_early(run)
    rows, figures = [], []
    for recording in run.recordings:
        figures.append(str(save(responses(recording, run.loops), figures_of(folder) / f"{recording.info.name}.png")))
        for loop in run.loops:
            if loop.reference is None:
                continue
            error = recording.column(loop.reference) - recording.output(loop.output)
            tail = error[-max(1, error.size // 20) :]
            rows.append(
                [
                    recording.info.name,
                    point(recording.info.operating_point),
                    loop.name,
                    loop.output_unit,
                    float((error**2).mean() ** 0.5),
                    float(abs(error).max()),
                    float(tail.mean()),
                ]
            )
    columns = ["recording", "operating point", "loop", "unit", "rms error", "largest error", "error at the end"]
    output.table("Simulated", columns, rows)
    output.warn(ended)
    output.say(f"run {folder}; figures {', '.join(figures)}")
    keys = ("recording", "operating_point", "loop", "unit", "rms_error", "largest_error", "final_error")
    output.json(
        {
            "run": str(folder),
            "figures": figures,
            "ended_early": ended,
            "errors": [dict(zip(keys, r, strict=True)) for r in rows],
        }
    )
    if ended:
        raise typer.Exit(2)
