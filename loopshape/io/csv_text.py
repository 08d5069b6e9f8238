"""CSV files: separator, header, and columns of numbers, with the row that is wrong."""

from __future__ import annotations

import csv
import gzip
import io
import re
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import IO, TYPE_CHECKING

import numpy as np

from loopshape.core.errors import UnreadableInputError
from loopshape.core.units import Array
from loopshape.io.files import reading, short
from loopshape.io.size_limit import Bounded

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True)
class CsvShape:
    """How a CSV file is laid out; `separator` " " takes any run of blanks.

    `skip_rows` lines stand above the header, `unit_rows` between it and the first row.
    """

    separator: str = ","
    header: bool = True
    skip_rows: int = 0
    decimal: str = "."
    unit_rows: int = 0
    encoding: str = "utf-8-sig"


@dataclass(frozen=True, eq=False)
class CsvTable:
    """A CSV file in memory; `names` are stripped of blanks, or "1", "2", ... without a header."""

    path: Path
    names: tuple[str, ...]
    frame: pd.DataFrame

    @cached_property
    def _places(self) -> dict[str, int]:
        return {name: k for k, name in enumerate(self.names)}

    def column(self, name: str) -> Array:
        """A column (n,) of numbers, empty cells NaN; refuses a cell that is no number, naming its row."""
        import pandas as pd

        raw = self.frame.iloc[:, self._places[name]]
        values = np.asarray(pd.to_numeric(raw, errors="coerce"), dtype=float)
        bad = np.flatnonzero(np.isnan(values) & raw.notna().to_numpy())
        if bad.size:
            raise UnreadableInputError(
                f"column {name} of {self.path.name} holds {bad.size} cells that are not numbers",
                f"{short(raw.iloc[bad[0]], 40)!r} in row {raw.index[bad[0]]}",
                _cure(str(raw.iloc[bad[0]]), bad.size, int(raw.index[bad[0]])),
            )
        return values

    def stamps(self, name: str, clock: str) -> Array:
        """A column (n,) of stamps written as text, in s since its first row; refuses what `clock` does not read.

        `clock` is "iso" (dates and times as ISO 8601 writes them), "clock" (hours:minutes:seconds, or a number with
        sec, min or hr behind it), or a format of `datetime.strptime`. A comma stands for the point of the seconds.
        """
        import pandas as pd

        raw = self.frame.iloc[:, self._places[name]].astype(str).str.strip()
        with reading(self.path, f"a file whose column {name} holds stamps {clock!r}"):
            if clock == "clock":
                spans = pd.to_timedelta(raw.str.replace(",", ".", regex=False))
            else:
                text = raw.str.replace(",", ".", regex=False) if clock == "iso" else raw
                dates = pd.to_datetime(text, format="ISO8601" if clock == "iso" else clock, utc=True)
                spans = dates - dates.iloc[0]
            return np.asarray((spans - spans.iloc[0]).dt.total_seconds(), dtype=float)


_A_TIME = re.compile(r"\d{1,4}[-./]\d\d?[-./]\d{1,4}[T ].*|\d\d?:\d\d:\d\d.*")


def _cure(cell: str, count: int, row: int) -> str:
    """What to do about a cell that is no number: a stamp, a unit under the header, or another separator."""
    if _A_TIME.fullmatch(cell.strip()):
        return 'stamps written as text are read by time = { from = "...", unit = "s", clock = "iso" }'
    if count == 1 and row == 0:
        return "a row of units below the header is passed over by unit_rows = 1 in [csv]"
    return "repair the file, or say its separator and decimal sign"


def read_csv_names(path: Path, shape: CsvShape) -> tuple[str, ...]:
    """Names in the header, without the rest of the file; refuses one that has none or names two alike."""
    return _header(path, shape)[0] if shape.header else ()


