"""A real-time target as a rig: each planned experiment is armed, uploaded, run and taken in; safety before data.

`docs/protocol.md` is the specification. A target closes its loops itself; the host watches the same limits, keeps it
alive, and lets it vent whatever ends the host's own program.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from loopshape.channel import sum_terms
from loopshape.errors import LoopshapeError, RigError, WrongUseError
from loopshape.experiment import Experiment, LoopSetup
from loopshape.kernels.noise import start_state
from loopshape.recording import Recording, RecordingInfo
from loopshape.rigs import messages
from loopshape.rigs.frames import Frame
from loopshape.rigs.intake import Intake
from loopshape.rigs.messages import Ask, Configuration, Ended, Identity, Payload, Reason, Say, State
from loopshape.rigs.session import RefusedError, Session
from loopshape.target_settings import TargetSettings
from loopshape.units import Array

INJECTION = {"controller_input": 0, "plant_input": 1, "control": 2, "reference": 0}
GONE = 3  # refusal of samples that are no longer in the target's memory
LISTEN_S = 0.02


def configuration(
    identity: Identity,
    loops: Sequence[LoopSetup],
    settings: TargetSettings,
    rate_hz: float,
    pwm: Mapping[str, float],
) -> Configuration:
    """What the target is to do under a study. Refuses what the target cannot do, and anything without a limit."""
    _fits(identity, loops, settings, rate_hz)
    columns = identity.sensors + identity.commands
    return Configuration(
        outputs=np.array([[float(s in sum_terms(loop.output)) for s in identity.sensors] for loop in loops]),
        mixing=np.array([[settings.commands[u].get(loop.name, 0.0) for loop in loops] for u in identity.commands]),
        sections=tuple(loop.controller.biquads() for loop in loops if loop.controller is not None),
        limits=np.array([[getattr(settings.limits[c], key) for key in ("low", "high", "rate")] for c in columns]),
        hold=settings.on_limit == "hold",
        watchdog_ms=settings.watchdog_ms,
        soft_start_s=settings.soft_start_s,
        pwm_hz=float(pwm.get("frequency_hz", 0.0)) if identity.pwm_hz else 0.0,
        dead_zone=float(pwm.get("dead_zone", 0.0)) if identity.pwm_hz else 0.0,
    )


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
    names = [loop.name for loop in loops]
    for column, parts in settings.commands.items():
        _known(f"loops of {column}", parts, names)
    if len(loops) > identity.most_loops or any(loop.controller is None for loop in loops):
        raise WrongUseError(
            f"the target closes up to {identity.most_loops} loops, each with a controller", ", ".join(names)
        )
    longest = max(len(loop.controller.blocks) for loop in loops if loop.controller is not None)
    if longest > identity.most_sections:
        raise WrongUseError("a controller has more blocks than the target", f"{longest}, {identity.most_sections}")


def _known(what: str, asked: Mapping | set[str], known: Sequence[str]) -> None:
    if strange := sorted(set(asked) - set(known)):
        raise WrongUseError(f"the target has no such {what}", ", ".join(strange), f"it has {', '.join(known)}")


@dataclass(frozen=True, eq=False)
class Armed:
    """A target that is configured and armed: it can be driven."""

    session: Session
    settings: TargetSettings
    configuration: Configuration
    loops: tuple[LoopSetup, ...]

    @property
    def columns(self) -> tuple[str, ...]:
        """Sensors and commands, in the order of limits."""
        return self.session.identity.sensors + self.session.identity.commands


def arm(session: Session, settings: TargetSettings, loops: Sequence[LoopSetup], wanted: Configuration) -> Armed:
    """Configure and arm. From here on the machine may move. Refuses a target that is not idle."""
    status = session.status()
    if status.state is not State.IDLE:
        raise RigError(
            "the target is not idle", status.state.name.lower(), "look at the machine, then `loopshape stop --clear`"
        )
    session.ask(Ask.ARM, session.configure(wanted).to_bytes(4, "little"))
    return Armed(session, settings, wanted, tuple(loops))


def vented(session: Session) -> None:
    """The emergency stop, tried once more where it is not answered; never raises."""
    for _ in range(2):
        try:
            session.ask(Ask.VENT)
            return
        except LoopshapeError:
            continue


def drive(armed: Armed, experiments: Iterable[Experiment]) -> Iterator[Recording]:
    """Record experiment after experiment; whatever ends this loop early vents the machine first.

    A recording that a limit ended is given with what there is and says so; after it nothing more is done on a real
    machine. An emulated one is armed anew.
    """
    done = False
    try:
        for number, experiment in enumerate(experiments, start=1):
            recording, ended = _record(armed, experiment, number)
            yield recording
            if ended.reason is not Reason.COMPLETE and not _again(armed):
                done = True
                return
        armed.session.ask(Ask.DISARM)
        done = True
    finally:
        if not done:
            vented(armed.session)


def _again(armed: Armed) -> bool:
    """After a fault: an emulated machine is armed anew, a real one waits for a person."""
    if not armed.session.identity.emulated:
        return False
    if armed.session.status().state is State.FAULT:
        armed.session.ask(Ask.CLEAR)
        armed.session.ask(Ask.ARM, armed.session.configure(armed.configuration).to_bytes(4, "little"))
    return True


def _record(armed: Armed, e: Experiment, number: int) -> tuple[Recording, Ended]:
    place = armed.settings.place and armed.session.identity.emulated
    _reach(armed, e, place)
    taking = _Taking(armed, e, number)
    armed.session.unasked = taking.told
    try:
        ended = taking.run(place)
    finally:
        armed.session.unasked = lambda frame: None
    return Recording(RecordingInfo.of(e, _why(armed, ended)), e.rate_hz, taking.columns(ended.ticks)), ended


def _reach(armed: Armed, e: Experiment, place: bool) -> None:
    """Move to where the recording starts and rest there; an emulated machine is put there."""
    ramp_s = armed.settings.soft_start_s
    armed.session.ask(Ask.SETPOINT, messages.setpoint(ramp_s, e.references[0].tolist()))
    if place:
        return
    for _ in range(int((ramp_s + armed.settings.settle_s) / _beat_s(armed)) + 1):
        until = armed.session.last_sent_s + _beat_s(armed)
        status = armed.session.status()
        if status.state is not State.ARMED:
            raise RigError(
                f"the target stopped on its way to {e.name!r}", f"{status.state.name.lower()}, reason {status.fault}",
                "look at the machine: is a limit too narrow for the way there?",
            )  # fmt: skip
        armed.session.listen_until(until)


def _beat_s(armed: Armed) -> float:
    """How often the host says that it is alive: four times and more within the watchdog's time."""
    return armed.settings.watchdog_ms / 5e3


