"""JSON with arrays by name, and WAV: formats that the standard library reads."""

from __future__ import annotations

import json
import wave
from pathlib import Path
from typing import Any

import numpy as np

from loopshape.core.errors import UnreadableInputError
from loopshape.io.files import reading
from loopshape.io.size_limit import most_bytes
from loopshape.toolbox.formats.logs.mdf4 import TIME_OF

_LONGEST_JSON = 512 * 1024 * 1024  # bytes


def read_json_arrays(path: Path) -> dict[str, np.ndarray]:
    """Arrays of numbers and single numbers by name, those of inner objects as `outer.inner`; null is NaN.

    A list of objects with the same keys is a table. Refuses what is no JSON, lists within a list that differ in length,
    and a file longer than 512 MB.
    """
    with reading(path, "JSON"):
        if path.stat().st_size > _LONGEST_JSON:
            raise ValueError(f"more than {_LONGEST_JSON} bytes")
        found: dict[str, np.ndarray] = {}
        _gather(json.loads(path.read_text(encoding="utf-8-sig")), "", found, 0)
        if not found:
            raise ValueError("it holds no list of numbers by a name")
        return found


def _gather(value: Any, name: str, found: dict[str, np.ndarray], depth: int) -> None:
    if isinstance(value, dict) and depth < 6:
        for key, inner in value.items():
            _gather(inner, f"{name}.{key}" if name else str(key), found, depth + 1)
    elif isinstance(value, list) and value and all(isinstance(row, dict) for row in value):
        for key in value[0]:
            _gather([row.get(key) for row in value], f"{name}.{key}" if name else str(key), found, depth + 1)
    elif name and (lengths := _lengths(value)) and len(lengths) > 1:
        raise UnreadableInputError(
            f"{name} holds lists of different lengths", f"{min(lengths)} to {max(lengths)} numbers",
            "write a list of its own for each signal, all of one length",
        )  # fmt: skip
    elif name and (array := _numbers(value)) is not None:
        found[name] = array


def _lengths(value: Any) -> set[int]:
    """Lengths of the lists of numbers within a list; nothing for anything else."""
    lists = isinstance(value, list) and value and all(isinstance(row, list) for row in value)
    return (
        {len(row) for row in value}
        if lists and all(isinstance(x, int | float) for row in value for x in row)
        else set()
    )


def _numbers(value: Any) -> np.ndarray | None:
    """A number, or a list of numbers and nulls, perhaps of two dimensions; None for anything else."""
    if isinstance(value, int | float) and not isinstance(value, bool):
        return np.array(float(value))
    if not isinstance(value, list) or not value:
        return None
    rows = value if isinstance(value[0], list) else [value]
    plain = all(x is None or (isinstance(x, int | float) and not isinstance(x, bool)) for row in rows for x in row)
    if not plain or len({len(row) for row in rows}) != 1:
        return None
    array = np.array([[np.nan if x is None else float(x) for x in row] for row in rows])
    return array if isinstance(value[0], list) else array[0]


def read_wav(path: Path) -> dict[str, np.ndarray]:
    """Channels `channel 1`, `channel 2`, ... as shares of full scale, their rate `fs`, and stamps `time of wav` in s.

    Whole numbers of 8, 16, 24 or 32 bit. Refuses compressed files and those cut short.
    """
    with reading(path, "WAV", wave.Error), wave.open(str(path), "rb") as file:
        width, channels, rate, rows = file.getsampwidth(), file.getnchannels(), file.getframerate(), file.getnframes()
        if rows * width * channels > most_bytes(path) or rate <= 0:
            raise ValueError(f"{rows} rows are more than its size can carry")
        data = file.readframes(rows)
        if len(data) != rows * width * channels:
            raise ValueError(f"it is cut short: {len(data)} of {rows * width * channels} bytes")
    values = _samples(data, width).reshape(-1, channels)
    found = {f"channel {k + 1}": values[:, k] for k in range(channels)}
    return found | {"fs": np.array(float(rate)), TIME_OF + "wav": np.arange(rows) / rate}


def _samples(data: bytes, width: int) -> np.ndarray:
    """Whole numbers of so many bytes, little-endian, as shares of full scale; 8 bit counts from 128."""
    if width == 1:
        return (np.frombuffer(data, np.uint8).astype(float) - 128.0) / 128.0
    whole = np.zeros((len(data) // width, 4), np.uint8)
    whole[:, 4 - width :] = np.frombuffer(data, np.uint8).reshape(-1, width)
    return np.asarray(whole.view("<i4")[:, 0] / 2.0**31)