def read_csv_table(path: Path, shape: CsvShape) -> CsvTable:
    """The whole file; refuses rows that have more cells than the header or the row before."""
    if path.suffix == ".gz":  # to its end: a table takes many times the room of its text
        with reading(path, "CSV"), bytes_of(path) as packed:
            while packed.read(1 << 20):
                pass
    return next(csv_stretches(path, shape, None))


def csv_stretches(path: Path, shape: CsvShape, rows: int | None) -> Iterator[CsvTable]:
    """The file so many rows at a time, or at once (None); refuses as `read_csv_table` does, when it comes there."""
    import pandas as pd

    names, lines = _header(path, shape) if shape.header else ((), _skipped(path, shape))
    _refuse_empty(path, lines, shape.encoding)
    with reading(path, "CSV"), bytes_of(path) as file:
        frames = pd.read_csv(
            file,
            sep=r"\s+" if shape.separator == " " else shape.separator,
            header=None,
            skiprows=lines,
            decimal=shape.decimal,
            skipinitialspace=True,
            skip_blank_lines=False,
            encoding=shape.encoding,
            low_memory=False,
            iterator=True,
        )
        while True:
            try:
                frame = frames.read(rows)
            except StopIteration:
                return
            yield _table(path, names, frame)
            if rows is None:
                return


def _refuse_empty(path: Path, lines: int, encoding: str) -> None:
    """Refuse a file that ends with its header."""
    with reading(path, "CSV"), _open(path, encoding) as file:
        _skip(file, lines)
        if not file.read(1):
            raise UnreadableInputError(
                f"{path.name} holds a header and no rows" if lines else f"{path.name} is empty",
                f"{lines} lines", "record again, or name another file",
            )  # fmt: skip


def _table(path: Path, names: tuple[str, ...], frame: pd.DataFrame) -> CsvTable:
    if names and len(names) != frame.shape[1]:
        raise UnreadableInputError(
            f"the header of {path.name} names {len(names)} columns",
            f"rows of {frame.shape[1]} cells",
            "say its separator, or repair the header",
        )
    return CsvTable(path, names or tuple(str(i + 1) for i in range(frame.shape[1])), frame)


def _header(path: Path, shape: CsvShape) -> tuple[tuple[str, ...], int]:
    """Names, and how many lines lie above the first row."""
    with reading(path, "CSV", csv.Error), _open(path, shape.encoding) as file:
        skipped = _skip(file, shape.skip_rows)
        if shape.separator == " ":
            cells, lines = file.readline().split(), 1
        else:
            reader = csv.reader(file, delimiter=shape.separator, skipinitialspace=True)
            cells, lines = next(reader, []), reader.line_num
    if not cells and not path.stat().st_size:
        raise UnreadableInputError(f"{path.name} is empty", "0 bytes", "record again, or name another file")
    names = tuple(cell.strip() for cell in cells)
    given = [name for name in names if name]
    if not given or len(set(given)) != len(given):
        raise UnreadableInputError(
            f"the header of {path.name} must give each column a name of its own",
            short(", ".join(names)) or "nothing",
            "repair the header",
        )
    return names, skipped + lines + shape.unit_rows


def _skipped(path: Path, shape: CsvShape) -> int:
    with reading(path, "CSV"), _open(path, shape.encoding) as file:
        return _skip(file, shape.skip_rows + shape.unit_rows)


def _skip(file: IO[str], lines: int) -> int:
    """Pass over lines; gives how many there were."""
    for k in range(lines):
        if not file.readline():
            return k
    return lines


def _open(path: Path, encoding: str) -> IO[str]:
    return io.TextIOWrapper(bytes_of(path), encoding=encoding, newline="")


def bytes_of(path: Path) -> IO[bytes]:
    """The file's bytes; of a packed one as they are unpacked, and no more than its size can carry."""
    if path.suffix == ".gz":
        return io.BufferedReader(Bounded(path, gzip.open(path)))
    return path.open("rb")
