"""A recording's table on disk: columns that load when asked for, at a rate that is checked."""

from __future__ import annotations

import json
import threading
import weakref
from collections import OrderedDict
from collections.abc import Callable, Iterator, Mapping
from functools import cached_property
from hashlib import sha256
from pathlib import Path
from typing import IO, Any

import numpy as np

from loopshape.core.errors import UnreadableInputError, WrongUseError
from loopshape.core.json_ready import json_ready
from loopshape.core.stretches import AT_ONCE, LONG, LongSignal, Signal, stretches
from loopshape.core.units import Array
from loopshape.io.csv_text import CsvShape, CsvTable, read_csv_names, read_csv_table
from loopshape.io.files import fill, reading, short
from loopshape.io.input_guard import State, refuse, state_of
from loopshape.io.provenance import file_hash
from loopshape.io.size_limit import check_growth
from loopshape.io.stamps import check_rate

ENDINGS = (".parquet", ".csv", ".csv.gz")
TIME = "t_s"
_ABOUT = "loopshape"  # key of a file's metadata
_LOOKED_AT = 1000  # values of a column, evenly spread, that its packing is chosen by
#: bytes of columns that all tables together keep in memory; those used longest ago are read again when asked for
KEPT_BYTES = 192_000_000


def check_ending(name: str) -> str:
    """The name, if it ends as a table does; refuses others."""
    if not name.endswith(ENDINGS):
        raise WrongUseError("a table's kind is not known", repr(name), f"end it in {', '.join(ENDINGS)}")
    return name


class TableColumns(Mapping[str, Array]):
    """Columns (n,) of a table by name, float64 and read-only, each loaded when it is asked for.

    Those used last are kept, up to `KEPT_BYTES` over all tables: memory does not grow with the recordings of a run.
    Names and length of a Parquet file come from its footer. With `rate_hz` the time column is checked
    before the first column is handed out, and with `sha256` the file. Refuses a file that is damaged or not the one
    that was written (`UnreadableInputError`), a column that is not of numbers, and stamps that do not keep the rate
    (`BadSignalError`). `words` is what else the mark of a recording stands on.
    """

    def __init__(self, path: Path, rate_hz: float | None = None, sha256: str | None = None, words: str = "") -> None:
        self.path = path
        self.rate_hz = rate_hz
        self.sha256 = sha256
        self.words = words
        self.loaded: dict[str, Any] = {}
        self._rate_checked = False
        self._csv_bytes = 0
        check_ending(path.name)

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Names of the columns."""
        names = _parquet_names(self.path) if self._is_parquet else read_csv_names(self.path, CsvShape())
        if len(set(names)) != len(names):
            raise UnreadableInputError(f"{self.path.name} names two columns alike", short(", ".join(names)))
        return tuple(name for name in names if name)

    @cached_property
    def _known(self) -> frozenset[str]:
        return frozenset(self.names)

    @cached_property
    def rows(self) -> int:
        """Number of rows."""
        return _parquet_rows(self.path) if self._is_parquet else len(self._csv.frame)

    @property
    def _is_parquet(self) -> bool:
        return self.path.name.endswith(".parquet")

    @property
    def _csv(self) -> CsvTable:
        found = self.loaded.get("")  # no column is named so
        if found is None:
            found = self.loaded[""] = read_csv_table(self.path, CsvShape())
            self._csv_bytes = int(found.frame.memory_usage().sum())
        _RECENT.used(self, "", self._csv_bytes)
        return found

    @cached_property
    def _state(self) -> State | None:
        """What tells the file from others, at the first look at its rows."""
        return state_of(self.path)

    def _refuse_another(self) -> None:
        if state_of(self.path) != self._state:
            refuse([str(self.path)])

    @cached_property
    def _digests(self) -> tuple[str, str]:
        """SHA-256 of the file, and of the file with its words."""
        self._refuse_another()
        content = file_hash(self.path)
        alone = content.hexdigest()
        content.update(self.words.encode())
        return alone, content.hexdigest()

    @property
    def mark(self) -> str:
        """What tells this table, as it was read, with its words, from every other."""
        return self._digests[1][:16]

    def _check_rate_once(self) -> None:
        if not self._rate_checked and self.sha256 is not None:
            check_sha256(self.path, self._digests[0], self.sha256)
        if not self._rate_checked and self.rate_hz is not None and TIME in self:
            long = LongSignal(self.rows, lambda start, stop: self._stretch(TIME, start, stop))
            check_rate(long if self.rows >= LONG else self._load(TIME), self.rate_hz, self.path.name)
        self._rate_checked = True

    def _load(self, name: str) -> Array:
        values: Array | None = self.loaded.get(name)
        if values is None:
            self._refuse_another()
            values = _parquet_column(self.path, name) if self._is_parquet else self._csv.column(name)
            values.setflags(write=False)
            self.loaded[name] = values
        _RECENT.used(self, name, values.nbytes)
        return values

    def __getitem__(self, name: str) -> Array:
        if name not in self:
            raise KeyError(name)
        self._check_rate_once()
        return self._load(name)

    def stretch(self, name: str, start: int, stop: int) -> Array:
        """Rows start to stop (exclusive) of a column; of Parquet only the groups of rows are read that hold them."""
        self._check_rate_once()
        return self._stretch(name, start, stop)

    def _stretch(self, name: str, start: int, stop: int) -> Array:
        if not self._is_parquet:
            return self._load(name)[start:stop]
        first = np.searchsorted(self._groups, start, side="right") - 1
        last = np.searchsorted(self._groups, max(stop - 1, start), side="right") - 1
        parts = [self._group(name, int(k)) for k in range(first, last + 1)]
        at = int(self._groups[first])
        whole = parts[0] if len(parts) == 1 else np.concatenate(parts)
        return np.asarray(whole[start - at : stop - at])

    @cached_property
    def _groups(self) -> np.ndarray:
        """Rows at which the groups of a Parquet file start."""
        import pyarrow as pa
        import pyarrow.parquet as pq

        with reading(self.path, "Parquet", pa.ArrowException):
            footer = pq.read_metadata(self.path)
            sizes = [footer.row_group(k).num_rows for k in range(footer.num_row_groups)]
        return np.concatenate([[0], np.cumsum(sizes)[:-1]]).astype(int)

    def _group(self, name: str, k: int) -> Array:
        key = f"{name}\0{k}"
        values: Array | None = self.loaded.get(key)
        if values is None:
            values = self.loaded[key] = _parquet_column(self.path, name, k)
            values.setflags(write=False)
        _RECENT.used(self, key, values.nbytes)
        return values

    def __contains__(self, name: object) -> bool:
        return name in self._known

    def __iter__(self) -> Iterator[str]:
        return iter(self.names)

    def __len__(self) -> int:
        return len(self.names)

    def __hash__(self) -> int:
        return id(self)

    def __eq__(self, other: object) -> bool:
        return self is other


class _Recent:
    """Which columns of which tables were used last; what exceeds the bytes kept leaves its table, oldest first."""

    def __init__(self) -> None:
        self._sizes: OrderedDict[tuple[weakref.ref[TableColumns], str], int] = OrderedDict()
        self._lock = threading.Lock()

    def used(self, table: TableColumns, name: str, size: int) -> None:
        """Note a use of a table's column of so many bytes."""
        with self._lock:
            key = (weakref.ref(table), name)
            self._sizes[key] = size
            self._sizes.move_to_end(key)
            while len(self._sizes) > 1 and sum(self._sizes.values()) > KEPT_BYTES:
                (owner, old), _ = self._sizes.popitem(last=False)
                if (there := owner()) is not None:
                    there.loaded.pop(old, None)


