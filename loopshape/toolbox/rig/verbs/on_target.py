"""Measurement where the rig is a real-time target: confirmed before it moves, vented whatever ends it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager, closing
from importlib import import_module
from pathlib import Path
from time import sleep
from typing import NamedTuple

import numpy as np

from loopshape.core.errors import LoopshapeError, WrongUseError
from loopshape.core.interrupts import interrupts, unhurried
from loopshape.core.units import Array
from loopshape.data.control.controller import Controller
from loopshape.data.control.scheduled import Scheduled
from loopshape.data.result.verdict import Verdict
from loopshape.data.signal.channel import sum_terms
from loopshape.data.signal.experiment import Experiment, LoopSetup
from loopshape.data.signal.recording import RecordingInfo
from loopshape.io.run.journal import note
from loopshape.io.run.run_folder import add_recording, alone, finished, read_run, start_run, whole
from loopshape.io.run.run_tables import recording_table
from loopshape.io.write.verdicts import read_verdicts
from loopshape.toolbox.rig.settings import Confirm, Limit, Motion, TargetSettings
from loopshape.toolbox.rig.simulated import Planned, Rig, experiment, header, plan
from loopshape.toolbox.rig.steps.course import Course, StoppedAtLimitError
from loopshape.toolbox.rig.steps.escalation import NOISE_PEAK, NOISE_SHARE
from loopshape.toolbox.rig.study import Study
from loopshape.toolbox.rig.target.acquisition import RATE_TICKS, Arrived
from loopshape.toolbox.rig.target.blocks import own_radius
from loopshape.toolbox.rig.target.link import open_link
from loopshape.toolbox.rig.target.messages import Configuration, Identity
from loopshape.toolbox.rig.target.session import Session
from loopshape.toolbox.rig.target.stream_log import adopted, keep_arrived, open_stream_log
from loopshape.toolbox.rig.target.target import arm, configuration, drive, vented_on_error
from loopshape.toolbox.rig.verbs.stop import marked
from loopshape.verbs.watch import Watch

NOISE_TICKS = 100  # of a pulse response: longer ones are drift, not noise


class Clearance(NamedTuple):
    """What lets controllers drive a machine: a kept verdict that passes them, or that unverified ones are allowed."""

    verdict: Path | None = None
    allow_unverified: bool = False


def record_on_target(
    study: Study, course: Course, extra: dict[str, object], clearance: Clearance, *, port: str | None, confirm: Confirm,
    again: bool,
) -> None:  # fmt: skip
    """Record what is missing of a study from a target. Moves nothing that was not confirmed."""
    settings, plant, out, watch = study.target, course.plant, course.folder, course.watch
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
        motion, wanted = planned_motion(session, name, study, plant, todo, clearance)
        if not confirm(motion):
            raise WrongUseError("no motion", "no word to arm", "look at what it will do, then give arm=True")
        start_run(out, head)
        with alone(out), marked(out, name), unhurried(), interrupts():
            keep_arrived(out)  # of a measurement that was killed
            allowed = clearance.allow_unverified
            note(out, "armed", target=session.identity.board, notes=motion.notes, allow_unverified=allowed)
            try:
                _drive(session, wanted, todo, study, course, out, watch)
            except LoopshapeError as error:
                note(out, "fault", message=str(error))
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


def planned_motion(
    session: Session, port: str, study: Study, plant: Rig, todo: Sequence[Planned], clearance: Clearance
) -> tuple[Motion, Configuration]:
    """What a target is about to do, and how it is configured for that; refuses what is outside its limits."""
    settings, identity, loops = study.target, session.identity, todo[0].loops
    assert settings is not None
    pwm = header(study, plant).pwm or study.pwm
    wanted = configuration(identity, loops, settings, study.rate_hz, pwm, study.diagram)
    notes = (*_unverified(loops, wanted, *clearance), *_older_target(identity))
    notes += tuple(loud(session, loops, wanted, clearance.allow_unverified))
    motion = Motion(identity, port, settings, tuple(todo), lambda one: experiment(study, plant, one), notes)
    _refuse_signals_beyond_limits(motion, wanted)
    return motion, wanted


def motion_of(study: Study, plant: Rig, port: str, clearance: Clearance) -> Motion:
    """What a target at a port would do in a study, with nothing moved; refuses what measuring would refuse."""
    if study.target is None:
        raise WrongUseError("the study drives no target", f"rig = {study.rig!r}", "simulate it: ls.rig.measure")
    _refuse_what_only_models_do(study)
    with open_link(port, study.target.baud) as link:
        return planned_motion(Session(link), port, study, plant, plan(study, plant), clearance)[0]


def _unverified(loops: Sequence[LoopSetup], wanted: Configuration, file: Path | None, allowed: bool) -> tuple[str, ...]:
    """What is not verified of the controllers, a sentence each.

    Refuses, unless allowed, a kept verdict (`check --save-verdict`) that does not pass these very controllers, and a
    diagram whose controllers are unstable by themselves.
    """
    kept = {} if file is None else {own.loop: one for one in read_verdicts(file) for own in one.controllers}
    running = {loop.name: loop.controller for loop in loops}
    doubts = [note for loop in loops if (note := _verdict_doubt(loop, kept.get(loop.name), running, file))]
    radius = own_radius(wanted.blocks, 2 * len(wanted.outputs))
    if radius is None:
        doubts.append("the diagram has too many states for the stability of its controllers alone to be computed")
    away = radius is not None and radius > 1.0 + 1e-6  # integrators, several at a place, lie within rounding of |z| = 1
    circle = [f"the diagram's controllers alone are unstable, |z| = {radius:.9g}"] if away else []
    if not allowed and (refused := [*(doubts if file else []), *circle]):
        raise WrongUseError(
            "the controllers are not verified", "; ".join(refused),
            "check them anew, or allow it: --allow-unverified (allow_unverified=True)",
        )  # fmt: skip
    return (*doubts, *circle)


def _verdict_doubt(
    loop: LoopSetup, kept: Verdict | None, running: Mapping[str, Controller | None], file: Path | None
) -> str | None:
    """A sentence where a loop's controller, with all that were closed beside it, has no passed verdict in this file."""
    if file is None:
        return f"loop {loop.name}: no verdict is given on its controller (loopshape check --save-verdict, --verdict)"
    if loop.controller is None:
        return f"loop {loop.name}: a schedule or diagram has no verdict in {file.name}"
    if kept is None:
        return f"loop {loop.name}: no verdict on it in {file.name}"
    if not all(_runs_the_same(own, running.get(own.loop)) for own in kept.controllers):
        return f"loop {loop.name}: the verdict in {file.name} is of another controller"
    return None if kept.passed else f"loop {loop.name}: the verdict in {file.name} is {kept.outcome}"


