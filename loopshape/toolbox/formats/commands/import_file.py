"""`loopshape import`: a run from somebody's file, by a map that leaves nothing to guess; without one a draft of it."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from loopshape.cli.output import AsJson, Output, Quiet

if TYPE_CHECKING:
    from loopshape.data.signal.run import Run


def import_file(
    file: Annotated[Path, typer.Argument(help="CSV, MAT (v5, v7.3), Parquet, NPZ and others.", show_default=False)],
    map_file: Annotated[
        Path | None, typer.Option("--map", help="Which column is what; without it a draft of it is written.")
    ] = None,
    out: Annotated[Path | None, typer.Option(help="The run folder to write, or to add to.")] = None,
    accept: Annotated[bool, typer.Option("--accept", help="Take a draft as it is, with its guesses.")] = False,
    draft: Annotated[Path | None, typer.Option(help="Where the draft goes; default: FILE.map.toml here.")] = None,
    rate_hz: Annotated[float | None, typer.Option(help="The rate, for a draft of a file without stamps.")] = None,
    replace: Annotated[bool, typer.Option("--replace", help="Put this in place of the run that is there.")] = False,
    as_json: AsJson = False,
    quiet: Quiet = False,
) -> None:
    """Make a run folder from a recording of your own. The map's keys are in docs/files.md.

    Without --map the file is looked at and a draft of the map is written, with a reason for each guess and a picture;
    with --accept the run is made from it, or from the one that is there already.
    """
    from loopshape.core.errors import WrongUseError

    output = Output(as_json, quiet)
    if (map_file is not None or accept) and out is None:
        raise WrongUseError("a run needs a folder", "no --out", "name it: --out FOLDER")
    if map_file is not None and (draft is not None or rate_hz is not None):
        raise WrongUseError(
            "--draft and --rate-hz are for a draft", f"--map {map_file}", "leave them out: the map says the rate"
        )
    if map_file is None:
        map_file = draft or Path(f"{file.name.split('.')[0]}.map.toml")
        if accept and map_file.exists():
            from loopshape.toolbox.formats.drafts.draft_map import refuse_draft_of_another

            refuse_draft_of_another(map_file, file)
            output.say(f"map: {map_file}, written before")
        else:
            _draft(file, map_file, output, rate_hz, accept=accept)
    if out is not None:
        import_run(file, map_file, out, output, replace=replace, accept=accept)


def _draft(file: Path, path: Path, output: Output, rate_hz: float | None, *, accept: bool) -> None:
    """Write the draft of a file's map and its picture, and say each guess."""
    from loopshape.toolbox.formats.drafts.draft_map import draft_map, refuse_to_write_over, write_draft
    from loopshape.toolbox.formats.drafts.picture import draft as drawn
    from loopshape.verbs.pictures import save

    refuse_to_write_over(path)
    with output.progress("draft", 1):
        made = draft_map(file, rate_hz)
        units = {c.name: c.unit for c in made.columns}
        figure = drawn({c.name: c.values for c in made.columns}, made.roles, units, made.rate_hz)
        write_draft(path, made, file)  # last: a draft of what cannot be drawn would bar the next one
        picture = save(figure, path.with_suffix(".png"))
    output.say(f"draft of a map: {path}, drawn in {picture}\n")
    for sentence in made.guesses:
        output.paragraph(f"- {sentence}")
    if made.open:
        output.say("\nOpen:")
    for sentence in made.open:
        output.paragraph(f"- {sentence}")
    if not accept:
        output.say(f"\nRead it, correct it, delete [draft]; then: loopshape import {file} --map {path} --out RUN")
        output.json({"map": str(path), "picture": str(picture), "guesses": list(made.guesses), "open": list(made.open)})


def _add(out: Path, run: Run) -> None:
    """Add a run's recordings to the run that is there, or start one; refuses another recording of the same name."""
    from loopshape.core.errors import WrongUseError
    from loopshape.io.files import make_folder
    from loopshape.io.run.run_folder import alone, finished, holds, write_run

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


def import_run(
    file: Path, map_file: Path, out: Path, output: Output, *, replace: bool = False, accept: bool = False
) -> None:
    """Import, check, write and report; what is there already, number for number, is left as it is."""
    from loopshape.core.stretches import extent
    from loopshape.identify.signals import has_instrument
    from loopshape.io.run.run_folder import check_recordings
    from loopshape.toolbox.formats.tables.import_file import import_file as read
    from loopshape.toolbox.formats.tables.replacing import replace_run

    beside = next((p for p in (out, *out.absolute().parents) if p.is_dir()), None)
    run = read(file, map_file, beside, accept_draft=accept)
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
