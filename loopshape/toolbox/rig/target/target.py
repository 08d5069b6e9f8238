"""A real-time target as a rig: each planned experiment is armed, uploaded, run and taken in; safety before data.

`docs/protocol.md` is the specification. A target closes its loops itself; the host watches the same limits, keeps it
alive, and lets it vent whatever ends the host's own program.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterable, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from itertools import count

import numpy as np

from loopshape.core.errors import RigError, WrongUseError
from loopshape.core.units import Array
from loopshape.data.signal.channel import sum_terms
from loopshape.data.signal.experiment import Experiment, LoopSetup
from loopshape.data.signal.recording import Recording, RecordingInfo
from loopshape.toolbox.diagrams.wired import Wired
from loopshape.toolbox.rig.settings import TargetSettings, decoupling_matrix
from loopshape.toolbox.rig.steps.supervisor import Supervisor
from loopshape.toolbox.rig.target import messages
from loopshape.toolbox.rig.target.acquisition import KEPT_REASONS, Acquisition, Arrived
from loopshape.toolbox.rig.target.armed import Armed as Armed
from loopshape.toolbox.rig.target.armed import arm as arm
from loopshape.toolbox.rig.target.armed import beat_s, reason_words
from loopshape.toolbox.rig.target.armed import vented as vented
from loopshape.toolbox.rig.target.armed import vented_on_error as vented_on_error
from loopshape.toolbox.rig.target.blocks import Block, blocks
from loopshape.toolbox.rig.target.messages import Configuration, Ended, Identity, Reason, Request, Response, State
from loopshape.toolbox.rig.target.scheduling import Scheduling


def configuration(
    identity: Identity,
    loops: Sequence[LoopSetup],
    settings: TargetSettings,
    rate_hz: float,
    pwm: Mapping[str, float],
    diagram: Wired | None = None,
) -> Configuration:
    """What the target is to do under a study. Refuses what the target cannot do, and anything without a limit."""
    made, given = blocks(diagram, loops, rate_hz) if diagram else ((), {})
    _takes(identity, loops, made)
    _fits(identity, loops, settings, rate_hz)
    _holds(identity, loops, made, given)
    columns = identity.sensors + identity.commands
    return Configuration(
        outputs=np.array([[float(s in sum_terms(loop.output)) for s in identity.sensors] for loop in loops]),
        mixing=_mixing(identity, loops, settings),
        sections=_controllers(loops, given),
        limits=np.array([[getattr(settings.limits[c], key) for key in ("low", "high", "rate")] for c in columns]),
        hold=settings.on_limit == "hold",
        watchdog_ms=settings.watchdog_ms,
        soft_start_s=settings.soft_start_s,
        pwm_hz=float(pwm.get("frequency_hz", 0.0)) if identity.pwm_hz else 0.0,
        dead_zone=float(pwm.get("dead_zone", 0.0)) if identity.pwm_hz else 0.0,
        blocks=made,
    )


def _controllers(loops: Sequence[LoopSetup], given: Mapping[str, int]) -> tuple[Array | Scheduling | int, ...]:
    names = [loop.name for loop in loops]
    made: list[Array | Scheduling | int] = []
    for loop in loops:
        if loop.name in given:
            made.append(given[loop.name])
        elif loop.schedule is not None:
            made.append(Scheduling.of(loop.schedule, names))
        elif loop.controller is not None:
            made.append(loop.controller.biquads())
    return tuple(made)


def _mixing(identity: Identity, loops: Sequence[LoopSetup], settings: TargetSettings) -> Array:
    """From the controllers' outputs to the commands: the decoupling first, then the study's sums."""
    sums = [[settings.commands[u].get(loop.name, 0.0) for loop in loops] for u in identity.commands]
    return np.asarray(np.array(sums) @ decoupling_matrix(loops))


def _fits(identity: Identity, loops: Sequence[LoopSetup], settings: TargetSettings, rate_hz: float) -> None:
    if identity.rate_hz != rate_hz:
        raise WrongUseError(
            "the target runs at another rate than the study", f"{identity.rate_hz:g} and {rate_hz:g} Hz", "set rate_hz"
        )
    needed = {term for loop in loops for term in sum_terms(loop.output)}
    _known("outputs", needed, identity.sensors)
    _known("commands", settings.commands, identity.commands)
    _known("limits", settings.limits, identity.sensors + identity.commands)
    for what, given in (("commands", settings.commands), ("limits", settings.limits)):
        all_of = identity.commands if what == "commands" else identity.sensors + identity.commands
        if missing := [column for column in all_of if column not in given]:
            raise WrongUseError(
                f"the study has not all {what} that the target needs", f"none for {', '.join(missing)}", "write them"
            )
    for column, (low, high) in zip(identity.sensors + identity.commands, identity.ranges, strict=False):
        limit = settings.limits[column]
        if limit.low < low or limit.high > high:
            raise WrongUseError(
                f"the limits of {column} lie beyond its range, and limit nothing",
                str(limit),
                f"write limits within {limit.spoken_value(low)} to {limit.spoken_value(high)}",
            )
    for column, parts in settings.commands.items():
        _known(f"loops of {column}", parts, [loop.name for loop in loops])


def _takes(identity: Identity, loops: Sequence[LoopSetup], made: Sequence[Block]) -> None:
    """Refuse kinds of controllers that the target does not take."""
    build = "build the target anew from this version's sources, or give plain controllers"
    if made and not identity.blocks:
        raise WrongUseError("the target takes no block diagram", f"{len(made)} blocks", build)
    if (scheduled := [loop.name for loop in loops if loop.schedule is not None]) and not identity.schedules:
        raise WrongUseError("the target takes no schedule", ", ".join(scheduled), build)


def _holds(identity: Identity, loops: Sequence[LoopSetup], made: Sequence[Block], given: Mapping[str, int]) -> None:
    """Refuse more loops or blocks than the target has room for, and a loop without a controller."""
    each = [1 if loop.name in given else _blocks(loop) for loop in loops]
    if len(loops) > identity.most_loops or not all(each):
        raise WrongUseError(
            f"the target closes up to {identity.most_loops} loops, each with a controller",
            ", ".join(loop.name for loop in loops),
            "leave loops out, or give each a controller",
        )
    if (longest := max([*each, *(len(one.sections) for one in made)])) > identity.most_sections:
        raise WrongUseError(
            "a controller has more blocks than the target computes", f"{longest}, {identity.most_sections}", "use fewer"
        )


def _blocks(loop: LoopSetup) -> int:
    """Blocks of a loop's controller; 0 where it has none."""
    one = loop.controller if loop.schedule is None else loop.schedule.controllers[0]
    return 0 if one is None else len(one.blocks)


