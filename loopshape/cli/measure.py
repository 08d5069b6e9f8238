"""`loopshape measure`: drive the rig that a study names, write a run, estimate its FRFs."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from loopshape.cli.interrupts import interrupts
from loopshape.cli.output import AsJson, Output, Quiet

if TYPE_CHECKING:
    from loopshape.data.controller import Block

StudyFile = Annotated[Path, typer.Argument(help="A study (TOML).", show_default=False)]
ControllersFile = Annotated[
    Path | None,
    typer.Option("--controllers", help="A controller file: its loops' controllers in place of the study's."),
]


def measure(
    study: StudyFile,
    out: Annotated[Path, typer.Option(help="The run folder to write; an interrupted run goes on.")],
    controllers: ControllersFile = None,
    port: Annotated[str | None, typer.Option(help="Where the target is; wins over the study's.")] = None,
    arm: Annotated[bool, typer.Option("--arm", help="Let a target move: what it will do was looked at.")] = False,
    show: Annotated[bool, typer.Option("--show", help="Show what a target would do, and stop.")] = False,
    again: Annotated[
        bool, typer.Option("--again", help="Make what ended early again; its table is kept in RUN/earlier.")
    ] = False,
    as_json: AsJson = False,
    quiet: Quiet = False,
) -> None:
    """Drive the rig of a study and write a run folder with its FRFs.

    Exit code 1 where a target passed a limit, 2 where a simulation ended early.
    """
    from loopshape.cli.frf import estimate_and_report
    from loopshape.cli.measure_target import StoppedAtLimitError
    from loopshape.core.errors import LoopshapeError

    output = Output(as_json, quiet)
    try:
        ended = record(study, out, output, controllers=controllers, port=port, arm=arm, show=show, again=again)
    except StoppedAtLimitError as stopped:
        print(f"loopshape: {stopped}", file=sys.stderr)
        early = [*ended_early(out), *([str(stopped)] if as_json else [])]
        try:
            estimate_and_report(out, output, extra={"ended_early": early})
        except LoopshapeError as error:
            print(f"loopshape: {error}", file=sys.stderr)
        except typer.Exit:
            pass
        raise typer.Exit(1) from None
    if _excited(out):
        try:
            estimate_and_report(out, output, extra={"ended_early": ended})
        except typer.Exit as early:
            raise typer.Exit(1 if _is_target(study) else early.exit_code) from None
        except LoopshapeError as error:
            if not (ended and _is_target(study)):
                raise
            print(f"loopshape: {error}", file=sys.stderr)
            raise typer.Exit(1) from None
        return
    output.warn(ended)
    output.say(f"run {out}: no recording excites a loop, so there is no FRF; `loopshape simulate` draws what moved")
    output.json({"run": str(out), "ended_early": ended})


def _is_target(study_file: Path) -> bool:
    """Whether a study drives a real-time target."""
    from loopshape.io.study import read_study

    return read_study(study_file).target is not None


def _excited(run: Path) -> bool:
    """Whether a recording of a run excites a loop."""
    from loopshape.io.run_folder import read_run

    return any(r.info.excites is not None for r in read_run(run).recordings)


def record(
    study_file: Path,
    out: Path,
    output: Output,
    *,
    states: bool = False,
    effects: Sequence[str] = (),
    controllers: Path | None = None,
    port: str | None = None,
    arm: bool = False,
    show: bool = False,
    again: bool = False,
) -> list[str]:
    """Record what is missing of a study into a run folder; gives what ended early, a sentence each.

    `effects`, words NAME or NAME=MAGNITUDE, and the loops of a `controllers` file stand in for the study's own where
    they name the same.
    """
    from dataclasses import replace

    from loopshape.cli.measure_target import record_on_target
    from loopshape.core.errors import WrongUseError
    from loopshape.io.provenance import KEY, file_sha256, versions
    from loopshape.io.run_folder import add_recording, alone, finished, start_run, whole
    from loopshape.io.study import read_study
    from loopshape.model import registry
    from loopshape.rig.described import DescribedRig
    from loopshape.rig.effects import asked, merged
    from loopshape.rig.simulated import header, measure, plan

    study = read_study(study_file)
    if study.rig not in ("simulated", "target"):
        raise WrongUseError("a rig is not known", f"{study.rig!r}", 'use rig = "simulated" or "target"')
    plant = DescribedRig(study.loops) if study.loops else registry.plant(study.plant)
    study = replace(study, effects=merged(study.effects, asked(plant, effects)))
    if controllers is not None:
        study = replace(study, controllers={**study.controllers, **blocks_of(controllers, study.rate_hz)})
    extra: dict[str, object] = {
        "study_sha256": file_sha256(study_file),
        KEY: {**versions(), "study": study_file.name, "seed": study.seed},
    }
    if study.rig == "target":
        record_on_target(study, plant, out, output, port=port, armed=arm, show=show, again=again, extra=extra)
        return ended_early(out)
    todo = plan(study, plant)
    start_run(out, header(study, plant, extra))
    done = frozenset((whole if again else finished)(out))
    with alone(out), interrupts(), output.progress("measure", len(todo) - len(done)) as step:
        try:
            for recording in measure(study, plant, done=done, states=states):
                add_recording(out, recording, again=again)
                step(recording.info.name)
        except KeyboardInterrupt:
            output.warn([f"interrupted; what {out / 'run.toml'} lists is kept, the same command goes on"])
            raise typer.Exit(130) from None
    return ended_early(out)


def ended_early(run: Path) -> list[str]:
    """What of a run ended early, a sentence each."""
    from loopshape.io.run_folder import read_run

    return [f"{r.info.name}: {r.info.ended_early}" for r in read_run(run).recordings if r.info.ended_early]


def blocks_of(controllers: Path, rate_hz: float) -> dict[str, tuple[Block, ...]]:
    """Blocks by loop of a controller file; refuses another rate, and what the simulated rig does not run otherwise."""
    from dataclasses import MISSING, fields

    from loopshape.core.errors import WrongUseError
    from loopshape.io.controllers import read_controllers

    found = read_controllers(controllers)
    for one in found:
        settings = [f for f in fields(one) if f.default is not MISSING]
        if other := [f.name for f in settings if getattr(one, f.name) != f.default]:
            raise WrongUseError(
                f"the simulated rig runs plain Tustin in double precision, and loop {one.loop!r} asks for more",
                ", ".join(f"{name} = {getattr(one, name)!r}" for name in other),
                "leave that out of the file that it is simulated with",
            )
    if found[0].rate_hz != rate_hz:
        raise WrongUseError(
            f"the controllers of {controllers.name} run at another rate than the study",
            f"{found[0].rate_hz:g} and {rate_hz:g} Hz",
            "tune them on FRFs recorded at the study's rate",
        )
    return {one.loop: one.blocks for one in found}
