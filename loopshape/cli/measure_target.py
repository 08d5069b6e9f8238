"""`loopshape measure` where the rig is a real-time target: shown first, armed by hand, vented whatever ends it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from loopshape.cli.output import Output, point

if TYPE_CHECKING:
    from loopshape.rigs.messages import Identity
    from loopshape.rigs.simulated import Planned, Rig
    from loopshape.study import Study
    from loopshape.target_settings import TargetSettings

WORD = "ARM"
MARK = ".measuring.part"  # who drives a target into a run folder


def record_on_target(
    study: Study, plant: Rig, out: Path, output: Output, *, port: str | None, armed: bool, extra: dict[str, object]
) -> None:
    """Record what is missing of a study from a target. Refuses to move anything before it was shown and armed."""
    from loopshape.errors import WrongUseError
    from loopshape.rigs.link import open_link
    from loopshape.rigs.session import Session
    from loopshape.rigs.simulated import experiment, header, plan
    from loopshape.rigs.target import arm, configuration, drive
    from loopshape.store.run_folder import add_recording, alone, finished, start_run

    settings = study.target
    if settings is None or not (name := port or settings.port):
        raise WrongUseError("the study names no port", "neither port in [target] nor --port", "give one")
    _refuse_what_only_models_do(study)
    planned, head = plan(study, plant), header(study, plant, extra)
    with open_link(name, settings.baud) as link:
        session = Session(link)
        wanted = configuration(session.identity, planned[0].loops, settings, study.rate_hz, head.pwm or study.pwm)
        todo = [one for one in planned if one.name not in finished(out)]
        _show(session.identity, name, settings, todo, study, plant, output)
        if not todo:
            return
        _be_armed(armed, output)
        start_run(out, head)
        with alone(out), _marked(out, name), _interrupts(), output.progress("measure", len(todo)) as step:
            try:
                made = drive(
                    arm(session, settings, planned[0].loops, wanted), (experiment(study, plant, one) for one in todo)
                )
                for recording in made:
                    add_recording(out, recording)
                    step(recording.info.name)
            except KeyboardInterrupt:
                output.warn([f"stopped and vented; what {out / 'run.toml'} lists is kept, the same command goes on"])
                raise typer.Exit(130) from None


def _refuse_what_only_models_do(study: Study) -> None:
    from loopshape.errors import WrongUseError

    asked = ["effects"] if study.effects else []
    asked += [f"parameters of experiment {e.name}" for e in study.experiments if e.parameters]
    if asked:
        raise WrongUseError(
            "a real machine has no parameters to be set", ", ".join(asked), "change it by hand, in a study of its own"
        )


def _show(
    identity: Identity, port: str, settings: TargetSettings, todo: Sequence[Planned], study: Study, plant: Rig,
    output: Output,
) -> None:  # fmt: skip
    """What is about to happen: machine, limits, and each recording with the amplitude of what is injected."""
    from loopshape.rigs.simulated import experiment

    kind = "emulated, nothing real moves" if identity.emulated else "a real machine"
    output.say(f"target: {identity.board} {identity.version} at {port} ({kind}), {identity.rate_hz:g} Hz\n")
    columns = (*identity.sensors, *identity.commands)
    output.table(
        f"Limits; on one of them the machine {'vents' if settings.on_limit == 'vent' else 'holds'}:",
        ("column", "limits"),
        [(c, str(settings.limits[c])) for c in columns],
    )
    rows = []
    for one in todo:
        e = experiment(study, plant, one)
        largest = {loop.name: float(abs(e.injected[:, k]).max()) for k, loop in enumerate(e.loops)}
        moved = ", ".join(f"{name} {value:.3g}" for name, value in largest.items() if value > 0.0) or "references only"
        rows.append((one.name, point(one.operating_point), e.injection, moved, e.duration_s))
    output.table("To be recorded:", ("recording", "operating point", "injection", "largest", "s"), rows)


def _be_armed(armed: bool, output: Output) -> None:
    """Nothing moves before a person says so: --arm, or the word typed at a terminal."""
    import sys

    from loopshape.errors import WrongUseError

    if armed:
        return
    if not output.as_json and sys.stdin.isatty() and input(f"Type {WORD} to let it move: ").strip() == WORD:
        return
    raise WrongUseError("nothing was moved", "no word to arm", "look at what is about to happen, then add --arm")


@contextmanager
def _marked(out: Path, port: str) -> Iterator[None]:
    """Say in the run folder who drives which port, for `loopshape stop`."""
    import os

    from loopshape.store.files import write_json

    mark = out / MARK
    write_json(mark, {"pid": os.getpid(), "port": port})
    try:
        yield
    finally:
        with suppress(OSError):
            mark.unlink()


@contextmanager
def _interrupts() -> Iterator[None]:
    """A request to terminate ends like Ctrl-C: the machine vents first."""
    import signal

    def interrupt(number: int, frame: object) -> None:
        raise KeyboardInterrupt

    before = signal.signal(signal.SIGTERM, interrupt)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)
