"""`loopshape import`: a run from somebody's file, by a map that leaves nothing to guess."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from loopshape.cli.output import AsJson, Output, Quiet

if TYPE_CHECKING:
    from loopshape.data.run import Run


def import_file(
    file: Annotated[Path, typer.Argument(help="CSV, MAT (v5, v7.3), Parquet or NPZ.", show_default=False)],
    map_file: Annotated[Path, typer.Option("--map", help="Which column is what, in which unit, at which rate.")],
    out: Annotated[Path, typer.Option(help="The run folder to write, or to add to.")],
    replace: Annotated[bool, typer.Option("--replace", help="Put this in place of the run that is there.")] = False,
    as_json: AsJson = False,
    quiet: Quiet = False,
) -> None:
    """Make a run folder from a recording of your own; the map's keys are in docs/files.md."""
    import_run(file, map_file, out, Output(as_json, quiet), replace=replace)


def _add(out: Path, run: Run) -> None:
    """Add a run's recordings to the run that is there, or start one; refuses another recording of the same name."""
    from loopshape.core.errors import WrongUseError
    from loopshape.io.files import make_folder
    from loopshape.io.run_folder import alone, finished, holds, write_run

    make_folder(out)
    with alone(out):
        todo = [recording for recording in run.recordings if not holds(out, recording)]
        taken = finished(out) & {recording.info.name for recording in todo}
        if taken:
            raise WrongUseError(
                f"the run {out} has another recording of this name",
                ", ".join(sorted(taken)),
                "add --replace to start the run anew, or give [recording] another name in the map",
            )
        write_run(out, dataclasses.replace(run, recordings=todo))


def import_run(file: Path, map_file: Path, out: Path, output: Output, *, replace: bool = False) -> None:
    """Import, check, write and report; what is there already, number for number, is left as it is."""
    from loopshape.core.stretches import extent
    from loopshape.identify.signals import has_instrument
    from loopshape.io.import_file import import_file as read
    from loopshape.io.replacing import replace_run
    from loopshape.io.run_folder import check_recordings

    run = read(file, map_file, next((p for p in (out, *out.absolute().parents) if p.is_dir()), None))
    warnings = check_recordings(run)
    for recording in run.recordings:
        if recording.info.excites is not None and not has_instrument(recording, run.loop(recording.info.excites)):
            warnings.append(
                f"recording {recording.info.file} was made in closed loop and no column holds the signal that was"
                " injected: only the direct estimator, which feedback biases, can use it"
            )
    if replace:
        replace_run(out, run)
    else:
        _add(out, run)
    every = [(name, extent(recording.signal(name))) for recording in run.recordings for name in recording.columns]
    rows = [[name, seen.least, seen.most, seen.std, seen.size] for name, seen in every]
    output.table(f"Imported {file.name} at {run.rate_hz:g} Hz", ["column", "min", "max", "std", "samples"], rows)
    notes = [str(note) for note in run.extra.get("notes", ())]
    for note in notes:
        output.say(note)
    output.warn(warnings)
    keys = ("column", "min", "max", "std", "samples")
    output.json(
        {
            "run": str(out),
            "columns": [dict(zip(keys, row, strict=True)) for row in rows],
            "notes": notes,
            "warnings": warnings,
        }
    )
