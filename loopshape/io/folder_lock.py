"""A folder held for one writer: a lock of the system on the folder itself, which ends with the process."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from pathlib import Path

from loopshape.core.errors import WrongUseError
from loopshape.io.files import reading
from loopshape.io.input_guard import settled

_Place = tuple[int, int, int]  # process (a fork holds nothing), device and number of a folder
_HELD: dict[_Place, object] = {}  # what stands for each hold


@contextmanager
def alone(folder: Path) -> Iterator[None]:
    """Hold a run folder for one writer; refuses a second one. The hold ends with the process, however it ends.

    Refuses a folder that is not there or may not be read, and where a file that was read before has changed since.
    """
    handle, place = _open(folder)
    try:
        if place in _HELD or not _locked(handle):
            raise WrongUseError("another process is writing this run", str(folder), "wait for it, or stop it")
        _HELD[place] = object()
        try:
            with settled():
                yield
        finally:
            _HELD.pop(place, None)
    finally:
        os.close(handle)


@contextmanager
def locked(folder: Path) -> Iterator[None]:
    """A single step of writing: within the hold that this process has, or in one of its own."""
    handle, place = _open(folder)
    os.close(handle)
    with nullcontext() if place in _HELD else alone(folder):
        yield


def hold_of(folder: Path) -> object | None:
    """What stands for this process's hold of a folder, another at each time; None where it does not hold it."""
    handle, place = _open(folder)
    os.close(handle)
    return _HELD.get(place)


def _open(folder: Path) -> tuple[int, _Place]:
    """A folder as it is open, and what tells it from all others."""
    with reading(folder, "a run's folder"):
        handle = os.open(folder, os.O_RDONLY | getattr(os, "O_DIRECTORY", 0))
        status = os.fstat(handle)
    return handle, (os.getpid(), status.st_dev, status.st_ino)


def _locked(handle: int) -> bool:
    """Lock an open folder until it is closed; False where another has it. Where there are no such locks, all may."""
    try:
        import fcntl
    except ImportError:
        return True
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError:  # a file system without locks
        return True
    return True


def is_held(folder: Path) -> bool:
    """Whether a process is writing this run."""
    handle, place = _open(folder)
    try:
        return place in _HELD or not _locked(handle)
    finally:
        os.close(handle)
