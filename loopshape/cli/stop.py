"""`loopshape stop`: the emergency stop of a target, from another terminal."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from loopshape.cli.output import AsJson, Output, Quiet


def stop(
    what: Annotated[str, typer.Argument(help="A run folder that is being measured, or a port.", show_default=False)],
    clear: Annotated[bool, typer.Option("--clear", help="Clear a fault: the target goes to idle, vented.")] = False,
    baud: Annotated[int, typer.Option(help="Speed of a serial port.")] = 921_600,
    as_json: AsJson = False,
    quiet: Quiet = False,
) -> None:
    """Vent a target at once: through the process that measures into a run folder, or through a port."""
    from loopshape.core.errors import WrongUseError

    output = Output(as_json, quiet)
    if clear and Path(what).is_dir():
        raise WrongUseError("a fault is cleared through the target's port", what, "stop the run, then name the port")
    how = _interrupted(Path(what)) if Path(what).is_dir() else _through(what, baud, clear)
    output.say(how)
    output.json({"done": how})


def _interrupted(run: Path) -> str:
    """Interrupt the process that measures into a run; it vents before it ends."""
    import os
    import signal

    from loopshape.core.errors import WrongUseError
    from loopshape.io.measuring import driver

    pid = driver(run)
    try:
        os.kill(pid, signal.SIGINT)
    except OSError as error:
        raise WrongUseError(
            "the process could not be told to stop", f"{pid}: {error.strerror}", "name the port"
        ) from None
    return f"process {pid} was told to stop; it vents the machine before it ends"


def _through(port: str, baud: int, clear: bool) -> str:
    """Vent through a port of our own, and clear the fault that this is, if asked."""
    from loopshape.rig.link import open_link
    from loopshape.rig.messages import REFUSALS, Ask
    from loopshape.rig.session import NO_PLACE, RefusedError, Session

    with open_link(port, baud) as link:
        session = Session(link)
        session.ask(Ask.VENT)  # before anything else is asked
        try:
            if clear:
                session.ask(Ask.CLEAR)
            state = session.status().state
        except RefusedError as error:
            if clear or error.code != NO_PLACE:
                raise
            return f"vented; {REFUSALS[NO_PLACE]}, which is told"
    return f"vented; the target is in state {state.name.lower()}"
