"""`loopshape measure` where the rig is a real-time target: shown first, armed by hand, vented whatever ends it."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import AbstractContextManager
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from loopshape.cli.interrupts import interrupts
from loopshape.cli.output import Output, point
from loopshape.core.errors import RigError

if TYPE_CHECKING:
    from loopshape.data.experiment import LoopSetup
    from loopshape.data.recording import RecordingInfo
    from loopshape.data.study import Study
    from loopshape.data.target_settings import TargetSettings
    from loopshape.rig.messages import Configuration, Identity
    from loopshape.rig.session import Session
    from loopshape.rig.simulated import Planned, Rig
    from loopshape.rig.taking import Arrived

WORD = "ARM"


class StoppedAtLimitError(RigError):
    """A real machine passed a limit: what was recorded is kept, and a person looks before anything moves again."""


def record_on_target(
    study: Study, plant: Rig, out: Path, output: Output, *, port: str | None, armed: bool, show: bool,
    again: bool, extra: dict[str, object],
) -> None:  # fmt: skip
    """Record what is missing of a study from a target, or only `show` it. Moves nothing that was not armed."""
    from loopshape.core.errors import LoopshapeError, WrongUseError
    from loopshape.io.arriving import keep_arrived
    from loopshape.io.journal import note
    from loopshape.io.measuring import marked
    from loopshape.io.run_folder import alone, finished, start_run, whole
    from loopshape.rig.link import open_link
    from loopshape.rig.session import Session
    from loopshape.rig.simulated import header, plan
    from loopshape.rig.target import configuration

    settings = study.target
    if settings is None or not (name := port or settings.port):
        raise WrongUseError("the study names no port", "neither port in [target] nor --port", "give one")
    _refuse_what_only_models_do(study)
    planned, head = plan(study, plant), header(study, plant, extra)
    if out.is_dir():
        with alone(out):  # whoever measures into it is left in peace
            done = (whole if again else finished)(out)
    else:
        done = set()
    todo = [one for one in planned if one.name not in done]
    if not todo:
        start_run(out, head)
        output.say(f"all {len(planned)} recordings are there: nothing is left to measure")
        if show:
            raise typer.Exit(0)
        return
    with open_link(name, settings.baud) as link:
        session = Session(link)
        wanted = configuration(session.identity, planned[0].loops, settings, study.rate_hz, head.pwm or study.pwm)
        _refuse_points_beyond_limits(settings, todo, study, plant)
        _show(session.identity, name, settings, todo, study, plant, output)
        if show:
            output.say("nothing was moved; --arm lets it move")
            raise typer.Exit(0)
        _be_armed(armed, output)
        start_run(out, head)
        with alone(out), marked(out, name), interrupts():
            keep_arrived(out)  # of a measurement that was killed
            try:
                _drive(session, wanted, todo, study, plant, out, output)
            except LoopshapeError as error:
                note(out, "fault", said=str(error))
                raise
            except KeyboardInterrupt:
                note(out, "stopped")
                lines = [f"stopped and vented; what {out / 'run.toml'} lists is kept", _go_on(session.identity, name)]
                output.warn(["; ".join(lines)])
                raise typer.Exit(130) from None
            finally:
                output.warn(
                    [f"{ticks} ticks came before that, and are kept in {path}" for path, ticks in keep_arrived(out)]
                )
    _refuse_a_limit(session.identity, settings, name, out, [one.name for one in todo])


def _refuse_a_limit(identity: Identity, settings: TargetSettings, port: str, out: Path, todo: Sequence[str]) -> None:
    """A real machine that stopped at a limit is an error, though what it recorded is kept."""
    from loopshape.io.run_folder import finished

    way = "held at a limit and was vented after it" if settings.on_limit == "hold" else "vented at a limit"
    done = finished(out)
    if left := [name for name in todo if name not in done]:
        raise StoppedAtLimitError(
            f"the machine {way}, and {len(left)} of {len(todo)} recordings were not made",
            ", ".join(left),
            _go_on(identity, port),
        )
    if not identity.emulated and (hit := _at_limit(out, todo[-1])):
        raise StoppedAtLimitError(f"the machine {way} in the last recording", hit, _go_on(identity, port))


def _go_on(identity: Identity, port: str) -> str:
    """How to go on after a fault: a real machine is looked at first."""
    look = (
        "" if identity.emulated else f"look at the machine and clear the fault (loopshape stop {port} --clear), then "
    )
    return f"{look}the same command goes on"


def _at_limit(out: Path, name: str) -> str | None:
    from loopshape.io.run_folder import read_run

    return read_run(out).recording(name).info.ended_early


def _drive(
    session: Session, wanted: Configuration, todo: Sequence[Planned], study: Study, plant: Rig, out: Path,
    output: Output,
) -> None:  # fmt: skip
    """Arm, and record what is to be done; whatever ends this early vents before the link is closed."""
    from contextlib import closing
    from importlib import import_module

    from loopshape.io.arriving import adopted, arriving
    from loopshape.io.run_folder import add_recording
    from loopshape.io.run_tables import recording_table
    from loopshape.rig.simulated import experiment
    from loopshape.rig.target import arm, drive, vented_on_error

    def keeper(info: RecordingInfo, rate_hz: float, names: Sequence[str]) -> AbstractContextManager[Arrived]:
        return arriving(out, info.name, recording_table(info), rate_hz, names)

    assert study.target is not None
    coming = (experiment(study, plant, one) for one in todo)
    import_module("pyarrow.parquet")  # now: it takes longer than a watchdog waits
    with output.progress("measure", len(todo)) as step:
        armed = arm(session, study.target, todo[0].loops, wanted)
        with vented_on_error(session), closing(drive(armed, coming, keeper)) as made:
            for recording in made:
                add_recording(out, recording, again=True)
                adopted(out, recording.info.name)
                step(recording.info.name)


def _refuse_what_only_models_do(study: Study) -> None:
    from loopshape.core.errors import WrongUseError

    asked = ["effects"] if study.effects else []
    asked += [f"parameters of experiment {e.name}" for e in study.experiments if e.parameters]
    if asked:
        raise WrongUseError(
            "a real machine has no parameters to be set", ", ".join(asked), "change it by hand, in a study of its own"
        )


def _refuse_points_beyond_limits(settings: TargetSettings, todo: Sequence[Planned], study: Study, plant: Rig) -> None:
    """Refuse an operating point, or a setpoint on the way, outside the limits of the column that it is held on."""
    from loopshape.core.errors import WrongUseError
    from loopshape.rig.simulated import experiment

    for one in todo:
        e = experiment(study, plant, one)
        for k, loop in enumerate(e.loops):
            limit = settings.limits.get(loop.output)
            low, high = float(e.references[:, k].min()), float(e.references[:, k].max())
            if limit is not None and not limit.low < low <= high < limit.high:
                raise WrongUseError(
                    f"the setpoint of {loop.name} in {one.name!r} lies outside its limits",
                    f"{limit.said(low if low <= limit.low else high)}, limits {limit}",
                    "move the operating point, or widen the limit",
                )


def _show(
    identity: Identity, port: str, settings: TargetSettings, todo: Sequence[Planned], study: Study, plant: Rig,
    output: Output,
) -> None:  # fmt: skip
    """What is about to happen: machine, limits, and each recording with the amplitude of what is injected."""
    from loopshape.data.channel import Channel
    from loopshape.data.target_settings import spoken
    from loopshape.rig.simulated import experiment

    kind = "emulated, nothing real moves" if identity.emulated else "a real machine"
    output.say(f"target: {identity.board} {identity.version} at {port} ({kind}), {identity.rate_hz:g} Hz\n")
    columns = (*identity.sensors, *identity.commands)
    output.table(
        f"Limits; on one of them the machine {'vents' if settings.on_limit == 'vent' else 'holds, while this runs'}:",
        ("column", "limits"),
        [(c, str(settings.limits[c])) for c in columns],
    )
    rows = []
    for one in todo:
        e = experiment(study, plant, one)
        largest = {loop.name: float(abs(e.injected[:, k]).max()) for k, loop in enumerate(e.loops)}
        units = {loop.name: Channel.from_column(_entered(loop, e.injection)).unit for loop in e.loops}
        moved = ", ".join(f"{n} {spoken(v, units[n])}" for n, v in largest.items() if v > 0.0) or "references only"
        rows.append((one.name, point(one.operating_point), e.injection, moved, e.duration_s))
    output.table("To be recorded:", ("recording", "operating point", "injection", "largest", "s"), rows)
    output.say("largest: of what is injected; what the machine makes of it depends on the loop\n")


def _entered(loop: LoopSetup, injection: str) -> str:
    return loop.control if injection == "control" else str(loop.injected)


def _be_armed(armed: bool, output: Output) -> None:
    """Nothing moves before a person says so: --arm, or the word typed at a terminal."""
    import sys

    from loopshape.core.errors import WrongUseError

    if armed:
        return
    shown = not (output.as_json or output.quiet)
    if shown and sys.stdin.isatty() and input(f"Type {WORD} to let it move: ").strip() == WORD:
        return
    raise WrongUseError("nothing was moved", "no word to arm", "look at what is about to happen, then add --arm")