_RECENT = _Recent()


def _parquet_names(path: Path) -> tuple[str, ...]:
    import pyarrow as pa
    import pyarrow.parquet as pq

    with reading(path, "Parquet", pa.ArrowException):
        return tuple(pq.read_schema(path).names)


def _parquet_rows(path: Path) -> int:
    import pyarrow as pa
    import pyarrow.parquet as pq

    with reading(path, "Parquet", pa.ArrowException):
        return int(pq.read_metadata(path).num_rows)


def _parquet_column(path: Path, name: str, group: int | None = None) -> Array:
    """A column, or one group of its rows, as float64; missing values become NaN."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    with reading(path, "Parquet", pa.ArrowException), pq.ParquetFile(path) as file:
        check_growth(path, 8 * file.metadata.num_rows)
        whole = file.read(columns=[name]) if group is None else file.read_row_group(group, columns=[name])
        column = whole.column(name)
        kind = column.type
        numbers = pa.types.is_integer(kind) or pa.types.is_floating(kind) or pa.types.is_boolean(kind)
        chunks = column.cast(pa.float64(), safe=False).chunks if numbers else []
        values = np.concatenate([_float64(chunk) for chunk in chunks] or [np.empty(0)])
    if not numbers:
        raise UnreadableInputError(f"column {name} of {path.name} is not of numbers", str(kind), "store it as float64")
    return values


def _float64(chunk: Any) -> Array:
    """An array (n,) of Arrow in numpy, missing values as NaN; its own way there would load pandas."""
    if not len(chunk):
        return np.empty(0)
    known, data = chunk.buffers()
    rows = slice(chunk.offset, chunk.offset + len(chunk))
    values = np.frombuffer(data, dtype=float)[rows]
    if not chunk.null_count:
        return values
    bits = np.unpackbits(np.frombuffer(known, dtype=np.uint8), bitorder="little")
    return np.where(bits[rows] == 1, values, np.nan)


def check_sha256(path: Path, found: str, expected: str) -> None:
    """Refuse a file that is not the one that was written, by its hash."""
    if found != expected:
        raise UnreadableInputError(
            f"{path} is not the file that was written",
            f"sha256 {found[:12]}... in place of {expected[:12]}...",
            "it is damaged: record it again; changed on purpose, take its sha256 out of run.toml",
        )


def write_table(path: Path, columns: Mapping[str, Signal], about: Mapping[str, object] | None = None) -> str:
    """Write columns (n,) as Parquet, float64 bit for bit, whole or not at all; `about` goes into the file's metadata.

    Gives the SHA-256 of the file. Groups of rows are written as they are read. Refuses no columns, and columns that
    are not one-dimensional or differ in length.
    """
    digest, put_in_place = fill_table(path, columns, about)
    put_in_place()
    return digest


def fill_table(
    path: Path, columns: Mapping[str, Signal], about: Mapping[str, object] | None = None
) -> tuple[str, Callable[[], None]]:
    """The first half of `write_table` with the file's SHA-256; the second puts the file in place."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    signals = {
        name: values if isinstance(values, LongSignal) else np.ascontiguousarray(values, dtype=float)
        for name, values in columns.items()
    }
    shapes = {(values.size,) if isinstance(values, LongSignal) else values.shape for values in signals.values()}
    if len(shapes) != 1 or len(next(iter(shapes))) != 1:
        raise WrongUseError(
            f"the columns of {path.name} must be equally long",
            ", ".join(f"{name} ({values.size},)" for name, values in signals.items()) or "no columns",
        )
    metadata = None if about is None else {_ABOUT: json.dumps(json_ready(about))}
    schema = pa.schema([pa.field(name, pa.float64(), nullable=False) for name in signals], metadata=metadata)
    digest = sha256()

    def write(part: Path) -> None:
        with (
            part.open("wb", buffering=1 << 16) as plain,
            pq.ParquetWriter(_Hashed(plain, digest.update), schema, **_packing(signals)) as file,
        ):
            for rows in stretches(*signals.values()):
                columns = [np.ascontiguousarray(x, dtype=float) for x in rows]
                made = [pa.Array.from_buffers(pa.float64(), x.size, [None, pa.py_buffer(x)]) for x in columns]
                file.write_table(pa.table(made, schema=schema), row_group_size=AT_ONCE)

    put_in_place = fill(path, write)
    return digest.hexdigest(), put_in_place


