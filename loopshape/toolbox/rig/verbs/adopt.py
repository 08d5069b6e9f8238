"""Adoption: a new controller takes over on a target share by share, or goes back; or logs alone say whether it may."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

from loopshape.core.errors import LoopshapeError, WrongUseError
from loopshape.core.interrupts import interrupts, unhurried
from loopshape.data.control.controller import Controller
from loopshape.data.requirement.requirements import Requirements
from loopshape.data.response.frf import FRF
from loopshape.io.files import make_folder
from loopshape.io.provenance import KEY, file_sha256, versions
from loopshape.io.run.journal import note
from loopshape.io.run.run_folder import alone, read_run
from loopshape.io.write.controllers import read_controllers
from loopshape.io.write.frfs import FOLDER, has_any, read_frfs
from loopshape.toolbox.rig.adopt.advice import Advised, without_plant
from loopshape.toolbox.rig.adopt.advice import advise as advise_of
from loopshape.toolbox.rig.adopt.blend import track_share
from loopshape.toolbox.rig.adopt.course import Adoption, Step, Trial, TrialSettings, ruled_out
from loopshape.toolbox.rig.adopt.course import adopt as adopt_on
from loopshape.toolbox.rig.adopt.forecast import required
from loopshape.toolbox.rig.adopt.on_target import TRACK_S, OnTarget
from loopshape.toolbox.rig.settings import Confirm
from loopshape.toolbox.rig.simulated import Planned, Rig, plan
from loopshape.toolbox.rig.study import Study
from loopshape.toolbox.rig.target.link import open_link
from loopshape.toolbox.rig.target.messages import Configuration, Request
from loopshape.toolbox.rig.target.session import Session
from loopshape.toolbox.rig.target.target import arm as arm_target
from loopshape.toolbox.rig.target.target import vented_on_error
from loopshape.toolbox.rig.target.trial import Trial as OnBoard
from loopshape.toolbox.rig.verbs.machine import asked_study
from loopshape.toolbox.rig.verbs.on_target import Clearance, loud, planned_motion
from loopshape.toolbox.rig.verbs.stop import marked
from loopshape.verbs.watch import Unwatched, Watch


def adopt(
    run: str | Path,
    controller: Controller | str | Path,
    study: str | Path,
    out: str | Path,
    *,
    port: str | None = None,
    requirements: Sequence[Requirements] = (),
    settings: TrialSettings | None = None,
    controllers: Iterable[Controller] = (),
    arm: bool = False,
    confirm: Confirm | None = None,
    watch: Watch | None = None,
) -> Adoption:
    """Try a new controller on a target that runs an old one, and adopt it where it does what was predicted.

    `run` is a run folder whose FRFs the new `controller` (a noun, or a file that has its loop) was made from; `study`
    names the target, its limits, the old controllers (or `controllers`, by loop) and a multisine that excites the loop.
    Nothing moves without `arm`, or where `confirm` answers True. The target holds both controllers. It is excited under
    the old one first; then the new one takes over in shares (`settings.shares`), each refused beforehand where the sum
    is not surely stable on the measured plant, and each watched by the target itself: it goes back to the old
    controller in the tick in which the error, the control signal, the error's rms over a period or its growth leaves
    what is predicted for this share, and where the host does not go on. The host compares S with the prediction and
    goes on or back. `out` takes a run a share and a journal that says why.

    Requirements decide at the end (default: stable, |S| at most 6 dB). Only "adopted" leaves the new controller in
    charge; the target is disarmed in the end all the same, as after every measurement. Misleads where the machine
    changes after the last recording.

    Raises WrongUseError for a target that does not take trials or was not armed, RigError for a lost line.

    Examples
    --------
    >>> import loopshape as ls
    >>> C = ls.controller(ls.gain(2.0), rate_hz=1000.0, loop="axis")
    >>> try:
    ...     ls.rig.adopt("runs/axis", C, "nowhere.toml", "out")
    ... except ls.LoopshapeError as error:
    ...     print(str(error).split(";")[0])
    a file does not exist
    """
    file, folder, watcher = Path(study), Path(out), watch or Unwatched()
    wanted, plant = asked_study(file, controllers, ())
    trial, planned, before = _trial(Path(run), controller, wanted, plant, requirements, settings)
    target = wanted.target
    if target is None or not (name := port or target.port):
        raise WrongUseError("a trial is done on a target", f"rig = {wanted.rig!r}, port {port!r}", "name its port")
    if (why := ruled_out(trial, before)) is not None:
        watcher.warn([f"refused: {why}"])
        return Adoption.refused(trial, why)
    extra: dict[str, object] = {
        "study_sha256": file_sha256(file),
        KEY: {**versions(), "study": file.name, "seed": wanted.seed},
    }
    with open_link(name, target.baud) as link:
        session = Session(link)
        configured = _configured(session, name, wanted, plant, planned, trial, confirm or (lambda motion: arm))
        make_folder(folder)
        with alone(folder), marked(folder, name), unhurried(), interrupts():
            note(folder, "armed", target=session.identity.board, new=trial.new.digest, old=trial.old.digest)
            machine = OnTarget(
                arm_target(session, replace(target, place=False), planned.loops, configured), wanted, plant, planned,
                folder, extra,
            )  # fmt: skip
            return _tried(trial, machine, before, folder, watcher)


def advise(
    run: str | Path,
    controller: Controller | str | Path,
    *,
    after: str | Path | None = None,
    requirements: Sequence[Requirements] = (),
    settings: TrialSettings | None = None,
) -> Advised:
    """From logs alone, whether a new controller may be tried (or, with `after`, kept): go, no go, or not decidable.

    `run` is a run folder under the old controller, `after` one under the new one. Go: every share of the new controller
    is stable on the measured plant, the requirements hold with their intervals, and a log under the new controller has
    the predicted S and holds them too. No go: the data rule that out. Else not decidable, and `recipe` says what to
    record. Misleads where the plant has changed since the logs: `adopt` measures that first.

    Raises WrongUseError where the run does not know the loop of the controller, or which controller closed it.

    Examples
    --------
    >>> import loopshape as ls
    >>> C = ls.controller(ls.gain(2.0), rate_hz=1000.0, loop="axis")
    >>> try:
    ...     ls.rig.advise("nowhere", C)
    ... except ls.LoopshapeError as error:
    ...     print(str(error).split(";")[0])
    a run is a folder
    """
    whole = read_run(Path(run))
    new = loop_controller(controller, [loop.name for loop in whole.loops])
    old = whole.loop(new.loop).controller
    if old is None:
        raise WrongUseError(
            f"the run does not say which controller closed loop {new.loop!r}", str(run), "write it into its run.toml"
        )
    R, words = required(new.loop, requirements), settings or TrialSettings()
    try:
        before = plants(Path(run), new.loop)
        if not any(P.valid.any() for P in before):
            raise WrongUseError("no frequency of the run's FRFs is valid", str(run))
    except LoopshapeError as error:
        return without_plant(whole, new.loop, str(error))
    if after is None:
        return advise_of(before, old, new, R, words)
    later = Path(after)
    return advise_of(before, old, new, R, words, read_run(later), _later(later, new))


def _later(run: Path, new: Controller) -> tuple[FRF, ...]:
    """FRFs under the new controller; none where nothing excites the loop."""
    with suppress(LoopshapeError):
        return tuple(P for P in plants(run, new.loop) if P.valid.any())
    return ()


def _tried(trial: Trial, machine: OnTarget, before: Sequence[FRF], folder: Path, watcher: Watch) -> Adoption:
    """The trial on an armed target, journaled; whatever ends it early vents, and what is over is disarmed."""

    def report(step: Step) -> None:
        with machine.thinking():
            note(folder, "share", sentence=step.sentence, **step.to_dict())
        (watcher.say if step.outcome is None else lambda line: watcher.warn([line]))(step.sentence)

    session = machine.armed.session
    with vented_on_error(session):
        try:
            found = adopt_on(trial, machine, (), report)
        except LoopshapeError as error:
            note(folder, "fault", message=str(error))
            raise
        if fault := machine.fault():
            found = replace(found, reason=f"{found.reason}; {fault}")
        session.ask(Request.DISARM)
    note(folder, found.outcome.value, reason=found.reason)
    return found


def _trial(
    run: Path, controller: Controller | str | Path, study: Study, plant: Rig, requirements: Sequence[Requirements],
    settings: TrialSettings | None,
) -> tuple[Trial, Planned, tuple[FRF, ...]]:  # fmt: skip
    """What is tried, the recording that tests it, and FRFs of the run at its operating point."""
    new = loop_controller(controller, [loop.name for loop in study.loops] or list(plant.loops))
    fitting = [p for p in plan(study, plant) if p.template.excites == new.loop and not p.template.excites_also]
    planned = next((p for p in fitting if getattr(p.template.excitation, "periods", 0)), None)
    if planned is None:
        raise WrongUseError(
            f"a trial excites its loop, {new.loop!r}, with a multisine", f"{len(study.experiments)} other experiments",
            "add an experiment of the study that does",
        )  # fmt: skip
    loop = next(one for one in planned.loops if one.name == new.loop)
    if loop.controller is None:
        raise WrongUseError(
            f"a trial replaces a plain controller, and loop {new.loop!r} runs another kind", "a schedule or a diagram",
            "give the study a plain controller of this loop",
        )  # fmt: skip
    trial = Trial(loop, loop.controller, new, required(new.loop, requirements), settings or TrialSettings())
    return trial, planned, at_point(plants(run, new.loop), planned.operating_point)


def loop_controller(controller: Controller | str | Path, loops: Sequence[str]) -> Controller:
    """The one controller of a file, or of a noun, that closes one of these loops."""
    found = (controller,) if isinstance(controller, Controller) else read_controllers(Path(controller))
    mine = [one for one in found if one.loop in loops]
    if len(mine) != 1:
        raise WrongUseError(
            "a trial is of one controller of one loop of the study", ", ".join(one.loop for one in found),
            f"loops are {', '.join(loops)}: adopt one after the other",
        )  # fmt: skip
    return mine[0]


def plants(run: Path, loop: str) -> tuple[FRF, ...]:
    """FRFs of a run's loop: those that lie there, else estimated anew. Refuses a run without any."""
    from loopshape.verbs.chain import frfs

    found = read_frfs(run) if has_any(run, FOLDER) else frfs(run, loop)
    mine = tuple(one for one in found if one.loop == loop)
    if not mine:
        raise WrongUseError(f"the run has no FRF of loop {loop!r}", str(run), "measure one: loopshape frf RUN")
    return mine


