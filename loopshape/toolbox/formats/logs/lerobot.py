"""Datasets of LeRobot: Parquet columns whose cells are lists of numbers, an entry a signal, an episode a recording.

The layout is that of `meta/info.json` (codebase_version v2.0, v2.1 and v3.0): `data/chunk-000/episode_000000.parquet`
holds one episode, `data/chunk-000/file-000.parquet` several, told apart by `episode_index`. A signal is
`COLUMN.NAME` by the names that info.json gives the column's entries, `COLUMN[0]` without them, as in any Parquet file.
Source: github.com/huggingface/lerobot, `LeRobotDataset`.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from loopshape.core.errors import BadSignalError, UnreadableInputError
from loopshape.core.units import Array
from loopshape.io.files import reading, short
from loopshape.io.size_limit import check_growth

_INFO = ("meta", "info.json")
_COMMAND, _MEASURED = "action", "observation.state"
_MOST_ENTRIES = 512
_UNITS = (
    "LeRobot states no units: robots write degrees or shares of their range (-100 to 100, grippers 0 to 100, by"
    ' use_degrees), simulators mostly radians. Write for each column of {columns} that stays unit = "deg" or "rad" and'
    ' end its stored name in _rad, or leave unit = "1" for shares; then delete [draft].'
)


@dataclass(eq=False)
class Lists:
    """Signals in columns of lists, each with its column and entry, and what the dataset says beside it."""

    path: Path
    signals: Mapping[str, tuple[str, int]]
    closed: tuple[str, ...] = ()
    rate_hz: float | None = None
    _last: dict[str, Array] = field(default_factory=dict)

    @property
    def questions(self) -> tuple[str, ...]:
        """What a dataset leaves open; nothing of another table."""
        columns = dict.fromkeys(column for column, _ in self.signals.values())
        return () if self.rate_hz is None else (_UNITS.format(columns=" and ".join(columns)),)

    @property
    def remarks(self) -> tuple[str, ...]:
        """What a reader of the draft must know."""
        return () if self.rate_hz is None else (f"the rate is that of {'/'.join(_INFO)}: fps = {self.rate_hz:g}.",)

    @property
    def pairs(self) -> tuple[tuple[str, str], ...]:
        """Control and output of each joint, as the format defines them: entries of `action` and `observation.state`."""
        commands = [] if self.rate_hz is None else [n for n, (column, _) in self.signals.items() if column == _COMMAND]
        pairs = ((name, _MEASURED + name.removeprefix(_COMMAND)) for name in commands)
        return tuple((command, measured) for command, measured in pairs if measured in self.signals)

    def load(self, name: str) -> Array:
        """One entry (n,) of a column, as float64; refuses lists of several lengths."""
        column, entry = self.signals[name]
        if column not in self._last:
            self._last = {column: _table(self.path, column)}
        return self._last[column][:, entry]


def read_lists(path: Path) -> Lists:
    """The columns of lists that a Parquet file has; none for a table of plain columns. Reads the footer and info.json.

    Refuses a damaged file, and an info.json that is no JSON (`UnreadableInputError`).
    """
    import pyarrow as pa
    import pyarrow.parquet as pq

    with reading(path, "Parquet", pa.ArrowException):
        schema = pq.read_schema(path)
    lists = [f.name for f in schema if _is_list(f.type) and _is_number(f.type.value_type)]
    widths = {column: _width(path, column) for column in lists}
    info = _info(path) if lists else {}
    features, fps = info.get("features"), info.get("fps")
    signals: dict[str, tuple[str, int]] = {}
    for column, width in widths.items():
        feature = features.get(column) if isinstance(features, dict) else None
        signals |= {name: (column, k) for k, name in enumerate(_entries(column, width, feature))}
    closed = tuple(f"{name} (lists of several lengths, or over {_MOST_ENTRIES})" for name in lists if not widths[name])
    rate = float(fps) if isinstance(fps, int | float) and 0.0 < fps < np.inf else None
    return Lists(path, signals, closed, rate)


def read_episodes(numbers: Array) -> dict[int, tuple[int, int]]:
    """Rows from one to before another of each episode, where a file holds several; refuses episodes in pieces."""
    starts = np.flatnonzero(np.r_[True, np.diff(numbers) != 0.0])
    names = [int(x) for x in np.nan_to_num(numbers[starts], nan=-1.0)]
    if len(set(names)) != len(names):
        raise BadSignalError(
            "the rows of an episode do not lie together", f"episode_index changes {starts.size - 1} times",
            "sort the file by episode_index and frame_index",
        )  # fmt: skip
    ends = [*starts[1:].tolist(), numbers.size]
    return dict(zip(names, zip(starts.tolist(), ends, strict=True), strict=True)) if len(names) > 1 else {}


def _info(path: Path) -> dict[str, Any]:
    """The dataset's info.json, in one of the folders above a file; empty without one."""
    above = 3  # folders above a file in which info.json is looked for
    for folder in path.absolute().parents[:above]:
        file = folder.joinpath(*_INFO)
        if file.is_file():
            with reading(file, "JSON"):
                found = json.loads(file.read_text(encoding="utf-8"))
            return found if isinstance(found, dict) else {}
    return {}


