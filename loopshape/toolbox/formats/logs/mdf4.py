"""MDF 3 and 4 files of measurement systems: their channels, read by asammdf (extra `mdf`).

Each group of channels has its own time; that of a channel is named "time of CHANNEL", in s.
"""

from __future__ import annotations

import gc
import sys
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from loopshape.core.errors import UnreadableInputError
from loopshape.io.files import reading, short

TIME_OF = "time of "


class Arrays(dict[str, np.ndarray]):
    """A file's arrays by name, and what it holds besides and is not read, each with why: `NAME (why)`.

    `units` are those that the format defines, by name; `remarks` are what a reader of the draft must know.
    """

    def __init__(
        self,
        arrays: Mapping[str, np.ndarray],
        closed: Iterable[str] = (),
        units: Mapping[str, str] | None = None,
        remarks: Iterable[str] = (),
    ) -> None:
        super().__init__(arrays)
        self.closed = tuple(dict.fromkeys(closed))
        self.units = dict(units or {})
        self.remarks = tuple(remarks)


def mdf_names(path: Path) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Names of the channels of numbers, and of their times; and the names that several groups have: left out."""
    with _opened(path) as file:
        names = [name for name, places in file.channels_db.items() if len(places) == 1 and not _is_master(file, places)]
        own = {name: [place for place in places if not _is_master(file, [place])]
               for name, places in file.channels_db.items()}  # fmt: skip
    several = tuple(f"{name} (of {len(places)} groups)" for name, places in own.items() if len(places) > 1)
    return (*names, *(TIME_OF + name for name in names)), several


def mdf_array(path: Path, name: str) -> np.ndarray:
    """Samples (n,) of a channel in its physical unit, or its time in s."""
    with _opened(path) as file, reading(path, "MDF", Exception):  # asammdf lets anything through
        signal = file.get(name.removeprefix(TIME_OF))
        return np.asarray(signal.timestamps if name.startswith(TIME_OF) else signal.samples)


def mdf_units(path: Path) -> dict[str, str]:
    """The unit that each channel states, and s of the times; "" where a channel states none."""
    names, _ = mdf_names(path)
    with _opened(path) as file, reading(path, "MDF", Exception):
        return {n: "s" if n.startswith(TIME_OF) else str(file.get_channel_unit(n) or "") for n in names}


def _is_master(file: Any, places: Any) -> bool:
    group, channel = places[0]
    return file.masters_db.get(group) == channel


def _opened(path: Path) -> Any:
    """The file as asammdf has it, closed when the block ends. Refuses a missing extra, and a damaged file."""
    try:
        from asammdf import MDF
    except ImportError:
        raise UnreadableInputError(
            "an MDF file needs asammdf", path.name, "install it: pip install 'loopshape[mdf]'"
        ) from None
    with reading(path, "MDF"):
        path.open("rb").close()
    message = ""
    try:
        return MDF(path)
    except Exception as error:  # of any kind: a damaged file ends in whatever the line of asammdf that met it raised
        message = short(error) or type(error).__name__
    with _no_last_words():
        gc.collect()
    raise UnreadableInputError(f"{path} cannot be read as MDF", message, "it is damaged or of another kind")


@contextmanager
def _no_last_words() -> Iterator[None]:
    """Without what half-made objects complain of when they go."""
    before = sys.unraisablehook
    sys.unraisablehook = lambda _: None
    try:
        yield
    finally:
        sys.unraisablehook = before