def at_point(found: Sequence[FRF], point: Any) -> tuple[FRF, ...]:
    """Those at an operating point; all where none is said to be there."""
    return tuple(one for one in found if dict(one.operating_point) == dict(point)) or tuple(found)


def _configured(
    session: Session, port: str, study: Study, plant: Rig, planned: Planned, trial: Trial, confirm: Confirm
) -> Configuration:  # fmt: skip
    """The target's configuration with both controllers, confirmed. Refuses a target that takes no second one."""
    if not session.identity.trials:
        raise WrongUseError(
            "the target runs no second controller beside a loop's own", f"{session.identity.board}",
            "build it anew from this version's sources",
        )  # fmt: skip
    motion, wanted = planned_motion(session, port, study, plant, [planned], Clearance())
    changed = [replace(x, controller=trial.new) if x.name == trial.loop.name else x for x in planned.loops]
    notes = [f"the new controller: {line}" for line in loud(session, changed, wanted, False)]
    rate_hz = session.identity.rate_hz
    shares = ", ".join(f"{100.0 * share:g}" for share in trial.settings.shares)
    notes.append(f"loop {trial.loop.name} then runs a new controller in shares of {shares} %, each recorded")
    if not confirm(replace(motion, notes=(*motion.notes, *notes))):
        raise WrongUseError("no motion", "no word to arm", "look at what it will do, then give arm=True")
    place = [one.name for one in planned.loops].index(trial.loop.name)
    own = OnBoard(place, trial.new.biquads(), track_share(trial.new, rate_hz, TRACK_S))
    return replace(wanted, trial=own)
