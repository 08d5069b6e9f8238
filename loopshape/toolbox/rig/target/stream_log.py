"""A recording as it arrives from a rig: rows appended and checksummed, so that what came survives what ends the rest.

`NAME.arriving` is a line of JSON (format, recording, rate_hz, columns), then blocks: rows u32, CRC-32 u32, then rows x
columns f64, little-endian. Each CRC goes on from the one before, the first from the line's: the blocks up to the first
that does not fit are whole and in order. What was not adopted as a recording is kept in the folder `earlier`.
"""

from __future__ import annotations

import json
import os
import struct
import threading
import zlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import numpy as np

from loopshape.core.errors import UnreadableInputError
from loopshape.core.units import Array
from loopshape.io.files import reading, write_all, writing
from loopshape.io.run.journal import ARRIVING, EARLIER, next_earlier, note
from loopshape.io.run.tables import TIME, write_table

FORMAT = "loopshape-arriving/1"
_BLOCK = struct.Struct("<II")

Append = Callable[[Mapping[str, Array]], None]


@contextmanager
def open_stream_log(
    folder: Path, name: str, about: Mapping[str, Any], rate_hz: float, columns: Sequence[str]
) -> Iterator[Append]:
    """Open `NAME.arriving` for one recording; gives what appends rows: columns (k,) by name.

    The file stays, however this ends: `adopted` removes it, `keep_arrived` keeps what is in it. Refuses one that is
    there already, and a disk that cannot be written.
    """
    path = folder / f"{name}{ARRIVING}"
    head = {"format": FORMAT, "recording": dict(about), "rate_hz": rate_hz, "columns": list(columns)}
    line = json.dumps(head).encode() + b"\n"
    over = threading.Event()
    with writing(path):
        handle = os.open(path, os.O_WRONLY | os.O_APPEND | os.O_CREAT | os.O_EXCL, 0o644)
    thread = threading.Thread(target=_sync_now_and_then, args=(handle, over), daemon=True)
    thread.start()
    try:
        with writing(path):
            write_all(handle, line)
        check = zlib.crc32(line)

        def append(rows: Mapping[str, Array]) -> None:
            nonlocal check
            table = np.column_stack([rows[column] for column in columns]).astype("<f8")
            data = table.tobytes()
            check = zlib.crc32(data, check)
            with writing(path):
                write_all(handle, _BLOCK.pack(len(table), check) + data)

        yield append
    finally:
        over.set()
        thread.join()
        os.close(handle)


def _sync_now_and_then(handle: int, over: threading.Event) -> None:
    """Beside the recording, which waits for no disk; once more at its end."""
    ended = False
    sync_s = 1.0  # a power cut costs no more than this
    while not ended:
        ended = over.wait(sync_s)
        with suppress(OSError):
            os.fsync(handle)


def read_arriving(path: Path) -> tuple[dict[str, Any], dict[str, Array]]:
    """Head, and columns (n,) up to the first block that is torn or changed. Refuses a file without a whole head."""
    with reading(path, "a recording as it arrived"):
        data = path.read_bytes()
        longest_head = 1024 * 1024  # bytes
        line, end, _ = data[:longest_head].partition(b"\n")
        head = json.loads(line)
        names, width = list(head["columns"]), len(head["columns"])
        if head["format"] != FORMAT or not end or not all(isinstance(name, str) for name in names):
            raise ValueError("it has another format")
    tables, place, check = [np.empty((0, width))], len(line) + 1, zlib.crc32(line + end)
    while place + _BLOCK.size <= len(data):
        count, noted = _BLOCK.unpack_from(data, place)
        block = data[place + _BLOCK.size : place + _BLOCK.size + 8 * width * count]
        check = zlib.crc32(block, check)
        if len(block) < 8 * width * count or check != noted:
            break
        tables.append(np.frombuffer(block, "<f8").reshape(count, width))
        place += _BLOCK.size + len(block)
    table = np.vstack(tables)
    return head, {name: table[:, k] for k, name in enumerate(names)}


def adopted(folder: Path, name: str) -> None:
    """The recording is in the run: what arrived of it is no longer needed."""
    with suppress(FileNotFoundError):
        (folder / f"{name}{ARRIVING}").unlink()


def keep_arrived(folder: Path) -> list[tuple[Path, int]]:
    """Make a table in `earlier` of each recording that arrived in part; gives their paths and ticks."""
    kept = []
    for path in sorted(folder.glob(f"*{ARRIVING}")):
        name = path.name.removesuffix(ARRIVING)
        try:
            head, columns = read_arriving(path)
        except UnreadableInputError as error:  # not even its head: kept as it is
            os.replace(path, to := next_earlier(folder, name).with_suffix(ARRIVING))
            note(folder, "kept", recording=name, file=f"{EARLIER}/{to.name}", message=str(error))
            continue
        ticks = len(next(iter(columns.values()), ()))
        if ticks:
            to = next_earlier(folder, name)
            about = {"recording": head["recording"], "arrived": f"{ticks} ticks; the recording did not end"}
            write_table(to, {TIME: np.arange(ticks) / float(head["rate_hz"]), **columns}, about)
            note(folder, "kept", recording=name, file=f"{EARLIER}/{to.name}", ticks=ticks)
            kept.append((to, ticks))
        path.unlink()
    return kept