def _runs_the_same(theirs: Controller | Scheduled, ours: Controller | None) -> bool:
    if ours is None or isinstance(theirs, Scheduled):
        return False
    return theirs.rate_hz == ours.rate_hz and np.array_equal(theirs.biquads(), ours.biquads())


def loud(
    session: Session, loops: Sequence[LoopSetup], wanted: Configuration, allowed: bool
) -> list[str]:  # fmt: skip
    """Commands of which noise at rest alone would take too much, a sentence each; refuses them unless allowed.

    The sensors are read as they are, nothing being armed: their noise by the differences of readings, taken as white,
    through each loop's controller (the sum of squares of its pulse response; schedules and diagrams are left out).
    """
    rows = []
    for _ in range(50):  # of the sensors, before anything is armed
        rows.append(session.status().sensors)
        sleep(2.0 / session.identity.rate_hz)
    readings = np.array(rows)
    noise = np.sqrt(0.5 * np.mean(np.diff(readings, axis=0) ** 2, axis=0))
    squares = np.array([0.0 if loop.controller is None else _noise_gain(loop.controller) for loop in loops])
    power = wanted.mixing**2 @ (squares * (wanted.outputs**2 @ noise**2))
    loud = []
    for k, column in enumerate(session.identity.commands):
        low, high, _ = wanted.limits[len(noise) + k]
        peak = NOISE_PEAK * float(np.sqrt(power[k]))
        if peak > NOISE_SHARE * 0.5 * (high - low):
            loud.append(
                f"{column}: noise of the sensors at rest alone would move it by {peak:.3g} of {low:g} to {high:g}"
            )
    if loud and not allowed:
        raise WrongUseError(
            "the controllers would turn the noise at rest into commands", "; ".join(loud),
            "filter the controller's high frequencies (a low_pass), or allow it: --allow-unverified",
        )  # fmt: skip
    return loud


def _noise_gain(controller: Controller) -> float:
    """Variance of what a controller makes of white noise of variance 1 within `NOISE_TICKS`, drifts left out."""
    from scipy.signal import sosfilt

    sections = np.insert(controller.biquads(), 3, 1.0, axis=1)
    pulse = np.zeros(NOISE_TICKS)
    pulse[0] = 1.0
    return float(np.sum(sosfilt(sections, pulse) ** 2))


