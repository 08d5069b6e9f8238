"""Measurement where the rig is a real-time target: confirmed before it moves, vented whatever ends it."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import AbstractContextManager, closing
from importlib import import_module
from pathlib import Path

from loopshape.core.errors import LoopshapeError, RigError, WrongUseError
from loopshape.data.recording import RecordingInfo
from loopshape.data.study import Study
from loopshape.data.target_settings import TargetSettings
from loopshape.io.arriving import adopted, arriving, keep_arrived
from loopshape.io.journal import note
from loopshape.io.measuring import marked
from loopshape.io.run_folder import add_recording, alone, finished, read_run, start_run, whole
from loopshape.io.run_tables import recording_table
from loopshape.rig.interrupts import interrupts
from loopshape.rig.link import open_link
from loopshape.rig.messages import Configuration, Identity
from loopshape.rig.session import Session
from loopshape.rig.simulated import Planned, Rig, experiment, header, plan
from loopshape.rig.taking import Arrived
from loopshape.rig.target import arm, configuration, drive, vented_on_error
from loopshape.verbs.watch import Confirm, Motion, Watch


class StoppedAtLimitError(RigError):
    """A real machine passed a limit: what was recorded is kept, and a person looks before anything moves again."""


def record_on_target(
    study: Study, plant: Rig, out: Path, watch: Watch, *, port: str | None, confirm: Confirm, again: bool,
    extra: dict[str, object],
) -> None:  # fmt: skip
    """Record what is missing of a study from a target. Moves nothing that was not confirmed."""
    settings = study.target
    if settings is None or not (name := port or settings.port):
        raise WrongUseError("the study names no port", "neither port in [target] nor --port", "give one")
    _refuse_what_only_models_do(study)
    planned, head = plan(study, plant), header(study, plant, extra)
    if out.is_dir():
        with alone(out):  # whoever measures into it is not disturbed
            done = (whole if again else finished)(out)
    else:
        done = set()
    todo = [one for one in planned if one.name not in done]
    if not todo:
        start_run(out, head)
        watch.say(f"all {len(planned)} recordings are there: nothing is left to measure")
        return
    with open_link(name, settings.baud) as link:
        session = Session(link)
        motion, wanted = _motion(session, name, study, plant, todo)
        if not confirm(motion):
            raise WrongUseError("no motion", "no word to arm", "look at what it will do, then give arm=True")
        start_run(out, head)
        with alone(out), marked(out, name), interrupts():
            keep_arrived(out)  # of a measurement that was killed
            try:
                _drive(session, wanted, todo, study, plant, out, watch)
            except LoopshapeError as error:
                note(out, "fault", said=str(error))
                raise
            except KeyboardInterrupt:
                note(out, "stopped")
                kept = f"stopped and vented; what {out / 'run.toml'} lists is kept; {_go_on(session.identity, name)}"
                raise KeyboardInterrupt(kept) from None
            finally:
                watch.warn(
                    [f"{ticks} ticks came before that, and are kept in {path}" for path, ticks in keep_arrived(out)]
                )
    _refuse_a_limit(session.identity, settings, name, out, [one.name for one in todo])


def _motion(
    session: Session, port: str, study: Study, plant: Rig, todo: Sequence[Planned]
) -> tuple[Motion, Configuration]:
    """What a target is about to do, and how it is configured for that; refuses what is outside its limits."""
    settings = study.target
    assert settings is not None
    head = header(study, plant)
    wanted = configuration(
        session.identity, todo[0].loops, settings, study.rate_hz, head.pwm or study.pwm, study.diagram
    )
    motion = Motion(session.identity, port, settings, tuple(todo), lambda one: experiment(study, plant, one))
    _refuse_points_beyond_limits(motion)
    return motion, wanted


def motion_of(study: Study, plant: Rig, port: str) -> Motion:
    """What a target at a port would do in a study, with nothing moved; refuses what measuring would refuse."""
    if study.target is None:
        raise WrongUseError("the study drives no target", f"rig = {study.rig!r}", "simulate it: ls.measure")
    _refuse_what_only_models_do(study)
    with open_link(port, study.target.baud) as link:
        return _motion(Session(link), port, study, plant, plan(study, plant))[0]


def _refuse_a_limit(identity: Identity, settings: TargetSettings, port: str, out: Path, todo: Sequence[str]) -> None:
    """A real machine that stopped at a limit is an error, though what it recorded is kept."""

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

    return read_run(out).recording(name).info.ended_early


def _drive(
    session: Session, wanted: Configuration, todo: Sequence[Planned], study: Study, plant: Rig, out: Path,
    watch: Watch,
) -> None:  # fmt: skip
    """Arm, and record what is to be done; whatever ends this early vents before the link is closed."""

    def keeper(info: RecordingInfo, rate_hz: float, names: Sequence[str]) -> AbstractContextManager[Arrived]:
        return arriving(out, info.name, recording_table(info), rate_hz, names)

    assert study.target is not None
    coming = (experiment(study, plant, one) for one in todo)
    import_module("pyarrow.parquet")  # now: it takes longer than a watchdog waits
    with watch.progress("measure", len(todo)) as step:
        armed = arm(session, study.target, todo[0].loops, wanted)
        with vented_on_error(session), closing(drive(armed, coming, keeper)) as made:
            for recording in made:
                add_recording(out, recording, again=True)
                adopted(out, recording.info.name)
                step(recording.info.name)


def _refuse_what_only_models_do(study: Study) -> None:

    asked = ["effects"] if study.effects else []
    asked += [f"parameters of experiment {e.name}" for e in study.experiments if e.parameters]
    if asked:
        raise WrongUseError(
            "a real machine has no parameters to be set", ", ".join(asked), "change it by hand, in a study of its own"
        )


def _refuse_points_beyond_limits(motion: Motion) -> None:
    """Refuse an operating point, or a setpoint on the way, outside the limits of the column that it is held on."""
    for e in motion.experiments():
        for k, loop in enumerate(e.loops):
            limit = motion.settings.limits.get(loop.output)
            low, high = float(e.references[:, k].min()), float(e.references[:, k].max())
            if limit is not None and not limit.low < low <= high < limit.high:
                raise WrongUseError(
                    f"the setpoint of {loop.name} in {e.name!r} lies outside its limits",
                    f"{limit.said(low if low <= limit.low else high)}, limits {limit}",
                    "move the operating point, or widen the limit",
                )
