"""Who drives a target into a run folder, and its emergency stop: loads little, so that it is quick.

A mark beside the run names one process and no later one.
"""

from __future__ import annotations

import os
import signal
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from loopshape.core.errors import UnreadableInputError, WrongUseError
from loopshape.io.files import read_json, short, write_json
from loopshape.io.folder_lock import is_held
from loopshape.toolbox.rig.target.link import open_link
from loopshape.toolbox.rig.target.messages import REFUSALS, Request
from loopshape.toolbox.rig.target.session import NO_PLACE, RefusedError, Session

BAUD = 921_600
MARK = ".measuring.json"
_BOOT = Path("/proc/sys/kernel/random/boot_id")


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


@contextmanager
def marked(run: Path, port: str) -> Iterator[None]:
    """Say in a run folder that this process drives which port, while it does."""
    mark = run / MARK
    write_json(mark, {"pid": os.getpid(), "started_at": started_at(os.getpid()), "port": port})
    try:
        yield
    finally:
        with suppress(OSError):
            mark.unlink()


def driver(run: Path) -> int:
    """Number of the process that drives a target into a run.

    Refuses a run that nobody measures into, and a mark that names no process, or one that has ended and whose number
    another may bear by now.
    """
    if not (run / MARK).is_file() or not is_held(run):
        raise WrongUseError("nothing is measured into this run", str(run), "name the port")
    mark = read_json(run / MARK)
    pid = mark.get("pid") if isinstance(mark, dict) else None
    if not isinstance(pid, int) or isinstance(pid, bool) or not 2 <= pid < 2**31:
        raise UnreadableInputError(f"{run / MARK} names no process", short(repr(pid)), "name the port")
    if not (now := started_at(pid)) or now != mark.get("started_at"):
        raise WrongUseError(
            f"{run / MARK} is of a process that has ended",
            f"{pid}, which {'is another process now' if now else 'does not run'}",
            "name the port",
        )
    return pid


def started_at(pid: int) -> str:
    """When a process began, in words that no other process of its number has; "" where none runs."""
    try:
        words = Path(f"/proc/{pid}/stat").read_bytes().rpartition(b")")[2].split()
        return f"{_BOOT.read_text().strip()} {int(words[19])}"  # ticks after this start of the system
    except (OSError, ValueError, IndexError):
        return _asked(pid)


def _asked(pid: int) -> str:
    """The same where there is no /proc."""
    with suppress(OSError, subprocess.SubprocessError):
        words = ["ps", "-p", str(pid), "-o", "lstart="]
        return subprocess.run(words, capture_output=True, text=True, timeout=5.0, check=False).stdout.strip()
    return ""