def _entries(column: str, width: int, feature: Any) -> list[str]:
    """Names of a column's signals: by info.json where it gives each entry one of its own, else by number."""
    names = feature.get("names") if isinstance(feature, dict) else None
    if isinstance(names, dict):  # {"motors": [...]}, as older datasets have it
        names = [name for inner in names.values() if isinstance(inner, list) for name in inner]
    own = isinstance(names, list) and all(isinstance(x, str) and x for x in names)
    if own and isinstance(names, list) and len(set(names)) == len(names) == width:
        return [f"{column}.{name}" for name in names]
    return [f"{column}[{k}]" for k in range(width)]


def _is_list(kind: Any) -> bool:
    import pyarrow as pa

    return bool(pa.types.is_list(kind) or pa.types.is_large_list(kind) or pa.types.is_fixed_size_list(kind))


def _is_number(kind: Any) -> bool:
    import pyarrow as pa

    return bool(pa.types.is_integer(kind) or pa.types.is_floating(kind) or pa.types.is_boolean(kind))


def _width(path: Path, column: str) -> int:
    """How many numbers each cell of a column holds, by the counts of the footer; 0 for no number that fits."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    with reading(path, "Parquet", pa.ArrowException):
        about, numbers = pq.read_metadata(path), 0
        for group in (about.row_group(k) for k in range(about.num_row_groups)):
            inner = (group.column(k) for k in range(group.num_columns))
            numbers += sum(c.num_values for c in inner if c.path_in_schema.rsplit(".", 2)[0] == column)
        check_growth(path, 8 * numbers)
    width, rest = divmod(numbers, max(int(about.num_rows), 1))
    return width if not rest and width <= _MOST_ENTRIES else 0


def _table(path: Path, column: str) -> Array:
    """A column of lists as (rows, entries), float64; missing numbers become NaN."""
    import pyarrow as pa
    import pyarrow.compute as pc
    import pyarrow.parquet as pq

    with reading(path, "Parquet", pa.ArrowException), pq.ParquetFile(path) as file:
        cells = file.read(columns=[column]).column(column)
        lengths = np.array(pc.list_value_length(cells).fill_null(0).to_numpy())
        flat = pc.list_flatten(cells).cast(pa.float64(), safe=False).to_numpy()
    if np.ptp(lengths) or not lengths.all():
        raise UnreadableInputError(
            f"the lists of {short(column)} in {path.name} differ in length, or are empty",
            f"{lengths.min()} to {lengths.max()} numbers", "store lists of one length, or a column for each signal",
        )  # fmt: skip
    table = np.array(flat, dtype=float).reshape(lengths.size, -1)
    table.setflags(write=False)
    return table
