"""The emergency stop of a target: loads little, so that it is quick."""

from __future__ import annotations

import os
import signal
from pathlib import Path

from loopshape.core.errors import WrongUseError
from loopshape.toolbox.rig.files.measuring import driver
from loopshape.toolbox.rig.target.link import open_link
from loopshape.toolbox.rig.target.messages import REFUSALS, Request
from loopshape.toolbox.rig.target.session import NO_PLACE, RefusedError, Session

BAUD = 921_600


def stop(what: str | Path, *, clear: bool = False, baud: int = BAUD) -> str:
    """Vent a target at once: through the process that measures into the run folder `what`, or through a port.

    `clear` then clears the fault that this is; gives what was done. Raises RigError where nothing answers, and
    WrongUseError for a fault that is to be cleared through a folder.
    """
    if not Path(what).is_dir():
        return _through(str(what), baud, clear)
    if clear:
        raise WrongUseError("a fault is cleared through the target's port", str(what), "stop it, then name the port")
    return _interrupted(Path(what))


def _interrupted(run: Path) -> str:
    """Interrupt the process that measures into a run; it vents before it ends."""
    pid = driver(run)
    try:
        os.kill(pid, signal.SIGINT)
    except OSError as error:
        raise WrongUseError(
            "the process could not be asked to stop", f"{pid}: {error.strerror}", "name the port"
        ) from None
    return f"process {pid} was asked to stop; it vents the machine before it ends"


def _through(port: str, baud: int, clear: bool) -> str:
    """Vent through a port of our own, and clear the fault that this is, if asked."""
    with open_link(port, baud) as link:
        session = Session(link)
        session.ask(Request.VENT)  # before anything else is asked
        try:
            if clear:
                session.ask(Request.CLEAR)
            state = session.status().state
        except RefusedError as error:
            if clear or error.code != NO_PLACE:
                raise
            return f"vented; {REFUSALS[NO_PLACE]}, which is told"
    return f"vented; the target is in state {state.name.lower()}"
