"""What happened to a run, line by line: begun, finished, stopped. A last line torn by a kill does no harm.

The journal is for people and for `verify`; what a run holds stands in `run.toml` alone.
"""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
from contextlib import suppress
from datetime import UTC, datetime
from glob import escape
from pathlib import Path
from typing import Any

from loopshape.core.json_ready import json_ready
from loopshape.io.files import make_folder, reading, write_all, writing
from loopshape.io.input_guard import own

ARRIVING = ".arriving"  # ending of a recording that has not ended
EARLIER = "earlier"  # folder of tables that are not, or no longer, recordings of the run
FILE = "journal.jsonl"
_NO_LINK = getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_NONBLOCK", 0)  # a line is never written elsewhere


def note(folder: Path, event: str, **words: object) -> None:
    """Add a line, on the disk when this returns. Refuses a folder or disk that cannot be written."""
    note_all(folder, event, [words])


def note_all(folder: Path, event: str, several: Sequence[Mapping[str, object]]) -> None:
    """As `note`, of several events of a kind, which wait for the disk once."""
    if not several:
        return
    stamp = {"at": datetime.now(UTC).isoformat(timespec="milliseconds"), "event": event}
    text = "".join(json.dumps(stamp | json_ready(words), ensure_ascii=False) + "\n" for words in several)
    path = folder / FILE
    own(path)
    with writing(path):
        handle = os.open(path, os.O_RDWR | os.O_APPEND | os.O_CREAT | _NO_LINK, 0o644)
        try:
            torn = _torn(handle)
            write_all(handle, ("\n" * torn + text).encode("utf-8", "replace"))
            os.fsync(handle)
        finally:
            os.close(handle)


def _torn(handle: int) -> bool:
    """Whether the last line was not finished."""
    size = os.fstat(handle).st_size
    return size > 0 and os.pread(handle, 1, size - 1) != b"\n"


def read_journal(folder: Path) -> tuple[list[Mapping[str, Any]], int]:
    """The lines that are whole, in order, and how many are not; empty where there is no journal."""
    path = folder / FILE
    if not os.path.lexists(path):
        return [], 0
    with reading(path, "a journal"):
        if not path.is_file():
            raise ValueError("it is no file")
        longest = 64 * 1024 * 1024  # bytes read
        if path.stat().st_size > longest:
            raise ValueError(f"{path.stat().st_size} bytes")
        lines = path.read_bytes().decode("utf-8", "replace").splitlines()
    read: list[Mapping[str, Any]] = []
    for line in lines:
        with suppress(ValueError, RecursionError):
            words = json.loads(line)
            if isinstance(words, dict) and isinstance(words.get("event"), str):
                read.append(words)
    return read, sum(bool(line.strip()) for line in lines) - len(read)


def next_earlier(folder: Path, name: str) -> Path:
    """A path in `earlier` that is free, for a table of this recording."""
    make_folder(folder / EARLIER)
    number = 1
    while any((folder / EARLIER).glob(f"{escape(name)}-{number}.*")):
        number += 1
    return folder / EARLIER / f"{name}-{number}.parquet"