def _known(what: str, asked: Mapping | set[str], known: Sequence[str]) -> None:
    if strange := sorted(set(asked) - set(known)):
        raise WrongUseError(f"the target has no such {what}", ", ".join(strange), f"it has {', '.join(known)}")


Keeper = Callable[[RecordingInfo, float, Sequence[str]], AbstractContextManager[Arrived]]


def _no_keeper(info: RecordingInfo, rate_hz: float, columns: Sequence[str]) -> AbstractContextManager[Arrived]:
    return nullcontext(lambda rows: None)


def drive(
    armed: Armed,
    experiments: Iterable[Experiment],
    keeper: Keeper = _no_keeper,
    supervise: Callable[[Experiment], Supervisor | None] = lambda e: None,
) -> Generator[Recording, None, None]:
    """Record experiment after experiment; whatever ends this loop early vents the machine first.

    `keeper` is told of each recording as it begins, and is given its columns as they arrive. What `supervise` gives
    for an experiment may end it: its excitation stops and the loops stay closed, or the machine vents.

    A recording that a limit ended is given with what there is and says so; after it nothing more is done on a real
    machine. An emulated one is armed anew.
    """
    beat, coming = beat_s(armed), iter(experiments)
    with vented_on_error(armed.session):
        for number in count(1):
            with armed.session.kept_alive(beat):
                experiment = next(coming, None)
                supervisor = None if experiment is None else supervise(experiment)
            if experiment is None:
                break
            recording, ended = record(armed, experiment, number, keeper, supervisor)
            with armed.session.kept_alive(beat):
                yield recording
            if ended.reason not in (Reason.COMPLETE, Reason.STOPPED) and not _again(armed):
                if armed.configuration.hold:
                    vented(armed.session)  # loops stay closed only while a host is there
                return
        armed.session.ask(Request.DISARM)


