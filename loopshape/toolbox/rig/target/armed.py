"""A target that is armed: how it gets there, and how it is vented whatever ends the host's program."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass

from loopshape.core.errors import LoopshapeError, RigError
from loopshape.data.signal.experiment import LoopSetup
from loopshape.toolbox.rig.settings import TargetSettings
from loopshape.toolbox.rig.target.messages import Configuration, Reason, Request, State
from loopshape.toolbox.rig.target.session import RefusedError, Session


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
    """Configure and arm. From here on the machine may move. Refuses a real target that is not idle."""
    status = session.status()
    if status.state is not State.IDLE and session.identity.emulated:
        session.ask(Request.DISARM)
        status = session.status()
        if status.state is State.FAULT:
            session.ask(Request.CLEAR)
            status = session.status()
    if status.state is not State.IDLE:
        raise RigError(
            "the target is not idle",
            f"{status.state.name.lower()}{reason_words(status.fault)}",
            "look at the machine, then `loopshape stop PORT --clear`",
        )
    ready = session.configure(wanted)
    session.watched(settings.watchdog_ms)
    refused = None
    with vented_on_error(session):
        try:
            session.ask(Request.ARM, ready)
        except RefusedError as error:  # it is still idle: there is nothing to vent
            refused = error
    if refused is not None:
        raise refused
    return Armed(session, settings, wanted, tuple(loops))


def reason_words(fault: int) -> str:
    """Words for the fault in a status."""
    return f", {Reason(fault).name.lower().replace('_', ' ')}" if fault in list(Reason)[1:] else ""


def vented(session: Session) -> None:
    """The emergency stop, tried once more where it is not answered; never raises."""
    session.vented = True
    for _ in range(2):
        try:
            session.ask(Request.VENT)
            return
        except LoopshapeError:
            continue


@contextmanager
def vented_on_error(session: Session) -> Iterator[None]:
    """Whatever ends this block early, an interrupt too, vents the machine first, once."""
    session.vented = False
    try:
        yield
    except BaseException:
        if not session.vented:
            vented(session)
        raise


def beat_s(armed: Armed) -> float:
    """How often the host says that it is alive: four times and more within the watchdog's time."""
    return armed.settings.watchdog_ms / 5e3
