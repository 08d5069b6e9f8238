"""Measurement: the rig of a study is driven, and what it did is written as a run, recording by recording."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import MISSING, dataclass, fields, replace
from pathlib import Path
from typing import Any

from loopshape.core.errors import WrongUseError, refuse_unknown
from loopshape.core.interrupts import interrupts
from loopshape.data.control.controller import Block, Controller
from loopshape.data.control.scheduled import Scheduled
from loopshape.data.requirement.requirements import Requirements
from loopshape.data.signal.run import Run
from loopshape.io.provenance import KEY, file_sha256, versions
from loopshape.io.run.run_folder import add_recording, alone, finished, read_run, start_run, whole
from loopshape.toolbox.diagrams.wired import Wired
from loopshape.toolbox.rig import registry
from loopshape.toolbox.rig.described import DescribedRig
from loopshape.toolbox.rig.effects import asked
from loopshape.toolbox.rig.files.study import read_study
from loopshape.toolbox.rig.settings import Confirm, Motion
from loopshape.toolbox.rig.simulated import Rig, header, plan
from loopshape.toolbox.rig.simulated import measure as recordings
from loopshape.toolbox.rig.steps.course import Course
from loopshape.toolbox.rig.steps.enough import Until, until_of
from loopshape.toolbox.rig.steps.escalation import Escalation
from loopshape.toolbox.rig.study import Study, merged_effects
from loopshape.toolbox.rig.target.link import open_link
from loopshape.toolbox.rig.target.messages import Identity
from loopshape.toolbox.rig.target.session import Session
from loopshape.toolbox.rig.verbs.on_target import Clearance, motion_of, record_on_target
from loopshape.toolbox.rig.verbs.stop import BAUD, stop
from loopshape.verbs.watch import Unwatched, Watch


def measure(
    study: str | Path,
    out: str | Path,
    *,
    controllers: Iterable[Controller | Scheduled] = (),
    decoupling: Mapping[str, Mapping[str, float]] | None = None,
    diagram: Wired | None = None,
    effects: Sequence[str] = (),
    port: str | None = None,
    arm: bool = False,
    again: bool = False,
    states: bool = False,
    verdict: str | Path | None = None,
    allow_unverified: bool = False,
    escalate: float | bool = False,
    until: Until | float | Sequence[Requirements] | None = None,
    confirm: Confirm | None = None,
    watch: Watch | None = None,
) -> Run:
    """Record what is missing of a study (a TOML file) into the run folder `out`, and give the run.

    The rig is the one that the study names: a simulation, or a target over a wire, which moves only with `arm`, or
    where `confirm` answers True to what it is about to do. A target vents whatever ends this early. Every finished
    recording is kept; the same call goes on with the rest, and with `again` makes anew what ended early.

    `controllers`, schedules among them, replace those of the study by loop; `decoupling` are the weights of all
    controllers in what enters the plant, by loop (`ls.diagrams.decouple(...).weights`); `diagram` runs on a target in
    place of the controllers of the loops whose control it gives; `effects`, words NAME or NAME=MAGNITUDE,
    are added to a simulation; `port` replaces the study's; `states` records a simulation's true states. `watch` is told
    of progress.

    `verdict` is a file of `loopshape check --save-verdict`: where it does not pass the very controllers of a target's
    loops, or a diagram is unstable by itself, nothing moves unless `allow_unverified`. What is not verified, and that
    it was allowed, stands in the notes of the motion and in the run's journal.

    With `escalate` the amplitude rises step by step from so many percent of the study's (True: as its `[escalate]`
    says), each step judged before the next, and the recording is made at the largest that keeps away from the
    `[limits]`, or is accurate enough; the journal keeps every step. `until` ends a recording by itself: a relative std
    of S in every octave, or requirements (`ls.read_requirements`) on which the verdict is then decided.

    Raises WrongUseError for a study that the rig cannot do and for a target that was not armed, RigError for a lost
    line, `StoppedAtLimitError` where a real machine passed a limit. Ctrl-C raises KeyboardInterrupt with what is kept.
    """
    file, folder, watcher = Path(study), Path(out), watch or Unwatched()
    wanted, plant = asked_study(file, controllers, effects)
    course = Course(wanted, plant, folder, watcher, _escalation(wanted, escalate), until_of(until))
    if decoupling is not None:
        wanted = replace(wanted, decoupling=decoupling)
    wanted = _with_diagram(wanted, diagram)
    extra: dict[str, object] = {
        **({"diagram": diagram.to_dict()} if diagram else {}),
        "study_sha256": file_sha256(file),
        KEY: {**versions(), "study": file.name, "seed": wanted.seed},
    }
    if files := wanted.extra.get("files"):
        extra["files_sha256"] = dict(files)
    if wanted.rig == "target":
        may = confirm or (lambda motion: arm)
        cleared = Clearance(None if verdict is None else Path(verdict), allow_unverified)
        record_on_target(wanted, course, extra, cleared, port=port, confirm=may, again=again)
        return read_run(folder)
    return _simulate(wanted, course, extra, again=again, states=states)


def _simulate(study: Study, course: Course, extra: dict[str, object], *, again: bool, states: bool) -> Run:
    """Record what is missing of a study on the simulated rig, and give the run."""
    plant, folder = course.plant, course.folder
    todo = plan(study, plant)
    done = frozenset((whole if again else finished)(folder))
    start_run(folder, header(study, plant, extra))
    with alone(folder), interrupts(), course.watch.progress("measure", len(todo) - len(done)) as step:
        try:
            if not course.plain:
                for e in course.coming([planned for planned in todo if planned.name not in done]):
                    add_recording(folder, made := course.simulated(e, states), again=again)
                    course.taken(made)
                    step(made.info.name)
                return read_run(folder)
            for recording in recordings(study, plant, done=done, states=states):
                add_recording(folder, recording, again=again)
                step(recording.info.name)
        except KeyboardInterrupt:
            kept = f"interrupted; what {folder / 'run.toml'} lists is kept, the same command goes on"
            raise KeyboardInterrupt(kept) from None
        return read_run(folder)


def _escalation(study: Study, asked: float | bool) -> Escalation | None:
    if asked is False:
        return None
    own = study.escalation or Escalation()
    return own if asked is True else replace(own, start_percent=float(asked))


@dataclass(frozen=True)
class Target:
    """A real-time target at a port: what it is, what it would do, and what it does once that is allowed.

    The line is open only while something is asked, so that the emergency stop (`stop`, or `ls.rig.stop` of another
    process) finds it free.
    """

    port: str
    baud: int
    identity: Identity

    def __enter__(self) -> Target:
        return self

    def __exit__(self, *error: object) -> None:
        """Nothing is held: every verb vents and closes by itself."""

    def state(self) -> str:
        """The word for its state, as "idle", "armed" or "fault"."""
        with open_link(self.port, self.baud) as link:
            return Session(link).status().state.name.lower()

    def show(
        self,
        study: str | Path,
        *,
        controllers: Iterable[Controller | Scheduled] = (),
        diagram: Wired | None = None,
        verdict: str | Path | None = None,
        allow_unverified: bool = False,
    ) -> Motion:
        """What it would do in a study (a TOML file): limits, and each recording with its signals; nothing moves."""
        wanted, plant = asked_study(Path(study), controllers, ())
        cleared = Clearance(None if verdict is None else Path(verdict), allow_unverified)
        return motion_of(_with_diagram(wanted, diagram), plant, self.port, cleared)

    def measure(self, study: str | Path, out: str | Path, *, arm: bool = False, **options: Any) -> Run:
        """`ls.rig.measure` on this target; it moves only with `arm`, or where `confirm` answers True."""
        return measure(study, out, port=self.port, arm=arm, **options)

    def stop(self, *, clear: bool = False) -> str:
        """Vent it at once; `clear` then clears the fault that this is. Gives what was done."""
        return stop(self.port, clear=clear, baud=self.baud)


def connect(port: str, *, baud: int = BAUD) -> Target:
    """The target at a port ("tcp://127.0.0.1:4040", a pseudo-terminal, "/dev/ttyACM0"), once it has said what it is.

    Raises RigError where nothing answers.

    Examples
    --------
    >>> import loopshape as ls
    >>> try:
    ...     ls.rig.connect("tcp://127.0.0.1:9")
    ... except ls.LoopshapeError as error:
    ...     print(str(error).split(";")[0])
    no target answers there
    """
    with open_link(port, baud) as link:
        return Target(port, baud, Session(link).identity)


@contextmanager
def emulator(
    changes: Mapping[str, float] | None = None,
    at: Mapping[str, float] | None = None,
    *,
    rate_hz: float | None = None,
    board: str | None = None,
) -> Iterator[str]:
    """A target without a machine, for trying out a measurement; gives the port, ends with the block.

    A simulated arm at 1000 Hz behind the protocol: `changes` are parameters of the arm, `at` is where it stands, by the
    names of its point; needs a C compiler, once. `board="cortex_m"`: the firmware for a Cortex-M4F with a motor axis in
    it, at 2000 Hz, under qemu-system-arm. Raises WrongUseError for another board or a rate that it does not run at.
    """
    from loopshape.toolbox.rig import cortex_m
    from loopshape.toolbox.rig.emulator import Emulator, running
    from loopshape.toolbox.rig.emulator import board as board_of

    if board is not None:
        started = cortex_m.chosen(board, 0, rate_hz, {"changes": changes, "at": at})
    else:
        started = running(Emulator(board_of().plant_file(changes, at, rate_hz or 1000.0), tcp=0))
    with started as (_, port):
        yield port


def asked_study(
    file: Path, controllers: Iterable[Controller | Scheduled], effects: Sequence[str]
) -> tuple[Study, Rig]:  # fmt: skip
    """A study with what replaces its own, and its plant."""
    study = read_study(file)
    refuse_unknown("a rig is not known", study.rig, ("simulated", "target"))
    plant = DescribedRig(study.loops) if study.loops else registry.plant(study.plant)
    study = replace(study, effects=merged_effects(study.effects, asked(plant, effects)))
    return with_controllers(study, controllers), plant


def _with_diagram(study: Study, diagram: Wired | None) -> Study:
    """The study with a diagram in place of controllers; refuses one for a simulation."""
    if diagram is not None and study.rig != "target":
        raise WrongUseError(
            "a simulated rig runs a controller in each loop, no diagram", f"rig = {study.rig!r}",
            "measure on a target, the emulator's too, or simulate the diagram with models: ls.diagrams.simulate",
        )  # fmt: skip
    return replace(study, diagram=diagram)


def ended_early(run: Run) -> list[str]:
    """What of a run ended early, a sentence each."""
    return [f"{r.info.name}: {r.info.ended_early}" for r in run.recordings if r.info.ended_early]


def with_controllers(study: Study, controllers: Iterable[Controller | Scheduled]) -> Study:
    """The study with these controllers and schedules in place of its own, by loop."""
    given = tuple(controllers)
    blocks = blocks_of((one for one in given if isinstance(one, Controller)), study.rate_hz)
    scheduled = {one.loop: one for one in given if isinstance(one, Scheduled)}
    for one in scheduled.values():
        blocks_of(one.controllers[:1], study.rate_hz)
    kept = {loop: one for loop, one in study.schedules.items() if loop not in blocks}
    return replace(study, controllers={**study.controllers, **blocks}, schedules={**kept, **scheduled})


def blocks_of(controllers: Iterable[Controller], rate_hz: float) -> dict[str, tuple[Block, ...]]:
    """Blocks by loop; refuses another rate, and what the simulated rig does not run otherwise."""
    found = tuple(controllers)
    for one in found:
        settings = [f for f in fields(one) if f.default is not MISSING]
        if other := [f.name for f in settings if getattr(one, f.name) != f.default]:
            raise WrongUseError(
                f"the simulated rig runs plain Tustin in double precision, and loop {one.loop!r} asks for more",
                ", ".join(f"{name} = {getattr(one, name)!r}" for name in other),
                "leave that out of the file that it is simulated with",
            )
        if one.rate_hz != rate_hz:
            raise WrongUseError(
                f"the controller of loop {one.loop!r} runs at another rate than the study",
                f"{one.rate_hz:g} and {rate_hz:g} Hz",
                "tune it on FRFs recorded at the study's rate",
            )
    return {one.loop: one.blocks for one in found}