class _Taking:
    """One recording while it runs."""

    def __init__(self, armed: Armed, e: Experiment, number: int) -> None:
        self._armed, self._e, self._session = armed, e, armed.session
        self._intake = Intake(number, e.samples, self._session.identity.width(len(armed.loops)))
        self._ended: Ended | None = None
        self._mask, self._rows = _moving(e)
        self._uploaded = 0
        self._acknowledged = 0
        self._alarm: tuple[int, int, float, float] | None = None

    def told(self, frame: Frame) -> None:
        """A frame that came unasked."""
        if frame.type == Say.SAMPLES:
            new = self._intake.take(self._session.samples(frame, len(self._armed.loops)))
            self._watch(len(new))
        elif frame.type == Say.ENDED:
            ended = self._session.ended(frame)
            if ended.run == self._intake.run:
                self._ended = ended

    def _watch(self, new: int) -> None:
        """The host's own look at the limits."""
        places = slice(3 * len(self._armed.loops), None)
        limits = self._armed.configuration.limits
        self._alarm = self._alarm or self._intake.passed(new, places, limits, self._e.rate_hz)

    def run(self, place: bool) -> Ended:
        """Upload, go, take in until the end is told and all of it is here."""
        free = self._begin(place)
        self._upload(free)
        self._session.ask(Ask.GO, self._id)
        while True:
            self._session.listen(LISTEN_S if self._intake.lacking == 0 else 0.0)
            if self._alarm is not None and self._ended is None:
                self._stop_the_blind()
            if self._ended is not None and self._intake.received >= self._ended.ticks:
                self._alive()
                return self._ended
            self._fill()
            self._keep_alive()

    @property
    def _id(self) -> bytes:
        return self._intake.run.to_bytes(4, "little")

    def _begin(self, place: bool) -> int:
        payload = messages.begin(
            self._intake.run,
            self._e.samples,
            INJECTION[self._e.injection],
            self._mask,
            start_state(self._e.seed),
            place,
        )
        return Payload(self._session.ask(Ask.BEGIN, payload)).one("I")

    def _upload(self, free: int) -> None:
        """Send rows while there is room for them."""
        most = messages.rows_a_frame(self._rows.shape[1], self._session.identity.number)
        while free > 0 and self._uploaded < len(self._rows) and self._rows.shape[1]:
            part = self._rows[self._uploaded : self._uploaded + min(most, free)]
            payload = messages.rows(self._intake.run, self._uploaded, part, self._session.identity.number)
            self._uploaded, free = Payload(self._session.ask(Ask.ROWS, payload)).take("II")
            if self._ended is not None:
                return

    def _fill(self) -> None:
        used = self._uploaded - self._intake.received
        free = self._session.identity.buffer_rows - used
        if self._ended is None and self._uploaded < len(self._rows) and free > self._session.identity.buffer_rows // 4:
            self._upload(free)

    def _keep_alive(self) -> None:
        """Say that the host is there and what it has; ask again for what is missing."""
        if self._intake.lacking:
            self._fetch()
        ahead = self._intake.received - self._acknowledged >= self._session.identity.memory_ticks // 4
        if ahead or self._session.silent_s() > _beat_s(self._armed) or self._ended is not None:
            self._alive()

    def _alive(self) -> None:
        status = self._session.status(self._intake.run, self._intake.received)
        self._acknowledged = self._intake.received
        if status.run == self._intake.run:
            self._intake.newest = max(self._intake.newest, min(status.tick, self._e.samples))
        elif self._ended is None:
            raise RigError("the target forgot the recording", f"{self._e.name!r}", "it was restarted: begin anew")

    def _fetch(self) -> None:
        first, lacking = self._intake.received, min(self._intake.lacking, 512)
        payload = self._id + first.to_bytes(4, "little") + lacking.to_bytes(2, "little")
        try:
            self._session.ask(Ask.AGAIN, payload)
        except RefusedError as error:
            if error.code != GONE:
                raise
            raise RigError(
                f"samples of {self._e.name!r} are lost: the target no longer has them",
                f"ticks from {first} on",
                "the recording is not kept; use a faster line, or fewer columns",
            ) from None
        self._session.listen(LISTEN_S)

    def _stop_the_blind(self) -> None:
        """A limit is passed in what arrived and the target has not ended the run: stop it from here."""
        self._session.listen(LISTEN_S)
        if self._ended is None and self._session.status().state is State.RUNNING:
            self._session.ask(Ask.VENT)

    def columns(self, ticks: int) -> dict[str, Array]:
        """The recording's columns, as a run folder has them."""
        table, loops = self._intake.table[:ticks], self._armed.loops
        free = self._e.injection == "control"
        out = {"t_s": np.arange(ticks) / self._e.rate_hz}
        for k, loop in enumerate(loops):
            if loop.reference is not None:
                out[loop.reference] = table[:, k]
            if loop.injected is not None:
                out[loop.injected] = np.zeros(ticks) if free else table[:, len(loops) + k]
            out[loop.control] = table[:, 2 * len(loops) + k]
        return out | {name: table[:, 3 * len(loops) + k] for k, name in enumerate(self._armed.columns)}


def _moving(e: Experiment) -> tuple[int, Array]:
    """Bits of the columns that move, and their rows (n, columns): of loop k r is bit 2k, what is injected 2k + 1."""
    both = [column for k in range(len(e.loops)) for column in (e.references[:, k], e.injected[:, k])]
    still = [float(c[0]) if k % 2 == 0 else 0.0 for k, c in enumerate(both)]
    bits = [k for k, column in enumerate(both) if np.any(column != still[k])]
    rows = np.column_stack([both[k] for k in bits]) if bits else np.empty((e.samples, 0))
    return sum(1 << k for k in bits), rows


def _why(armed: Armed, ended: Ended) -> str | None:
    """Why a recording is shorter than asked: which limit, when, by how much; None where it is whole."""
    if ended.reason is Reason.COMPLETE:
        return None
    word = ended.reason.name.lower().replace("_", " ")
    if ended.index is None or ended.index >= len(armed.columns):
        return f"{word} at tick {ended.tick}{': ' + ended.sentence if ended.sentence else ''}"
    column = armed.columns[ended.index]
    return (
        f"{word} of {column} at tick {ended.tick}: {ended.value:.6g}, by {abs(ended.value - ended.limit):.3g} "
        f"beyond {ended.limit:.6g}"
    )
