"""DataFlash logs of ArduPilot (`.bin`): their messages as signals.

A signal is `MESSAGE.FIELD`, of a further instance `MESSAGE#1.FIELD`; the stamps of a message are `time of MESSAGE`, in
s since the first one. Rates of the RATE message are deg/s, its outputs shares of full command.

Format: ardupilot.org, "Logs: message format": each message is 0xA3 0x95, its kind, and fields as its FMT message says,
little-endian. It is read here and not by pymavlink, which passes over damage and writes to the terminal; a test holds
both to the same numbers.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from loopshape.io.files import reading
from loopshape.toolbox.formats.logs.mdf4 import TIME_OF, Arrays

_MAGIC = b"\xa3\x95"
_FMT, _FMT_BYTES = 128, 89
#: numpy's type of a field by its letter, and what its number is divided by
_TYPES = {
    "b": ("i1", 1.0), "B": ("u1", 1.0), "M": ("u1", 1.0), "h": ("<i2", 1.0), "H": ("<u2", 1.0), "i": ("<i4", 1.0),
    "I": ("<u4", 1.0), "q": ("<i8", 1.0), "Q": ("<u8", 1.0), "g": ("<f2", 1.0), "f": ("<f4", 1.0), "d": ("<f8", 1.0),
    "c": ("<i2", 1e2), "C": ("<u2", 1e2), "e": ("<i4", 1e2), "E": ("<u4", 1e2), "L": ("<i4", 1e7),
}  # fmt: skip
_TEXTS = {"n": 4, "N": 16, "Z": 64, "a": 64}  # bytes of texts and of short arrays
_AXES = ("R", "P", "Y")
_INSTANCE = "#"  # unit of the field that counts instances


@dataclass(frozen=True)
class _Kind:
    """A kind of message: its name, its bytes with the head, the letters and names of its fields."""

    name: str
    size: int
    letters: str
    fields: tuple[str, ...]

    @property
    def dtype(self) -> np.dtype:
        """Fields as numpy reads them, the head of three bytes in front."""
        types = [
            (f, _TYPES[c][0] if c in _TYPES else f"V{_TEXTS[c]}")
            for f, c in zip(self.fields, self.letters, strict=True)
        ]
        return np.dtype([(" head", "V3"), *types])


def read_dataflash(path: Path) -> Arrays:
    """Signals (n,) and stamps by name. Refuses another kind of file, and one that is damaged.

    Bytes of 0 or 255 at the end, and a last message that is cut, are what a loss of power leaves: they are passed over.
    That, fields of text and messages without stamps are listed as not read.
    """
    with reading(path, "DataFlash"):
        raw = path.read_bytes()
        if raw[:2] != _MAGIC:
            raise ValueError("it does not begin as a DataFlash log does")
        kinds: dict[int, _Kind] = {
            _FMT: _Kind("FMT", _FMT_BYTES, "BBnNZ", ("Type", "Length", "Name", "Format", "Columns"))
        }
        places: dict[int, list[int]] = {}
        end = 0
        for kind, at in _messages(raw, kinds):
            places.setdefault(kind, []).append(at)
            end = at + kinds[kind].size
        tables = {kinds[k].name: _table(raw, kinds[k], np.array(at)) for k, at in places.items() if k != _FMT}
        stamped = {name: table for name, table in tables.items() if "TimeUS" in (table.dtype.names or ())}
        if not stamped:
            raise ValueError("it holds no messages with stamps")
        letters = {kind.name: dict(zip(kind.fields, kind.letters, strict=True)) for kind in kinds.values()}
        closed = [f"{name} (without stamps)" for name in tables if name not in stamped]
        closed += [f"{name}.{f} (text)" for name in stamped for f, c in letters[name].items() if c not in _TYPES]
        closed += [f"the last {len(raw) - end} bytes (no whole message)"] if end < len(raw) else []
        return Arrays(_named(stamped, letters, _instances(tables.get("FMTU"), kinds)), closed)


def _messages(raw: bytes, kinds: dict[int, _Kind]) -> Iterator[tuple[int, int]]:
    """Kind and place of each message; FMT messages fill `kinds`."""
    at = 0
    while at + 3 <= len(raw):
        if raw[at : at + 2] != _MAGIC:
            if not raw[at:].strip(b"\x00") or not raw[at:].strip(b"\xff"):
                return
            raise ValueError(f"no message begins at byte {at}")
        kind = raw[at + 2]
        if kind not in kinds:
            raise ValueError(f"a message at byte {at} is of the unknown kind {kind}")
        if at + kinds[kind].size > len(raw):
            return
        if kind == _FMT:
            _learn(raw[at : at + _FMT_BYTES], kinds)
        yield kind, at
        at += kinds[kind].size


def _learn(message: bytes, kinds: dict[int, _Kind]) -> None:
    """Take a FMT message into `kinds`; refuses one whose length is not that of its fields."""
    kind, size = message[3], message[4]
    name, letters, columns = (message[a:b].split(b"\0")[0].decode("ascii") for a, b in ((5, 9), (9, 25), (25, 89)))
    fields = tuple(columns.split(",")) if columns else ()
    found = _Kind(name, size, letters, fields)
    known = all(c in _TYPES or c in _TEXTS for c in letters) and len(set(fields)) == len(letters) == len(fields)
    if not known or (kind != _FMT and found.dtype.itemsize != size):
        raise ValueError(f"the format of its message {name!r} is not understood: {letters!r} of {size} bytes")
    if kind != _FMT:
        kinds[kind] = found


def _table(raw: bytes, kind: _Kind, places: np.ndarray) -> np.ndarray:
    """All messages of one kind as rows of a structured array."""
    bytes_of = np.frombuffer(raw, np.uint8)[places[:, None] + np.arange(kind.size)]
    return np.ascontiguousarray(bytes_of).view(kind.dtype)[:, 0]


def _instances(units: np.ndarray | None, kinds: Mapping[int, _Kind]) -> dict[str, str]:
    """The field that counts instances, by the message's name, as FMTU messages say it."""
    if units is None or not {"FmtType", "UnitIds"} <= set(units.dtype.names or ()):
        return {}
    found = {}
    for row in units:
        at = bytes(row["UnitIds"]).split(b"\0")[0].decode("latin-1").find(_INSTANCE)
        kind = kinds.get(int(row["FmtType"]))
        if kind is not None and 0 <= at < len(kind.fields):
            found[kind.name] = kind.fields[at]
    return found


def _named(
    tables: Mapping[str, np.ndarray], letters: Mapping[str, Mapping[str, str]], instances: Mapping[str, str]
) -> dict[str, np.ndarray]:
    first = min(int(table["TimeUS"][0]) for table in tables.values())
    found: dict[str, np.ndarray] = {}
    per_s = 1e6  # stamps count microseconds
    for name, table in tables.items():
        counted = table[instances[name]] if name in instances else np.zeros(table.size, int)
        for number in np.unique(counted):
            mine, own = table[counted == number], f"{name}#{number}" if number else name
            for field, letter in letters[name].items():
                if letter in _TYPES and field != "TimeUS":
                    found[f"{own}.{field}"] = mine[field].astype(float) / _TYPES[letter][1]
            found[TIME_OF + own] = (mine["TimeUS"].astype(np.int64) - first) / per_s
    return found


def rate_message(names: Collection[str], axis: int) -> dict[str, str]:
    """Names of reference, control and output of one axis (0 roll) of the rate loop, as far as a log holds them."""
    letter = _AXES[axis]
    wanted = {"reference": f"RATE.{letter}Des", "control": f"RATE.{letter}Out", "output": f"RATE.{letter}"}
    return {part: name for part, name in wanted.items() if name in names}
