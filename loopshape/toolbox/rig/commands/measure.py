"""`loopshape measure`: drive the rig that a study names, write a run, estimate its FRFs."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from loopshape.cli.output import AsJson, Output, Quiet, complain, point

if TYPE_CHECKING:
    from loopshape.data.signal.experiment import LoopSetup
    from loopshape.data.signal.run import Run
    from loopshape.toolbox.rig.settings import Motion
    from loopshape.toolbox.rig.steps.enough import Until

WORD = "ARM"

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
    arm: Annotated[bool, typer.Option("--arm", help="Allow the target to move; run with --show first.")] = False,
    show: Annotated[bool, typer.Option("--show", help="Show what a target would do, and stop.")] = False,
    again: Annotated[
        bool, typer.Option("--again", help="Make what ended early again; its table is kept in RUN/earlier.")
    ] = False,
    verdict: Annotated[
        Path | None, typer.Option(help="A kept verdict (check --save-verdict) that must pass these controllers.")
    ] = None,
    allow_unverified: Annotated[
        bool, typer.Option("--allow-unverified", help="Measure although a verdict is not passed; the journal keeps it.")
    ] = False,
    escalate: Annotated[
        float | None, typer.Option(help="Amplitude step by step, from so many percent of the study's.")
    ] = None,
    until: Annotated[
        str | None, typer.Option(help="End when it is enough: S=PERCENT, P=PERCENT, or a requirements file.")
    ] = None,
    as_json: AsJson = False,
    quiet: Quiet = False,
) -> None:
    """Record the experiments of a study and estimate FRFs. Drives the rig and writes a run folder.

    Exit code 1 where a target passed a limit, 2 where a simulation ended early.
    """
    from loopshape.cli.estimate.frf import estimate_and_report
    from loopshape.core.errors import LoopshapeError
    from loopshape.io.run.run_folder import read_run
    from loopshape.toolbox.rig.verbs.machine import ended_early
    from loopshape.toolbox.rig.verbs.on_target import StoppedAtLimitError

    output = Output(as_json, quiet)
    try:
        made = record(
            study, out, output, controllers=controllers, arm=arm, show=show, port=port, again=again, verdict=verdict,
            allow_unverified=allow_unverified, escalate=False if escalate is None else escalate, until=until_in(until),
        )  # fmt: skip
    except StoppedAtLimitError as stopped:
        complain(stopped)
        early = [*ended_early(read_run(out)), *([str(stopped)] if as_json else [])]
        try:
            estimate_and_report(out, output, ended_early=early)
        except LoopshapeError as error:
            complain(error)
        except typer.Exit:
            pass
        raise typer.Exit(1) from None
    if show and _is_target(study):
        return
    ended = ended_early(made)
    if any(r.info.excites is not None for r in made.recordings):
        try:
            estimate_and_report(out, output, ended_early=ended, made=made)
        except typer.Exit as early:
            raise typer.Exit(1 if _is_target(study) else early.exit_code) from None
        except LoopshapeError as error:
            if not (ended and _is_target(study)):
                raise
            complain(error)
            raise typer.Exit(1) from None
        return
    output.warn(ended)
    output.say(f"run {out}: no recording excites a loop, so there is no FRF; `loopshape simulate` draws what moved")
    output.json({"run": str(out), "ended_early": ended})


def _is_target(study_file: Path) -> bool:
    """Whether a study drives a real-time target."""
    from loopshape.toolbox.rig.files.study import read_study

    return read_study(study_file).target is not None


def record(
    study: Path,
    out: Path,
    output: Output,
    *,
    controllers: Path | None = None,
    arm: bool = False,
    show: bool = False,
    **options: Any,
) -> Run:
    """`verbs.machine.measure` with a terminal: what a target would do is shown first; `options` as there."""
    from loopshape.io.write.controllers import read_loop_controllers
    from loopshape.toolbox.rig.verbs.machine import measure as measure_study

    found = () if controllers is None else read_loop_controllers(controllers)
    return measure_study(
        study, out, controllers=found, confirm=lambda motion: confirmed(motion, arm, show, output), watch=output,
        **options,
    )  # fmt: skip


def until_in(word: str | None) -> Until | None:
    """What `--until` says: S=PERCENT or P=PERCENT (a number alone is S), anything else a file of requirements."""
    from loopshape.io.requirements import read_requirements
    from loopshape.toolbox.rig.steps.enough import Of, Until

    if word is None:
        return None
    of, _, number = word.rpartition("=")
    try:
        return Until(std=0.01 * float(number), of=Of(of or "S"))
    except ValueError:
        return Until(requirements=read_requirements(Path(word)))


def confirmed(motion: Motion, armed: bool, show: bool, output: Output) -> bool:
    """Show what is about to happen; nothing moves before a person confirms: --arm, or the word typed at a terminal."""
    from loopshape.core.errors import WrongUseError

    _show(motion, output)
    if show:
        output.say("no motion; --arm lets it move")
        raise typer.Exit(0)
    shown = not (output.as_json or output.quiet)
    if armed or (shown and sys.stdin.isatty() and input(f"Type {WORD} to let it move: ").strip() == WORD):
        return True
    raise WrongUseError("no motion", "no word to arm", "look at what is about to happen, then add --arm")


def _show(motion: Motion, output: Output) -> None:
    """Machine, limits, and each recording with the amplitude of what is injected."""
    from loopshape.data.signal.channel import Channel
    from loopshape.toolbox.rig.settings import spoken

    identity, settings = motion.identity, motion.settings
    kind = "emulated, nothing real moves" if identity.emulated else "a real machine"
    output.say(f"target: {identity.board} {identity.version} at {motion.port} ({kind}), {identity.rate_hz:g} Hz\n")
    columns = (*identity.sensors, *identity.commands)
    output.table(
        f"Limits; on one of them the machine {'vents' if settings.on_limit == 'vent' else 'holds, while this runs'}:",
        ("column", "limits"),
        [(c, str(settings.limits[c])) for c in columns],
    )
    rows = []
    for e in motion.experiments():
        largest = {loop.name: float(abs(e.injected[:, k]).max()) for k, loop in enumerate(e.loops)}
        units = {loop.name: Channel.from_column(_entered(loop, e.injection)).unit for loop in e.loops}
        moved = ", ".join(f"{n} {spoken(v, units[n])}" for n, v in largest.items() if v > 0.0) or "references only"
        rows.append((e.name, point(e.operating_point), e.injection, moved, e.duration_s))
    output.table("To be recorded:", ("recording", "operating point", "injection", "largest", "s"), rows)
    output.say("largest: of what is injected; what the machine makes of it depends on the loop\n")
    output.warn(motion.notes)


def _entered(loop: LoopSetup, injection: str) -> str:
    return loop.control if injection == "control" else str(loop.injected)
