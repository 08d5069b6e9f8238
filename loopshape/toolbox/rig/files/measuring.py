"""Who drives a target into a run folder: a mark beside the run, which names one process and no later one."""

from __future__ import annotations

import os
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from loopshape.core.errors import UnreadableInputError, WrongUseError
from loopshape.io.files import read_json, short, write_json
from loopshape.io.folder_lock import is_held

MARK = ".measuring.json"
_BOOT = Path("/proc/sys/kernel/random/boot_id")


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
