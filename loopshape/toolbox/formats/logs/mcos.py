"""Objects in MAT files: classes and properties, kept in a part of its own that variables point into.

MathWorks does not document it; the layout is the one that the readers mat-io (BSD) and matio (BSD) share. A first cell
holds a table of whole numbers: a version, the count of names, eight offsets, the names, then regions of classes (4
numbers each), properties as the class saves itself, objects (6 numbers), and plain properties; the cells that follow
hold the values, the last one each class's defaults.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import pairwise

import numpy as np

from loopshape.toolbox.formats.logs.mat_tree import Handle, Node, Thing

#: first number of an object's marks
MAGIC = 0xDD000000
_BEHIND = {2: 1, 3: 2, 4: 3}  # cells behind the values, by version
_HEAD = 40  # bytes before the names


def handle_of(values: np.ndarray) -> Handle | None:
    """The handle that an array is, if it is one: uint32, the magic number, sizes, marks and a class."""
    marks = values.ravel()
    most_marks = 4096
    if marks.dtype.kind != "u" or marks.dtype.itemsize != 4 or not 4 <= marks.size <= most_marks:
        return None
    return Handle(marks) if int(marks[0]) == MAGIC else None


class Objects:
    """The objects of a file: made of the cells of its part of objects, `numbers` being the first as bytes."""

    def __init__(self, numbers: bytes, cells: Sequence[Node], order: str) -> None:
        whole = np.frombuffer(numbers[: len(numbers) // 4 * 4], dtype=order + "u4")
        version = int(whole[0])
        if version not in _BEHIND or whole.size < _HEAD // 4:
            raise ValueError(f"objects of version {version}; 2 to 4 are read")
        ends = [int(end) for end in whole[2:10]]
        if any(end % 4 or not _HEAD <= end <= len(numbers) for end in ends[:5]) or ends[:5] != sorted(ends[:5]):
            raise ValueError("the table of objects is cut short")
        self._names = [part.decode("ascii") for part in numbers[_HEAD : ends[0]].split(b"\0") if part]
        self._classes, self._as_saved, self._objects, self._plain = (
            whole[start // 4 : end // 4].astype(int).tolist() for start, end in pairwise(ends[:5])
        )
        self._saved_at, self._plain_at = _starts(self._as_saved), _starts(self._plain)
        self._values, self._defaults = cells[2 : len(cells) - _BEHIND[version]], cells[-1]
        self._made: dict[int, Thing] = {}

    def of(self, handle: Handle) -> list[Thing]:
        """The objects that a handle points at; `ValueError` where it points at none."""
        marks = handle.marks.astype(int).tolist()
        sizes = marks[2 : 2 + marks[1]]
        count = int(np.prod(sizes)) if len(sizes) == marks[1] else -1
        ids = marks[2 + len(sizes) : -1]
        if count != len(ids):
            raise ValueError("an object's marks do not fit its size")
        return [self._thing(one) for one in ids if one]

    def _thing(self, number: int) -> Thing:
        if number not in self._made:
            try:
                row = self._objects[6 * number : 6 * number + 6]
                kind, saved, plain = row[0], row[3], row[4]
                table, at = (self._as_saved, self._saved_at[saved]) if saved else (self._plain, self._plain_at[plain])
                space, name = self._classes[4 * kind : 4 * kind + 2]
                title = (f"{self._name(space)}." if space else "") + self._name(name)
                self._made[number] = Thing(title, {**self._default(kind), **self._properties(table, at)})
            except IndexError:
                raise ValueError(f"object {number} is not in the table of objects") from None
        return self._made[number]

    def _name(self, number: int) -> str:
        if not 1 <= number <= len(self._names):
            raise ValueError(f"a name of number {number} of {len(self._names)}")
        return self._names[number - 1]

    def _default(self, kind: int) -> Mapping[str, Node]:
        found = self._defaults[kind] if isinstance(self._defaults, list) and kind < len(self._defaults) else None
        return found if isinstance(found, dict) else {}

    def _properties(self, table: Sequence[int], at: int) -> dict[str, Node]:
        found: dict[str, Node] = {}
        in_cell, inline = 1, 2
        for k in range(at + 1, at + 1 + 3 * table[at], 3):
            name, how, value = table[k : k + 3]
            if how == in_cell:
                found[self._name(name)] = self._values[value]
            elif how == inline:
                found[self._name(name)] = np.array(float(value))
        return found


def _starts(table: Sequence[int]) -> list[int]:
    """Where each record begins: a count, three numbers for each, and a pad to an even place."""
    starts, at = [], 0
    while at < len(table):
        starts.append(at)
        at += 1 + 3 * table[at]
        at += at % 2
    return starts
