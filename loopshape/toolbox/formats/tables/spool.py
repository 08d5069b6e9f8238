"""Columns of a long file of text while it is imported: numbers in a nameless file that ends with the process."""

from __future__ import annotations

import tempfile
from bisect import bisect_right
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from loopshape.core.stretches import LongSignal
from loopshape.core.units import Array


class Spool:
    """Columns of one length on disk, written a stretch after the other and read anywhere; 8 bytes a number.

    `beside` is a folder on the disk to be used, None for that of temporary files.
    """

    def __init__(self, columns: int, beside: Path | None = None) -> None:
        self._file = tempfile.TemporaryFile(dir=beside)  # noqa: SIM115 - it lives as long as its signals
        self._columns = columns
        self._starts: list[int] = []
        self.rows = 0

    def add(self, stretch: Sequence[Array]) -> None:
        """Append a stretch of each column, (k,) each."""
        self._starts.append(self.rows)
        self.rows += stretch[0].size
        self._file.seek(0, 2)
        for values in stretch:
            self._file.write(np.ascontiguousarray(values, dtype=float).tobytes())

    def signal(self, column: int) -> LongSignal:
        """A column, counted from 0."""
        return LongSignal(self.rows, lambda start, stop: self._read(column, start, stop))

    def _read(self, column: int, start: int, stop: int) -> Array:
        parts, ends = [np.empty(0)], [*self._starts[1:], self.rows]
        for k in range(max(bisect_right(self._starts, start) - 1, 0), len(ends)):
            first, end = self._starts[k], ends[k]
            if first >= stop:
                break
            low, high = max(start, first), min(stop, end)
            self._file.seek(8 * (first * self._columns + column * (end - first) + low - first))
            parts.append(np.frombuffer(self._file.read(8 * (high - low))))
        return np.concatenate(parts)

    def __del__(self) -> None:
        self._file.close()
