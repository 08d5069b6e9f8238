"""MAT files of version 5 to 7: their real numeric arrays.

scipy's reader ends the process with a segmentation fault on some damaged files, so the few elements that
carry numbers are read here, every length checked against what is there. Format: MathWorks, "MAT-File
Format", chapter 1 (level 5). Structures, cells, texts and objects are named and left closed.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

_HEADER = 128
_MATRIX, _COMPRESSED = 14, 15
_STORED = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8"}
_NUMERIC_CLASSES = range(6, 16)
_OPAQUE = 17
_COMPLEX = 0x0800


@dataclass(frozen=True)
class _Element:
    kind: int
    data: memoryview


def read_mat5(path: Path) -> dict[str, np.ndarray]:
    """Arrays by name with MATLAB's shape; what is not real and numeric is an empty array of objects.

    Raises `ValueError` for a file that is damaged or of another version; `zlib.error` and `struct.error` too.
    """
    raw = path.read_bytes()
    order = _byte_order(raw)
    arrays = {}
    for element in _elements(memoryview(raw)[_HEADER:], order):
        if element.kind == _COMPRESSED:
            element = _next(_elements(memoryview(zlib.decompress(element.data)), order))
        if element.kind == _MATRIX and (named := _matrix(element.data, order)):
            arrays[named[0]] = named[1]
    return arrays


def _byte_order(raw: bytes) -> str:
    """Byte order, < or >, from the header's two last bytes."""
    orders = {b"IM": "<", b"MI": ">"}
    order = orders.get(raw[126:128])
    if order is None or struct.unpack(order + "H", raw[124:126])[0] != 0x0100:
        raise ValueError("it is no MAT file of version 5 to 7.3")
    return order


def _elements(data: memoryview, order: str) -> Iterator[_Element]:
    """Elements one after the other; a length beyond the end is refused."""
    at = 0
    while at < len(data):
        kind, size = struct.unpack_from(order + "II", data, at)
        start = at + 8
        if kind >> 16:  # up to four bytes lie in the tag itself
            kind, size, start = kind & 0xFFFF, kind >> 16, at + 4
        if start + size > len(data) or (start == at + 4 and size > 4):
            raise ValueError(f"it ends within an element of {size} bytes")
        yield _Element(kind, data[start : start + size])
        at = start + size
        if kind != _COMPRESSED:
            at += -at % 8


def _matrix(data: memoryview, order: str) -> tuple[str, np.ndarray] | None:
    """Name and values of one variable; None for an object without a name of its own."""
    parts = _elements(data, order)
    word = struct.unpack_from(order + "I", _next(parts).data)[0]
    number_class = word & 0xFF
    if number_class == _OPAQUE:
        return None
    shape = np.frombuffer(_next(parts).data, dtype=order + "i4")
    name = bytes(_next(parts).data).decode("ascii")
    if not name:
        return None
    if number_class not in _NUMERIC_CLASSES or word & _COMPLEX:
        return name, np.empty(0, dtype=object)
    values = _next(parts)
    if values.kind not in _STORED:
        raise ValueError(f"the numbers of {name} are of the unknown type {values.kind}")
    if not shape.size or shape.min() < 0:
        raise ValueError(f"{name} has no shape")
    flat = np.frombuffer(values.data, dtype=order + _STORED[values.kind])
    return name, flat.reshape(tuple(int(n) for n in shape), order="F")


def _next(parts: Iterator[_Element]) -> _Element:
    element = next(parts, None)
    if element is None:
        raise ValueError("a variable is cut short")
    return element