def _again(armed: Armed) -> bool:
    """After a fault: an emulated machine is armed anew, a real one waits for a person."""
    if not armed.session.identity.emulated:
        return False
    if armed.session.status().state is State.FAULT:
        armed.session.ask(Request.CLEAR)
        armed.session.ask(Request.ARM, armed.session.configure(armed.configuration))
    return True


def record(
    armed: Armed, e: Experiment, number: int, keeper: Keeper, supervisor: Supervisor | None
) -> tuple[Recording, Ended]:
    """One experiment, and how it ended; `number` is new for the target."""
    place = armed.settings.place and armed.session.identity.emulated
    _extremes(armed, e, place)
    arrived: list[Arrived] = []
    acquisition = Acquisition(armed, e, number, lambda rows: arrived[0](rows), supervisor)
    with keeper(RecordingInfo.of(e), e.rate_hz, acquisition.names) as append:
        arrived.append(append)
        try:
            ended = acquisition.run(place)
        finally:
            armed.session.unasked = lambda frame: None
    stopped = supervisor is not None and supervisor.trip is not None
    if (ended.reason not in KEPT_REASONS and not stopped) or ended.ticks == 0:
        raise RigError(
            f"{e.name!r} is not kept: the target ended it", str(_why(armed, ended)), "the same command goes on with it"
        )
    why = supervisor.why if stopped and supervisor and ended.reason not in KEPT_REASONS else _why(armed, ended)
    return Recording(RecordingInfo.of(e, why), e.rate_hz, acquisition.columns(ended.ticks)), ended


def _extremes(armed: Armed, e: Experiment, place: bool) -> None:
    """Move to where the recording starts and rest there; an emulated machine is put there."""
    ramp_s = armed.settings.soft_start_s
    armed.session.ask(Request.SETPOINT, messages.setpoint(ramp_s, e.references[0].tolist()))
    if place:
        return
    endings: list[Ended] = []
    armed.session.unasked = lambda f: endings.append(armed.session.ended(f)) if f.type == Response.ENDED else None
    ended_s = 0.3  # in which a target says why it stopped: it repeats that every 0.2 s
    for _ in range(int((ramp_s + armed.settings.settle_s) / beat_s(armed)) + 1):
        until = armed.session.last_sent_s + beat_s(armed)
        status = armed.session.status()
        if status.state is not State.ARMED:
            armed.session.listen_until(armed.session.last_sent_s + ended_s)
            which = [f", {_why(armed, ended)}" for ended in endings[-1:]] or [reason_words(status.fault)]
            raise RigError(
                f"the target stopped on its way to {e.name!r}",
                f"{status.state.name.lower()}{which[0]}",
                "look at the machine: is a limit too narrow for the way there?",
            )
        armed.session.listen_until(until)


def _why(armed: Armed, ended: Ended) -> str | None:
    """Why a recording is shorter than asked: which limit, when, by how much; None where it is whole."""
    if ended.reason is Reason.COMPLETE:
        return None
    word = ended.reason.name.lower().replace("_", " ")
    if ended.index is None or ended.index >= len(armed.columns):
        return f"{word} at tick {ended.tick}{': ' + ended.sentence if ended.sentence else ''}"
    column = armed.columns[ended.index]
    spoken_value = f"; {ended.sentence}" if ended.sentence.startswith("the target") else ""
    unit = "/s" if ended.reason is Reason.RATE_LIMIT else ""
    value, beyond, limit = (
        armed.settings.limits[column].spoken_value(one) + unit
        for one in (ended.value, abs(ended.value - ended.limit), ended.limit)
    )
    when = f"tick {ended.tick} ({ended.tick / armed.session.identity.rate_hz:.3f} s)"
    return f"{word} of {column} at {when}: {value}, by {beyond} beyond {limit}{spoken_value}"