def _older_target(identity: Identity) -> list[str]:
    note = "the target is older than this host: recorded bytes can arm it; build it anew from this version's sources"
    return [] if identity.guarded else [note]


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
    session: Session, wanted: Configuration, todo: Sequence[Planned], study: Study, course: Course, out: Path,
    watch: Watch,
) -> None:  # fmt: skip
    """Arm, and record what is to be done; whatever ends this early vents before the link is closed."""

    def keeper(info: RecordingInfo, rate_hz: float, names: Sequence[str]) -> AbstractContextManager[Arrived]:
        return open_stream_log(out, info.name, recording_table(info), rate_hz, names)

    assert study.target is not None
    import_module("pyarrow.parquet")  # now: it takes longer than a watchdog waits
    course.ready(todo)
    with watch.progress("measure", len(todo)) as step:
        armed = arm(session, study.target, todo[0].loops, wanted)
        with vented_on_error(session), closing(drive(armed, course.coming(todo), keeper, course.supervisor)) as made:
            for recording in made:
                add_recording(out, recording, again=True)
                adopted(out, recording.info.name)
                course.taken(recording)
                if not course.in_step:
                    step(recording.info.name)


def _refuse_what_only_models_do(study: Study) -> None:

    asked = ["effects"] if study.effects else []
    asked += [f"parameters of experiment {e.name}" for e in study.experiments if e.parameters]
    if asked:
        raise WrongUseError(
            "a real machine has no parameters to be set", ", ".join(asked), "change it by hand, in a study of its own"
        )


def _refuse_signals_beyond_limits(motion: Motion, wanted: Configuration) -> None:
    """Refuse setpoints and excitations that pass a limit by themselves, whatever the loops make of them.

    A setpoint, and what is added to it at the controller's input, against the limits of the loop's output (a sum of
    sensors has the sum of theirs); what enters the plant's input against the span of each command, as the controller
    may add any offset; with open loops the commands are known, their rates too.
    """
    for e in motion.experiments():
        for k, loop in enumerate(e.loops):
            _refuse_references(motion, e.name, loop, e.references[:, k], e.injected[:, k], e.injection)
        if e.injection in ("plant_input", "control"):
            _refuse_commands(motion, e, e.injected @ wanted.mixing.T)


def _refuse_references(
    motion: Motion, name: str, loop: LoopSetup, setpoint: Array, injected: Array, injection: str
) -> None:
    limits = [motion.settings.limits[column] for column in sum_terms(loop.output)]
    limit = Limit(limits[0].column, sum(one.low for one in limits), sum(one.high for one in limits))
    low, high = float(setpoint.min()), float(setpoint.max())
    if not limit.low < low <= high < limit.high:
        raise WrongUseError(
            f"the setpoint of {loop.name} in {name!r} lies outside its limits",
            f"{limit.spoken_value(low if low <= limit.low else high)}, limits {limit}",
            "move the operating point, or widen the limit",
        )
    asked = setpoint + injected
    low, high = float(asked.min()), float(asked.max())
    if injection == "controller_input" and not limit.low <= low <= high <= limit.high:
        raise WrongUseError(
            f"the excitation of {loop.name} in {name!r} asks for what lies outside its limits",
            f"{limit.spoken_value(low if low < limit.low else high)} with its setpoint, limits {limit}",
            "give a smaller amplitude, or widen the limit",
        )


def _refuse_commands(motion: Motion, e: Experiment, asked: Array) -> None:
    """`asked` (samples, commands): what the excitation alone gives each command."""
    for column, values in zip(motion.identity.commands, asked.T, strict=True):
        limit, low, high = motion.settings.limits[column], float(values.min()), float(values.max())
        grain = 1e-9 * (limit.high - limit.low)
        opened = e.injection == "control"
        passed = low < limit.low - grain or high > limit.high + grain if opened else high - low > limit.high - limit.low
        if passed:
            raise WrongUseError(
                f"the excitation in {e.name!r} passes the limits of {column} by itself",
                f"{limit.spoken_value(low)} to {limit.spoken_value(high)}, limits {limit}",
                "give a smaller amplitude, or widen the limit",
            )
        rates = np.abs(values[RATE_TICKS:] - values[:-RATE_TICKS]) * (e.rate_hz / RATE_TICKS)
        if opened and rates.size and rates.max() > limit.rate * (1.0 + 1e-9):
            raise WrongUseError(
                f"the excitation in {e.name!r} changes {column} faster than its limit",
                f"{limit.spoken_value(float(rates.max()))}/s over {RATE_TICKS} ticks, limits {limit}",
                "give a smaller or slower one, or widen the limit",
            )