def _packing(signals: Mapping[str, Signal]) -> dict[str, Any]:
    """How columns are packed, by their first rows: what takes least time, with a file not much larger than the least.

    Bytes of one place together pack best, setpoints too. Values that come again and again, as behind a converter, are
    packed as they stand; a dictionary makes them smaller and takes twice as long.
    """
    first = next(stretches(*signals.values()), ())
    batch = 1 << 17  # rows of a column that are packed at once
    return {
        "compression": "lz4",
        "use_dictionary": False,
        "use_byte_stream_split": [n for n, values in zip(signals, first, strict=False) if not _come_again(values)],
        "write_statistics": False,
        "write_batch_size": batch,
    }


def _come_again(values: Array) -> bool:
    """Whether a column takes few values whose last bytes differ too; where these are empty, bytes apart pack better."""
    looked = np.asarray(values[:: max(1, values.size // _LOOKED_AT)], dtype=float)
    few = np.unique(looked).size
    return few == 1 or (few <= _LOOKED_AT // 10 and bool((looked.view(np.uint64) & 0xFFFFFFFF).any()))


class _Hashed:
    """A file that is hashed while it is written, so that it is not read again for that."""

    def __init__(self, file: IO[bytes], update: Callable[[Any], None]) -> None:
        self._file, self._update = file, update
        self.tell, self.flush, self.close = file.tell, file.flush, file.close

    @property
    def closed(self) -> bool:
        """Whether the file is."""
        return self._file.closed

    def write(self, data: Any) -> int:
        """Write and hash some bytes."""
        self._update(data)
        return self._file.write(data)


def read_about(path: Path) -> Mapping[str, object]:
    """What `write_table` noted of a table; empty where nothing is. Refuses a file that is no Parquet."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    with reading(path, "Parquet", pa.ArrowException):
        return dict(json.loads((pq.read_schema(path).metadata or {}).get(_ABOUT.encode(), b"{}")))
