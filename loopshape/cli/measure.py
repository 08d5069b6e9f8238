"""`loopshape measure`: drive the rig that a study names, write a run, estimate its FRFs."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer

from loopshape.cli.output import AsJson, Output, Quiet

StudyFile = Annotated[Path, typer.Argument(help="A study (TOML).", show_default=False)]


def measure(
    study: StudyFile,
    out: Annotated[Path, typer.Option(help="The run folder to write; an interrupted run goes on.")],
    as_json: AsJson = False,
    quiet: Quiet = False,
) -> None:
    """Drive the rig of a study and write a run folder with its FRFs."""
    from loopshape.cli.frf import estimate_and_report

    output = Output(as_json, quiet)
    ended = record(study, out, output)
    estimate_and_report(out, output, extra={"ended_early": ended})


def record(
    study_file: Path, out: Path, output: Output, *, states: bool = False, effects: Sequence[str] = ()
) -> list[str]:
    """Record what is missing of a study into a run folder; gives what ended early, a sentence each.

    `effects`, words NAME or NAME=MAGNITUDE, stand in for the study's own where they name the same.
    """
    import hashlib
    from dataclasses import replace

    from loopshape import registry
    from loopshape.errors import WrongUseError
    from loopshape.rigs.effects import asked, merged
    from loopshape.rigs.simulated import header, measure, plan
    from loopshape.store.run_folder import add_recording, alone, finished, read_run, start_run
    from loopshape.store.study import read_study

    study = read_study(study_file)
    if study.rig != "simulated":
        raise WrongUseError("a rig is not known", f"{study.rig!r}", 'use rig = "simulated"')
    plant = registry.plant(study.plant)
    study = replace(study, effects=merged(study.effects, asked(plant, effects)))
    todo = plan(study, plant)
    digest = hashlib.sha256(study_file.read_bytes()).hexdigest()
    start_run(out, header(study, plant, {"study_sha256": digest}))
    done = frozenset(finished(out))
    with alone(out), output.progress("measure", len(todo) - len(done)) as step:
        try:
            for recording in measure(study, plant, done=done, states=states):
                add_recording(out, recording)
                step(recording.info.name)
        except KeyboardInterrupt:
            output.warn([f"interrupted; what {out / 'run.toml'} lists is kept, the same command goes on"])
            raise typer.Exit(130) from None
    return [f"{r.info.name}: {r.info.ended_early}" for r in read_run(out).recordings if r.info.ended_early]
