"""Blackbox logs of Betaflight (`.bbl`, `.bfl`): their main frames as signals.

A signal is called by its field (`gyroADC[0]`, `setpoint[0]`, both in deg/s); `axisSum[0]` is the sum of the terms
`axisP[0]`, `axisI[0]`, ... Of a file of several logs the names begin with `log1.`, `log2.`. Stamps are `time of log1`,
in s since its first frame.

Format: betaflight.com, "Blackbox internals": headers of text; then frames of a letter and fields, each encoded as its
header says and added to what its predictor expects. Bytes that are lost, as on a full flash, are passed over up to the
next whole frame: the stamps show the gap. Read here because orangebox (GPL) cannot be installed by pip.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from loopshape.io.files import reading
from loopshape.toolbox.formats.logs.mdf4 import TIME_OF

_FIRST = b"H Product:Blackbox"
_FRAMES = b"IPSGHE"
_SIGNED_VB, _UNSIGNED_VB, _NEG_14BIT, _TAG8_8SVB, _TAG2_3S32, _TAG8_4S16, _NULL, _TAG2_3SVARIABLE = (
    0, 1, 3, 6, 7, 8, 9, 10,
)  # fmt: skip
_TERMS = "PIDFS"


class _Bytes:
    """The bytes of a log, read one after the other; `IndexError` at the end."""

    def __init__(self, data: bytes, at: int) -> None:
        self.data, self.at = data, at

    def next(self) -> int:
        """The next byte."""
        value = self.data[self.at]
        self.at += 1
        return value

    def unsigned(self) -> int:
        """A number in groups of seven bits, the lowest first."""
        value = 0
        for shift in range(0, 35, 7):
            byte = self.next()
            value |= (byte & 0x7F) << shift
            if byte < 0x80:
                return value & 0xFFFFFFFF
        raise ValueError("a number of more than five bytes")

    def signed(self) -> int:
        """A number whose sign is its lowest bit."""
        value = self.unsigned()
        return (value >> 1) ^ -(value & 1)

    def little(self, count: int) -> int:
        """A signed number of whole bytes, the lowest first."""
        return int.from_bytes(bytes(self.next() for _ in range(count)), "little", signed=True)


def _bits(value: int, count: int) -> int:
    """The lowest bits as a signed number."""
    value &= (1 << count) - 1
    return value - (1 << count) if value >> (count - 1) else value


def _three(raw: _Bytes, variable: bool) -> list[int]:
    """Three numbers whose common size the two highest bits of the first byte tell."""
    lead = raw.next()
    size = lead >> 6
    if size == 0:
        return [_bits(lead >> shift, 2) for shift in (4, 2, 0)]
    if size == 3:
        return [raw.little(1 + ((lead >> shift) & 3)) for shift in (0, 2, 4)]
    second = raw.next()
    if size == 1 and variable:
        return [_bits(lead >> 1, 5), _bits((lead & 1) << 4 | second >> 4, 5), _bits(second, 4)]
    if size == 1:
        return [_bits(lead, 4), _bits(second >> 4, 4), _bits(second, 4)]
    third = raw.next()
    if variable:
        return [_bits(lead << 2 | second >> 6, 8), _bits(second << 1 | third >> 7, 7), _bits(third, 7)]
    return [_bits(lead, 6), _bits(second, 6), _bits(third, 6)]


def _four(raw: _Bytes, version: int) -> list[int]:
    """Four numbers of 0, 4, 8 or 16 bits as the first byte tells; from version 2 on packed without gaps."""
    sizes = [(0, 4, 8, 16)[raw.data[raw.at] >> shift & 3] for shift in (0, 2, 4, 6)]
    raw.at += 1
    if version < 2:
        return _four_first(raw, sizes)
    bits = sum(sizes)
    packed = int.from_bytes(bytes(raw.next() for _ in range((bits + 7) // 8)), "big") >> (-bits % 8)
    found = []
    for size in sizes:
        bits -= size
        found.append(_bits(packed >> bits, size) if size else 0)
    return found


def _four_first(raw: _Bytes, sizes: list[int]) -> list[int]:
    """The first version: two numbers of half a byte share one, the lower first; 16 bits are little-endian."""
    found: list[int] = []
    while len(found) < len(sizes):
        size = sizes[len(found)]
        if size == 4:
            byte = raw.next()
            found += [_bits(byte, 4), _bits(byte >> 4, 4)]
        else:
            found.append(raw.little(size // 8) if size else 0)
    return found[: len(sizes)]


@dataclass
class _Log:
    """One log: its headers, the fields of its frames, and what its main frames held."""

    headers: dict[str, str]
    names: list[str] = field(default_factory=list)
    rows: list[list[int]] = field(default_factory=list)
    previous: list[int] | None = None
    before: list[int] | None = None

    def numbers(self, key: str) -> list[int]:
        """A header of whole numbers, empty where there is none."""
        return [int(word) for word in self.headers.get(key, "").split(",") if re.fullmatch(r"-?\d+", word.strip())]

    def number(self, key: str, default: int) -> int:
        """The first number of a header."""
        return (self.numbers(key) or [default])[0]

    @property
    def interval(self) -> int:
        """Loops from one whole frame to the next."""
        return self.number("I interval", 32)

    @property
    def share(self) -> tuple[int, int]:
        """How many of how many loops are logged."""
        share = re.match(r"(\d+)(?:/(\d+))?", self.headers.get("P interval", "1/1"))
        one, two = (share[1], share[2]) if share else ("1", "1")
        return (int(one), int(two)) if two else (1, int(one))

    @property
    def gyro_scale(self) -> float:
        """Rate of one count of the gyro in deg/s: a float32 in hexadecimal digits."""
        bits = int(self.headers.get("gyro_scale", "0x3f800000"), 16)
        return float(struct.unpack(">f", struct.pack(">I", bits))[0])

    def skipped(self, iteration: int) -> int:
        """How many loops the firmware passes over behind this one, by its intervals."""
        (num, every), whole, count = self.share, self.interval, 0
        while (
            count < whole
            and (iteration + 1 + count) % whole
            and not (((iteration + 1 + count) % whole + num - 1) % every < num)
        ):
            count += 1
        return count


def read_blackbox(path: Path) -> dict[str, np.ndarray]:
    """Signals (n,) and stamps by name. Refuses a file that holds no log of frames."""
    with reading(path, "blackbox log"):
        data = path.read_bytes()
        starts = [found.start() for found in re.finditer(re.escape(_FIRST), data)]
        logs = [_read(data[a:b]) for a, b in zip(starts, [*starts[1:], len(data)], strict=True)]
        logs = [log for log in logs if len(log.rows) > 1]
        if not logs:
            raise ValueError("no log of two frames in it")
        found: dict[str, np.ndarray] = {}
        for k, log in enumerate(logs, start=1):
            found |= _signals(log, f"log{k}", f"log{k}." if len(logs) > 1 else "")
    return found


def _signals(log: _Log, title: str, before: str) -> dict[str, np.ndarray]:
    """Columns of a log by name, in deg/s where they are rates, and its stamps."""
    table = np.array(log.rows, dtype=float)
    columns = dict(zip(log.names, table.T, strict=True))
    time = columns.pop("time")
    columns = {name: values * (log.gyro_scale if name.startswith("gyro") else 1.0) for name, values in columns.items()}
    found = {f"{before}{name}": values for name, values in columns.items()}
    for axis in range(3):
        terms = [columns[name] for term in _TERMS if (name := f"axis{term}[{axis}]") in columns]
        if terms:
            found[f"{before}axisSum[{axis}]"] = np.sum(terms, axis=0)
    found[TIME_OF + title] = (time - time[0]) / 1e6  # stamps count microseconds
    return found


def rates_in_deg(names: Collection[str]) -> dict[str, str]:
    """The unit of those signals that have one."""
    return {name: "deg/s" for name in names if re.search(r"(^|\.)(gyro|setpoint\[[012])", name)}


def _read(data: bytes) -> _Log:
    raw, headers = _Bytes(data, 0), {}
    while data[raw.at : raw.at + 2] == b"H ":
        end = data.index(b"\n", raw.at)
        name, _, value = data[raw.at + 2 : end].decode("latin-1").partition(":")
        headers[name], raw.at = value.strip(), end + 1
    log = _Log(headers, [name.strip() for name in headers.get("Field I name", "").split(",")])
    _refuse_headers(log)
    while raw.at < len(data) and _frame(log, raw):
        pass
    return log


def _refuse_headers(log: _Log) -> None:
    """Refuse headers by which no frame can be read."""
    if "time" not in log.names or len(set(log.names)) < len(log.names):
        raise ValueError("its headers name no field of time, or a field twice")
    for key in ("I predictor", "I encoding", "P predictor", "P encoding"):
        if (count := len(log.numbers(f"Field {key}"))) != len(log.names):
            raise ValueError(f"header Field {key}: {count} numbers for {len(log.names)} fields")
    if not 1 <= log.interval <= 4096 or min(log.share) < 1:  # loops between whole frames
        raise ValueError(f"an I interval of {log.interval}, a P interval of {log.share[0]}/{log.share[1]}")
    if not np.isfinite(log.gyro_scale):
        raise ValueError(f"a gyro_scale of {log.gyro_scale}")


def _frame(log: _Log, raw: _Bytes) -> bool:
    """Read one frame, or pass over a byte that begins none; False at the log's end."""
    start_at, kind = raw.at, chr(raw.data[raw.at])
    raw.at += 1
    try:
        if kind == "E":
            return _event(raw)
        values = None
        if kind == "I" or (kind == "P" and log.previous is not None):
            values = _fields(log, raw, kind)
        elif kind in "SGH" and f"Field {kind} name" in log.headers:
            _fields(log, raw, kind)
        elif kind != "P":
            raise ValueError("no frame begins here")
        if values is not None and not _follows(log, raw, values):
            raise ValueError("the frame is damaged")
    except (ValueError, IndexError):
        raw.at, log.previous = start_at + 1, None
        return True
    if values is not None:
        log.before = values if kind == "I" else log.previous
        log.previous = values
        log.rows.append(values)
    return True


