"""Other people's files: the arrays that a text, MAT, Parquet, NPZ, JSON or measurement system's file holds, by name."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import chain
from pathlib import Path

import numpy as np

from loopshape.core.errors import UnreadableInputError, WrongUseError
from loopshape.core.stretches import AT_ONCE, LONG, LongSignal, Signal
from loopshape.core.toolboxes import found, function_at
from loopshape.core.units import Array
from loopshape.io.csv_text import CsvShape, csv_stretches, read_csv_table
from loopshape.io.files import reading, short
from loopshape.io.run.tables import TableColumns
from loopshape.io.size_limit import check_zip
from loopshape.toolbox.formats.frf.frf_uff import read_uff_histories, uff_units
from loopshape.toolbox.formats.logs.blackbox import rates_in_deg, read_blackbox
from loopshape.toolbox.formats.logs.dataflash import read_dataflash
from loopshape.toolbox.formats.logs.lerobot import read_episodes, read_lists
from loopshape.toolbox.formats.logs.mat5 import read_mat5_tree
from loopshape.toolbox.formats.logs.mat73 import mat73_array, mat73_long, read_mat73
from loopshape.toolbox.formats.logs.mat_tree import refuse_closed
from loopshape.toolbox.formats.logs.mdf4 import TIME_OF, Arrays, mdf_array, mdf_names, mdf_units
from loopshape.toolbox.formats.logs.messages import read_bag, read_mcap
from loopshape.toolbox.formats.logs.tdms import read_tdms, tdms_units
from loopshape.toolbox.formats.logs.ulog import read_ulog
from loopshape.toolbox.formats.tables.plain_arrays import read_json_arrays, read_wav
from loopshape.toolbox.formats.tables.spool import Spool

_TEXT = (".csv", ".csv.gz", ".txt", ".tsv", ".dat", ".lvm", ".asc", ".log", ".prn")
#: cures for files that are not read
_OTHERS = {
    **dict.fromkeys((".xlsx", ".xls", ".ods"), "save the sheet as CSV; "),
    **dict.fromkeys((".npy", ".pkl", ".pickle"), "write the arrays by name with numpy.savez; "),
    ".toml": "name the recording first and the map behind --map; ",
    ".trace": "save the trace as text (.txt) in the editor that recorded it; ",
}
_MDF = (".mf4", ".mdf")
#: readers of formats whose arrays are read all at once
_WHOLE: dict[str, Callable[[Path], dict[str, np.ndarray]]] = {
    ".ulg": read_ulog, ".tdms": read_tdms, ".json": read_json_arrays, ".wav": read_wav, ".bin": read_dataflash,
    **dict.fromkeys((".bbl", ".bfl"), read_blackbox),
    **dict.fromkeys((".uff", ".unv"), read_uff_histories),
    ".mcap": read_mcap, ".bag": read_bag, ".db3": read_bag,
}  # fmt: skip
#: units that a format's own fields state, by name
_STATED: dict[str, Callable[[Path, Mapping[str, np.ndarray]], Mapping[str, str]]] = {
    ".tdms": lambda path, arrays: tdms_units(path),
    **dict.fromkeys((".uff", ".unv"), lambda path, arrays: uff_units(path)),
    **dict.fromkeys((".bbl", ".bfl"), lambda path, arrays: rates_in_deg(arrays)),
}


def _whole() -> dict[str, Callable[[Path], dict[str, np.ndarray]]]:
    """Readers of whole files by ending: ours, and those of toolboxes of others for endings that we do not read."""
    others = {ending: place for one in found().toolboxes.values() for ending, place in one.readers.items()}
    return {ending: partial(_of_others, place) for ending, place in others.items()} | _WHOLE


def _of_others(place: str, path: Path) -> dict[str, np.ndarray]:
    with reading(path, f"{path.suffix} (read by {place})"):
        return {str(name): np.asarray(values) for name, values in function_at(place)(path).items()}


def _no_units(path: Path, arrays: Mapping[str, np.ndarray]) -> Mapping[str, str]:
    return {}


#: bytes of a file of text from which on it is read a stretch at a time; packed ones count four times
LONG_TEXT = 200_000_000


@dataclass(frozen=True)
class Place:
    """Where a signal stands: an array's name, and its column or row (from 1) where it has two dimensions.

    `clock` says how stamps are written that are text (`CsvTable.stamps`).
    """

    name: str | None
    column: int | None = None
    row: int | None = None
    clock: str | None = None


@dataclass(frozen=True, eq=False)
class Source:
    """A file's arrays by name; `numbered` says that it is a table without a header, whose names are 1, 2, ...

    `long` gives those that are too long to be loaded, and None for others; `stated` the units that the format's own
    fields state, `closed` names of what the file holds and is not read; `remarks` and `questions` are of the format,
    for a draft. `pieces` are the recordings of a file that holds several, by number, each of rows from one to before
    another; `pairs` and `rate_hz` which signals are control and output of a loop, and the rate, by the format.
    """

    path: Path
    names: tuple[str, ...]
    load: Callable[[str], np.ndarray]
    numbered: bool = False
    long: Callable[[str], LongSignal | None] = lambda name: None
    stamps: Callable[[str, str], Array] | None = None
    stated: Callable[[], Mapping[str, str]] = dict
    closed: Sequence[str] = ()
    remarks: Sequence[str] = ()
    questions: Sequence[str] = ()
    pieces: Mapping[int, tuple[int, int]] = field(default_factory=dict)
    pairs: Sequence[tuple[str, str]] = ()
    rate_hz: float | None = None

    def signal(self, place: Place) -> Signal:
        """The signal (n,) at a place, as float64; refuses a place that is not there, naming what is."""
        name = str(place.column) if self.numbered else place.name
        if place.clock is not None and name in self.names:
            return self._stamps(str(name), place.clock)
        alone = self.numbered or (place.column is None and place.row is None)
        if name in self.names and alone and (long := self.long(str(name))) is not None:
            return long
        if self.numbered:
            return _numbers(self.path, place.name or "", self.load(self._numbered_name(place)))
        if place.name not in self.names:
            raise WrongUseError(
                f"{self.path.name} holds nothing of this name",
                repr(place.name) if place.name is not None else "no from",
                f"it holds {short(', '.join(self.names), 400)}" + self._hint(),
            )
        return _pick(_numbers(self.path, place.name, self.load(place.name)), place, self.path.name)

    def units(self) -> dict[str, str]:
        """The units that the format states, by name; stamps that a format brings itself are in s."""
        return {name: "s" for name in self.names if name.startswith(TIME_OF)} | dict(self.stated())

    def piece(self, number: int) -> Source:
        """One of the recordings that the file holds, as a source of its own."""
        first, last = self.pieces[number]

        def long(name: str) -> LongSignal | None:
            whole = self.long(name)
            return None if whole is None else LongSignal(last - first, lambda a, b: whole[first + a : first + b])

        return replace(self, load=lambda name: self.load(name)[first:last], long=long, pieces={})

    def _stamps(self, name: str, clock: str) -> Array:
        if self.stamps is None:
            raise WrongUseError(
                f"{self.path.name} is not read for stamps written as text", f"clock = {clock!r}",
                "text files below 200 MB are: write the stamps as numbers",
            )  # fmt: skip
        return self.stamps(name, clock)

    def _hint(self) -> str:
        one = self.names[0] if len(self.names) == 1 else ""
        return "; a single column: say its separator in [csv]" if any(c in one for c in ";\t ") else ""

    def _numbered_name(self, place: Place) -> str:
        if place.name is not None or place.row is not None or str(place.column) not in self.names:
            raise WrongUseError(
                f"a column of {self.path.name}, which has no header, is picked by its number",
                short(place),
                f"write column = 1 to {len(self.names)}, and no from",
            )
        return str(place.column)


def _numbers(path: Path, name: str, values: np.ndarray) -> Array:
    if values.dtype.kind not in "biuf":
        raise WrongUseError(
            f"{name} of {path.name} is not an array of real numbers", f"{values.dtype}", "pick another or convert it"
        )
    return np.array(values, dtype=float)


def _pick(values: Array, place: Place, file: str) -> Array:
    """One signal (n,) of an array; (n, 1) and (1, n) need no column or row."""
    if values.ndim < 2 or (values.ndim == 2 and 1 in values.shape and place.column is None and place.row is None):
        if place.column is not None or place.row is not None:
            raise WrongUseError(f"{place.name} of {file} has one dimension", "a column or row", "leave it out")
        return values.ravel()
    number, axis = (place.column, 1) if place.column is not None else (place.row, 0)
    if values.ndim != 2 or (place.column is not None and place.row is not None):
        number = None
    if number is None or not 1 <= number <= values.shape[axis]:
        raise WrongUseError(
            f"{place.name} of {file} is an array of {' x '.join(map(str, values.shape))}",
            f"column {place.column}, row {place.row}",
            "pick one signal of a two-dimensional array by column or by row, counted from 1",
        )
    if values.shape[1 - axis] < values.shape[axis]:
        across, along = ("column", "row") if axis == 1 else ("row", "column")
        raise WrongUseError(
            f"{place.name} of {file} is an array of {' x '.join(map(str, values.shape))}: its signals lie in {along}s",
            f"{across} {number}, which holds {values.shape[1 - axis]} numbers", f"pick one by {along} = N",
        )  # fmt: skip
    return np.ascontiguousarray(values[:, number - 1] if axis == 1 else values[number - 1])


def open_source(
    path: Path, shape: CsvShape, wanted: Sequence[Place] | None = None, beside: Path | None = None
) -> Source:
    """The arrays of a file, by its ending; nothing is unpickled. `shape` is for text files.

    Of a long file of text only the places `wanted` are read, onto the disk of the folder `beside`.

    Refuses an unknown ending, and a missing or damaged file (`UnreadableInputError`).
    """
    name = path.name.lower()
    if name.endswith(_TEXT):
        if wanted is not None and _is_long_text(path):
            return _long_csv_source(path, shape, wanted, beside)
        return _csv_source(path, shape)
    if name.endswith(".mat"):
        return _mat_source(path)
    if name.endswith(".npz"):
        return _npz_source(path)
    if name.endswith(".parquet"):
        return _parquet_source(path)
    if name.endswith(_MDF):
        names, closed = mdf_names(path)
        return Source(path, names, lambda name: mdf_array(path, name), stated=lambda: mdf_units(path), closed=closed)
    if (whole := _whole().get(path.suffix.lower())) is not None:
        arrays = whole(path)
        stated = _STATED.get(path.suffix.lower(), _no_units)
        about = arrays if isinstance(arrays, Arrays) else Arrays({})
        return Source(
            path, tuple(arrays), arrays.__getitem__, stated=lambda: {**about.units, **stated(path, arrays)},
            closed=about.closed, remarks=about.remarks,
        )  # fmt: skip
    raise UnreadableInputError(
        "a file of this kind is not read", str(path),
        _OTHERS.get(path.suffix.lower(), "")
        + f"use {', '.join((*_TEXT, '.mat', '.npz', '.parquet', *_MDF, *_whole()))}",
    )  # fmt: skip


def is_text(path: Path) -> bool:
    """Whether a file is one of text, by its ending."""
    return path.name.lower().endswith(_TEXT)


def _csv_source(path: Path, shape: CsvShape) -> Source:
    table = read_csv_table(path, shape)
    names = tuple(name for name in table.names if name)
    return Source(path, names, table.column, numbered=not shape.header, stamps=table.stamps)


def _is_long_text(path: Path) -> bool:
    with reading(path, "a file of text"):
        return path.stat().st_size * (4 if path.suffix == ".gz" else 1) >= LONG_TEXT


def _long_csv_source(path: Path, shape: CsvShape, wanted: Sequence[Place], beside: Path | None) -> Source:
    """Columns that are wanted, on disk; a name that is not there is refused when it is asked for."""
    blocks = csv_stretches(path, shape, AT_ONCE // 4)
    first = next(blocks)
    asked = [str(place.column) if not shape.header else place.name for place in wanted]
    columns = [name for name in dict.fromkeys(asked) if name and name in first.names]
    spool = Spool(len(columns), beside)
    for block in chain([first], blocks):
        spool.add([block.column(name) for name in columns])
    spooled = {name: k for k, name in enumerate(columns)}
    return Source(
        path,
        tuple(name for name in first.names if name),
        first.column,
        numbered=not shape.header,
        long=lambda name: spool.signal(spooled[name]),
    )


def _long_column(table: TableColumns, name: str) -> LongSignal | None:
    if table.rows < LONG:
        return None
    return LongSignal(table.rows, lambda start, stop: table.stretch(name, start, stop))


def _parquet_source(path: Path) -> Source:
    """Columns of numbers, and those of lists of numbers, an entry a signal (`lerobot`)."""
    table, lists = TableColumns(path), read_lists(path)
    if not lists.signals:
        return Source(path, table.names, lambda name: table[name], long=lambda name: _long_column(table, name))
    inside = {column for column, _ in lists.signals.values()}
    plain = tuple(name for name in table.names if name not in inside)
    episodes = read_episodes(table["episode_index"]) if "episode_index" in plain else {}
    return Source(
        path, (*plain, *lists.signals), lambda name: lists.load(name) if name in lists.signals else table[name],
        long=lambda name: None if name in lists.signals else _long_column(table, name),
        stated=lambda: {"timestamp": "s"} if lists.rate_hz else {}, questions=lists.questions, pieces=episodes,
        pairs=lists.pairs, rate_hz=lists.rate_hz, closed=lists.closed, remarks=lists.remarks,
    )  # fmt: skip


def _npz_source(path: Path) -> Source:
    with reading(path, "NPZ"), path.open("rb") as raw, np.load(raw, allow_pickle=False) as file:
        check_zip(path)
        names = tuple(file.files)

    def load(name: str) -> np.ndarray:
        with reading(path, "NPZ"), path.open("rb") as raw, np.load(raw, allow_pickle=False) as file:
            return np.asarray(file[name])

    return Source(path, names, load)


def _mat_source(path: Path) -> Source:
    import h5py

    with reading(path, "MAT"):
        path.open("rb").close()
        new = h5py.is_hdf5(path)
    return _mat73_source(path) if new else _mat5_source(path)


def _mat5_source(path: Path) -> Source:
    with reading(path, "MAT"):
        found = read_mat5_tree(path)
    refuse_closed(path, found)
    return Source(path, tuple(found.arrays), found.arrays.__getitem__, stated=lambda: found.units, closed=found.closed)


def _mat73_source(path: Path) -> Source:
    found = read_mat73(path)
    refuse_closed(path, found)
    return Source(
        path, tuple(found.arrays), lambda name: mat73_array(path, found.arrays[name]),
        long=lambda name: mat73_long(path, found.arrays[name]), stated=lambda: found.units, closed=found.closed,
    )  # fmt: skip
