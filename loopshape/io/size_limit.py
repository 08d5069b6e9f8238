"""How much a file may grow while it is read: a small one that would fill the memory is refused before it does."""

from __future__ import annotations

import io
import zipfile
from gzip import GzipFile
from pathlib import Path
from typing import IO


def most_bytes(path: Path) -> int:
    """What a file may hold once it is unpacked."""
    free = 256 * 1024 * 1024  # bytes that any file may grow to
    times = 64  # its own size; recordings that hold noise shrink to a tenth at the best
    return max(free, times * path.stat().st_size)


def check_growth(path: Path, held_bytes: int) -> None:
    """Raise `ValueError` for a file that holds far more than its size can carry."""
    if held_bytes > most_bytes(path):
        raise ValueError(f"{path.stat().st_size} bytes that would become {held_bytes}")


def check_zip(path: Path) -> None:
    """`check_growth` of all that a ZIP file (NPZ) says it holds; what is read from it is never more."""
    with zipfile.ZipFile(path) as file:
        check_growth(path, sum(member.file_size for member in file.infolist()))


class Bounded(io.RawIOBase):
    """A stream that raises `ValueError` where it goes on for longer than its file can carry."""

    def __init__(self, path: Path, stream: IO[bytes] | GzipFile) -> None:
        super().__init__()
        self._stream, self._left, self._most = stream, most_bytes(path), most_bytes(path)

    def readable(self) -> bool:
        """It can."""
        return True

    def readinto(self, buffer: bytearray | memoryview) -> int:  # type: ignore[override]
        """The next bytes."""
        data = self._stream.read(len(buffer))
        self._left -= len(data)
        if self._left < 0:
            raise ValueError(f"it would become more than {self._most} bytes")
        buffer[: len(data)] = data
        return len(data)

    def close(self) -> None:
        """Close the stream beneath too."""
        self._stream.close()
        super().close()