def _follows(log: _Log, raw: _Bytes, values: list[int]) -> bool:
    """Whether another frame begins behind this one, and its time goes on from the last."""
    at = log.names.index("time")
    behind = raw.at >= len(raw.data) or raw.data[raw.at] in _FRAMES
    longest_jump = 10_000_000  # microseconds between frames of one stretch
    return behind and (not log.rows or 0 < values[at] - log.rows[-1][at] < longest_jump or log.previous is None)


def _event(raw: _Bytes) -> bool:
    """Pass over an event; False for the log's end."""
    kind = raw.next()
    last_event = 255
    if kind == last_event:
        return False
    if kind == 13:  # a setting changed in flight: a function, and a number as float or not
        raw.at += 4 if raw.next() >= 128 else 0
    for _ in range({0: 1, 13: 1, 14: 2, 15: 1, 30: 2}.get(kind, 0)):
        raw.unsigned()
    return True


def _fields(log: _Log, raw: _Bytes, kind: str) -> list[int]:
    """The values of a frame: each encoded number added to what its predictor expects."""
    encodings, predictors = log.numbers(f"Field {kind} encoding"), log.numbers(f"Field {kind} predictor")
    signs = log.numbers(f"Field {'I' if kind == 'P' else kind} signed")
    values: list[int] = []
    while len(values) < len(encodings):
        for number in _decoded(log, raw, encodings, len(values)):
            k = len(values)
            if k < len(encodings):
                value = number + _expected(log, predictors[k], k, values)
                values.append(_bits(value, 32) if k < len(signs) and signs[k] else value & 0xFFFFFFFF)
    return values


