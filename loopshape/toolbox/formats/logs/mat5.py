"""MAT files of version 5 to 7: their numeric arrays, and texts where they are asked for.

scipy's reader ends the process with a segmentation fault on some damaged files, so the few elements that
carry numbers and texts are read here, every length checked against what is there. Format: MathWorks, "MAT-File
Format", chapter 1 (level 5); of objects `mcos`.
`read_mat5` reads variables alone, `read_mat5_tree` what lies within them too.
"""

from __future__ import annotations

import math
import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from loopshape.io.size_limit import most_bytes
from loopshape.toolbox.formats.logs.mat_tree import DEEPEST, Handle, MatContent, Node, Thing, is_model
from loopshape.toolbox.formats.logs.mcos import Objects, handle_of

_HEADER = 128
_MATRIX, _COMPRESSED = 14, 15
_STORED = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8"}
_NUMERIC_CLASSES = range(6, 16)
_CELL, _CHAR = 1, 4
_CODES = {1: "ascii", 2: "latin-1", 4: "utf-16", 16: "utf-8", 17: "utf-16", 18: "utf-32"}
_OPAQUE = 17
_STRUCT, _OBJECT = 2, 3


@dataclass(frozen=True)
class _Element:
    kind: int
    data: memoryview


def read_mat5(path: Path, *, texts: bool = False) -> dict[str, np.ndarray]:
    """Arrays by name with MATLAB's shape, real or complex; what is not numeric is an empty array of objects.

    With `texts` a text of one row is an array () of it, and a cell of texts one (n,) of them.
    Raises `ValueError` for a file that is damaged or of another version; `zlib.error` and `struct.error` too.
    """
    raw = path.read_bytes()
    order = _byte_order(raw)
    arrays: dict[str, np.ndarray] = {}
    for element, _ in _unpacked(path, raw, order):
        if (named := _matrix(element.data, order, texts)) and named[0]:
            arrays[named[0]] = named[1]
    return arrays


def _unpacked(path: Path, raw: bytes, order: str) -> Iterator[tuple[_Element, int]]:
    """The variables of a file, each with the byte that it begins at."""
    grown, at = 0, _HEADER
    for element in _elements(memoryview(raw)[_HEADER:], order):
        start_at, at = at, at + 8 + len(element.data)
        if element.kind == _COMPRESSED:
            unpacked = _inflated(path, element.data, grown)
            grown += len(unpacked)
            element = _next(_elements(memoryview(unpacked), order))
        else:
            at += -len(element.data) % 8
        if element.kind == _MATRIX:
            yield element, start_at


def read_mat5_tree(path: Path) -> MatContent:
    """Signals of a file by name, those within structures, cells, tables and objects among them.

    Raises `ValueError` for a file that is damaged or of another version; `zlib.error` and `struct.error` too.
    """
    raw = path.read_bytes()
    order = _byte_order(raw)
    variables: list[tuple[str, Node]] = []
    kept: Node = None
    for element, at in _unpacked(path, raw, order):
        name, node = _variable(element.data, order, 0)
        if at == _objects_at(raw, order):
            kept = node
        elif name:
            variables.append((name, node))
    things = _objects(kept, path) if isinstance(kept, np.ndarray) else None
    found = MatContent(np.asarray, _no_objects if things is None else things.of)
    for name, node in variables:
        found.add(name, node)
    return found


def _no_objects(handle: Handle) -> list[Thing]:
    raise ValueError("a variable holds an object, and the file's part of objects is missing")


def _objects_at(raw: bytes, order: str) -> int:
    """Where the part of objects begins, in bytes; 0 for none (8 blanks or noughts in the header)."""
    place = raw[116:124]
    return 0 if place.strip(b" ") == b"" else int(struct.unpack(order + "Q", place)[0])


def _objects(kept: np.ndarray, path: Path) -> Objects | None:
    """The part of objects: bytes of a small file of its own, with a structure whose field MCOS holds cells."""
    raw = kept.astype(np.uint8).tobytes(order="F")
    order = {b"IM": "<", b"MI": ">"}.get(raw[2:4], "<")
    for element in _elements(memoryview(raw)[8:], order):
        if element.kind == _COMPRESSED:
            element = _next(_elements(memoryview(_inflated(path, element.data, len(raw))), order))
        if element.kind == _MATRIX:
            _, node = _variable(element.data, order, 0)
            cells = node.get("MCOS") if isinstance(node, dict) else None
            if isinstance(cells, list) and len(cells) > 2 and isinstance(cells[0], np.ndarray):
                return Objects(cells[0].astype(np.uint8).tobytes(), cells, order)
    return None


def _variable(data: memoryview, order: str, depth: int) -> tuple[str, Node]:
    """Name and node (`mat_tree`) of one variable or member; what is not read is an empty array of objects."""
    if depth > DEEPEST:
        raise ValueError(f"structures lie more than {DEEPEST} deep in each other")
    closed = np.empty(0, dtype=object)
    if not data:  # an empty place of a cell
        return "", closed
    parts = _elements(data, order)
    number_class = struct.unpack_from(order + "I", _next(parts).data)[0] & 0xFF
    if number_class == _OPAQUE:
        name, _, _ = (bytes(_next(parts).data).decode("ascii") for _ in range(3))  # its system and its class
        return name, _variable(_next(parts).data, order, depth + 1)[1]
    if number_class not in (_CELL, _STRUCT, _OBJECT):
        name, values = _matrix(data, order, True) or ("", closed)
        text = values.dtype.kind == "U" and not values.ndim
        return name, str(values) if text else handle_of(values) or values
    sizes = np.frombuffer(_next(parts).data, dtype=order + "i4")
    name = bytes(_next(parts).data).decode("ascii")
    if number_class == _CELL:
        return name, [_variable(part.data, order, depth + 1)[1] for part in parts if part.kind == _MATRIX]
    if number_class == _OBJECT and is_model(kind := bytes(_next(parts).data).decode("ascii")):
        return name, Thing(kind, {})
    return name, _structures(parts, order, math.prod(int(n) for n in sizes), depth)


def _structures(parts: Iterator[_Element], order: str, count: int, depth: int) -> Node:
    """One structure as a dictionary of nodes, several as a list of them."""
    fields = _field_names(parts, order)
    count = count if fields else 0
    rows = [{key: _variable(_next(parts).data, order, depth + 1)[1] for key in fields} for _ in range(count)]
    return rows[0] if len(rows) == 1 else rows


def _field_names(parts: Iterator[_Element], order: str) -> list[str]:
    length = struct.unpack_from(order + "i", _next(parts).data)[0]
    raw = bytes(_next(parts).data)
    if length <= 0 or len(raw) % length:
        raise ValueError("a structure has no names of its fields")
    return [raw[k : k + length].split(b"\0")[0].decode("ascii") for k in range(0, len(raw), length)]


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
        return name, values + 1j * _numbers(_next(parts), name, sizes, order) if word & 0x0800 else values
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


def _inflated(path: Path, data: memoryview, so_far: int) -> bytes:
    """Deflated data, whole; raises `ValueError` where it grows too far, with `so_far` bytes unpacked before."""
    most = most_bytes(path) - so_far
    unpack = zlib.decompressobj()
    out = unpack.decompress(data, max(most, 0) + 1)
    if len(out) > most:
        raise ValueError(f"{path.stat().st_size} bytes that would become more than {most_bytes(path)}")
    if not unpack.eof:
        raise ValueError("a deflated part is cut short")
    return out
