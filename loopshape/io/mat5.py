"""MAT files of version 5 to 7: their numeric arrays, and texts where they are asked for.

scipy's reader ends the process with a segmentation fault on some damaged files, so the few elements that
carry numbers and texts are read here, every length checked against what is there. Format: MathWorks, "MAT-File
Format", chapter 1 (level 5). Objects and other cells than lists of texts
are named and left closed; structures are opened where it is asked for.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from loopshape.io.growth import inflated

_HEADER = 128
_MATRIX, _COMPRESSED = 14, 15
_STORED = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8"}
_NUMERIC_CLASSES = range(6, 16)
_CELL, _CHAR = 1, 4
_CODES = {1: "ascii", 2: "latin-1", 4: "utf-16", 16: "utf-8", 17: "utf-16", 18: "utf-32"}
_OPAQUE = 17
_STRUCT = 2
_DEEPEST = 8  # structures within structures
_LABELS = ("Name", "name", "label", "Label", "blockName")
_COMPLEX = 0x0800


@dataclass(frozen=True)
class _Element:
    kind: int
    data: memoryview


def read_mat5(path: Path, *, texts: bool = False, structs: bool = False) -> dict[str, np.ndarray]:
    """Arrays by name with MATLAB's shape, real or complex; what is not numeric is an empty array of objects.

    With `texts` a text of one row is an array () of it, and a cell of texts one (n,) of them. With `structs` the
    members of a structure are arrays `outer.field`, those of a list of structures `outer.LABEL.field` by the text in
    their field Name or label, else `outer(1).field`.
    Raises `ValueError` for a file that is damaged or of another version; `zlib.error` and `struct.error` too.
    """
    raw = path.read_bytes()
    order = _byte_order(raw)
    arrays: dict[str, np.ndarray] = {}
    grown = 0
    for element in _elements(memoryview(raw)[_HEADER:], order):
        if element.kind == _COMPRESSED:
            unpacked = inflated(path, element.data, grown)
            grown += len(unpacked)
            element = _next(_elements(memoryview(unpacked), order))
        if element.kind != _MATRIX:
            continue
        if structs and (members := _members(element.data, order, "", 0)):
            arrays |= members
        elif (named := _matrix(element.data, order, texts)) and named[0]:
            arrays[named[0]] = named[1]
    return arrays


def _members(data: memoryview, order: str, outer: str, depth: int) -> dict[str, np.ndarray]:
    """The arrays within a structure by their names; empty for anything else."""
    if not data:
        return {}
    parts = _elements(data, order)
    if struct.unpack_from(order + "I", _next(parts).data)[0] & 0xFF != _STRUCT:
        return {}
    if depth >= _DEEPEST:
        raise ValueError(f"structures lie more than {_DEEPEST} deep in each other")
    sizes = np.frombuffer(_next(parts).data, dtype=order + "i4")
    name = outer or bytes(_next(parts).data).decode("ascii")
    if outer:
        _next(parts)  # its own name, which is empty
    fields = _field_names(parts, order)
    count = math.prod(int(n) for n in sizes) if fields else 0
    rows = [[_next(parts).data for _ in fields] for _ in range(count)]
    places = [name] if count == 1 else _places(name, fields, rows, order)
    found: dict[str, np.ndarray] = {}
    for place, row in zip(places, rows, strict=True):
        for field, inner in zip(fields, row, strict=True):
            deeper = _members(inner, order, f"{place}.{field}", depth + 1)
            value = None if deeper else _matrix(inner, order, False)
            found |= deeper or ({} if value is None else {f"{place}.{field}": value[1]})
    return found


def _field_names(parts: Iterator[_Element], order: str) -> list[str]:
    length = struct.unpack_from(order + "i", _next(parts).data)[0]
    raw = bytes(_next(parts).data)
    if length <= 0 or len(raw) % length:
        raise ValueError("a structure has no names of its fields")
    return [raw[k : k + length].split(b"\0")[0].decode("ascii") for k in range(0, len(raw), length)]


def _places(name: str, fields: list[str], rows: list[list[memoryview]], order: str) -> list[str]:
    """What the structures of a list are called: by their labels where each has one of its own, else by their number."""
    label = next((fields.index(known) for known in _LABELS if known in fields), None)
    if label is not None:
        found = [_matrix(row[label], order, True) for row in rows]
        texts = [
            str(one[1]) if one is not None and one[1].dtype.kind == "U" and not one[1].ndim else "" for one in found
        ]
        if all(texts) and len(set(texts)) == len(texts):
            return [f"{name}.{text}" for text in texts]
    return [f"{name}({k + 1})" for k in range(len(rows))]


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


def _matrix(data: memoryview, order: str, texts: bool) -> tuple[str, np.ndarray] | None:
    """Name and values of one variable or member of a cell; None for an object, whose parts are others."""
    if not data:  # an empty place of a cell
        return "", np.empty(0, dtype=object)
    parts = _elements(data, order)
    word = struct.unpack_from(order + "I", _next(parts).data)[0]
    number_class = word & 0xFF
    if number_class == _OPAQUE:
        return None
    shape = np.frombuffer(_next(parts).data, dtype=order + "i4")
    name = bytes(_next(parts).data).decode("ascii")
    if not shape.size or shape.min() < 0:
        raise ValueError(f"{name} has no shape")
    sizes = tuple(int(n) for n in shape)
    if number_class in _NUMERIC_CLASSES:
        values = _numbers(_next(parts), name, sizes, order)
        return name, values + 1j * _numbers(_next(parts), name, sizes, order) if word & _COMPLEX else values
    if texts and number_class == _CHAR:
        return name, _text(_next(parts), sizes, order)
    if texts and number_class == _CELL:
        return name, _texts([_matrix(part.data, order, texts) for part in parts if part.kind == _MATRIX], sizes)
    return name, np.empty(0, dtype=object)


def _numbers(values: _Element, name: str, sizes: tuple[int, ...], order: str) -> np.ndarray:
    """One part, real or imaginary, in MATLAB's shape; another length than the shape's is refused."""
    if values.kind not in _STORED:
        raise ValueError(f"the numbers of {name} are of the unknown type {values.kind}")
    return np.frombuffer(values.data, dtype=order + _STORED[values.kind]).reshape(sizes, order="F")


def _text(letters: _Element, sizes: tuple[int, ...], order: str) -> np.ndarray:
    """A text of one row as an array (); an empty one without rows, a table of letters as one of objects."""
    if letters.kind not in _CODES or len(sizes) != 2 or sizes[0] > 1:
        return np.empty(0, dtype=object)
    code = _CODES[letters.kind]
    ending = {"<": "-le", ">": "-be"}[order] if code.startswith("utf-") and code != "utf-8" else ""
    return np.array(bytes(letters.data).decode(code + ending) if sizes[0] else "", dtype=str)


def _texts(members: list[tuple[str, np.ndarray] | None], sizes: tuple[int, ...]) -> np.ndarray:
    """A list of texts (n,); a cell of other things is an empty array of objects, one of another length is refused."""
    if len(members) != math.prod(sizes):
        raise ValueError(f"a cell of {math.prod(sizes)} holds {len(members)}")
    values = [member[1] for member in members if member is not None]
    if len(values) != len(members) or any(v.dtype.kind != "U" or v.ndim for v in values):
        return np.empty(0, dtype=object)
    return np.array([str(v) for v in values], dtype=str)


def _next(parts: Iterator[_Element]) -> _Element:
    element = next(parts, None)
    if element is None:
        raise ValueError("a variable is cut short")
    return element