def _decoded(log: _Log, raw: _Bytes, encodings: list[int], k: int) -> list[int]:
    """The numbers that stand together from field k on."""
    encoding = encodings[k]
    if encoding in _ALONE:
        return [_ALONE[encoding](raw)]
    if encoding in (_TAG2_3S32, _TAG2_3SVARIABLE):
        return _three(raw, encoding == _TAG2_3SVARIABLE)
    if encoding == _TAG8_4S16:
        return _four(raw, log.number("Data version", 2))
    if encoding != _TAG8_8SVB:
        raise ValueError(f"an encoding of number {encoding}")
    count = 1
    while count < 8 and k + count < len(encodings) and encodings[k + count] == _TAG8_8SVB:
        count += 1
    held = raw.next() if count > 1 else 1
    return [raw.signed() if held >> bit & 1 else 0 for bit in range(count)]


_ALONE: Mapping[int, Callable[[_Bytes], int]] = {
    _SIGNED_VB: _Bytes.signed,
    _UNSIGNED_VB: _Bytes.unsigned,
    _NEG_14BIT: lambda raw: -_bits(raw.unsigned(), 14),
    _NULL: lambda raw: 0,
}


def _expected(log: _Log, predictor: int, k: int, values: list[int]) -> int:
    """What a predictor expects of field k, by the frames before and the fields of this one."""
    last, older = log.previous or [0] * (k + 1), log.before or log.previous or [0] * (k + 1)
    if predictor in (1, 2, 3):
        return (last[k], 2 * last[k] - older[k], int((last[k] + older[k]) / 2))[predictor - 1]
    if predictor == 5:
        return values[log.names.index("motor[0]")]
    if predictor == 6:
        return last[k] + 1 + log.skipped(last[k])
    return {
        4: log.number("minthrottle", 1150), 8: 1500, 9: log.number("vbatref", 4095), 11: log.number("motorOutput", 0),
    }.get(predictor, 0)  # fmt: skip


def rate_fields(names: Collection[str], axis: int) -> dict[str, str]:
    """Names of reference, control and output of one axis (0 roll) of the rate loop, as far as a log holds them."""
    wanted = {"reference": "setpoint", "control": "axisSum", "output": "gyroADC"}
    ends = {part: f"{name}[{axis}]" for part, name in wanted.items()}
    found = {part: next((n for n in names if n.rpartition(".")[2] == end), None) for part, end in ends.items()}
    return {part: name for part, name in found.items() if name is not None}
