"""The door that every file passes before it is read: a regular file, and the same one until the command ends.

A command notes what tells each file that it reads from any other. Before it writes, and when it ends, these files must
be the same: what another process put in their place meanwhile is noticed, and no result is written of two states.
"""

from __future__ import annotations

import os
import stat
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from threading import Lock
from typing import NoReturn

from loopshape.core.errors import UnreadableInputError

State = tuple[int, int, int, int]

_SPECIAL = (
    (stat.S_ISFIFO, "a pipe"), (stat.S_ISSOCK, "a socket"), (stat.S_ISCHR, "a device"), (stat.S_ISBLK, "a device"),
)  # fmt: skip
_noted: dict[str, State] | None = None  # by absolute path; None while no command runs
_once: dict[str, State] | None = None  # of files that are read whole and not again
_counting = Lock()
_alone = 0  # holds of run folders: what lies in them cannot change


@contextmanager
def noting() -> Iterator[None]:
    """Note every file that is read within. A notice within a notice is the outer one."""
    global _noted
    if _noted is not None:
        yield
        return
    _noted = {}
    try:
        yield
    finally:
        _noted = None


@contextmanager
def read_once() -> Iterator[dict[str, State]]:
    """Files read within are read whole and not again: what changes later is told (`changed`) and not refused."""
    global _once
    outer, _once = _once, {}
    try:
        yield _once
    finally:
        for path in _once:
            own(Path(path))
        _once = outer


def changed(files: Mapping[str, State]) -> list[str]:
    """Those of the files that are no longer as they were read."""
    return [path for path, state in files.items() if state_of(path) != state]


@contextmanager
def settled() -> Iterator[None]:
    """While a run is held for this writer: what was read before is still so, and nobody changes it."""
    refuse_changed()
    _count_alone(1)
    try:
        yield
    finally:
        _count_alone(-1)


def _count_alone(more: int) -> None:
    """One hold more or less, by whichever thread."""
    global _alone
    with _counting:
        _alone += more


def look(path: Path) -> None:
    """Before a file is read: refuse what is no file (a pipe waits for ever), note it, refuse it where it changed.

    A path that is not there, or that may not be looked at, passes: its reader says so.
    """
    try:
        status = os.stat(path)
    except (OSError, ValueError):
        return
    for is_kind, kind in _SPECIAL:
        if is_kind(status.st_mode):
            raise UnreadableInputError(f"{path} is no file", kind, "copy its content into a file and name that")
    if not stat.S_ISREG(status.st_mode):
        return
    state = _state(status)
    if _once is not None:
        _once.setdefault(os.path.abspath(path), state)
    if _noted is None or _alone:
        return
    if _noted.setdefault(os.path.abspath(path), state) != state:
        refuse([str(path)])


def own(path: Path) -> None:
    """A file that this process itself writes or removes: its change is no news."""
    if _noted is not None:
        _noted.pop(os.path.abspath(path), None)


def refuse_changed() -> None:
    """Refuse to go on where a file that was read is no longer the same: changed, replaced or gone."""
    if _noted is None or _alone:
        return
    if paths := changed(_noted):
        refuse(paths)


def refuse(paths: list[str]) -> NoReturn:
    """Refuse to go on: these files are not those that were read."""
    further = f" and {len(paths) - 3} more" if len(paths) > 3 else ""
    raise UnreadableInputError(
        "files were changed by another process after they were read",
        ", ".join(paths[:3]) + further,
        "what was made of them no longer holds: run the command again",
    )


def state_of(path: str | Path) -> State | None:
    """What tells a file from any other, None where there is none: device, number, bytes, time of the last change."""
    try:
        return _state(os.stat(path))
    except OSError:
        return None


def _state(status: os.stat_result) -> State:
    return status.st_dev, status.st_ino, status.st_size, status.st_mtime_ns
