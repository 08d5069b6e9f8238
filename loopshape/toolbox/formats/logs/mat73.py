"""MAT files of version 7.3: HDF5 with every array's axes reversed, cells and lists of structures behind references.

Links to other files are not followed, nor are datasets that lie outside. Arrays stay in the file until they are asked
for. Objects lie under `#subsystem#/MCOS` (`mcos`).
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from loopshape.core.stretches import LONG, LongSignal
from loopshape.core.units import Array
from loopshape.io.files import reading
from loopshape.io.size_limit import check_growth
from loopshape.toolbox.formats.logs.mat_tree import DEEPEST, MatContent, Node, Thing, is_model
from loopshape.toolbox.formats.logs.mcos import Objects, handle_of

_KIND = "MAT v7.3"
_MOST_NODES = 200_000
_MOST_LETTERS = 4096


def read_mat73(path: Path) -> MatContent:
    """Signals of a file by name: datasets by their path in it, and arrays that objects state without storing them."""
    import h5py

    with reading(path, _KIND), h5py.File(path, "r") as file:
        tree = _Tree(path, file)
        found = MatContent(tree.load, tree.things)
        for name in file:
            if not name.startswith("#") and _lies_here(file, name):
                found.add(name, tree.node(file[name], 0))
        found.arrays = {name: n.name if isinstance(n, h5py.Dataset) else n for name, n in found.arrays.items()}
    return found


def mat73_array(path: Path, place: str | np.ndarray) -> np.ndarray:
    """An array in MATLAB's shape, by its path in the file or as it was stated."""
    import h5py

    if not isinstance(place, str):
        return place
    with reading(path, _KIND), h5py.File(path, "r") as file:
        return _array(path, file[place])


def mat73_long(path: Path, place: str | np.ndarray) -> LongSignal | None:
    """An array of one dimension that is too long to be loaded; None for others."""
    import h5py

    if not isinstance(place, str):
        return None
    with reading(path, _KIND), h5py.File(path, "r") as file:
        check_growth(path, file[place].nbytes)
        shape, kind = file[place].shape, file[place].dtype.kind
    if max(shape, default=0) < LONG or np.prod(shape) != max(shape) or kind not in "biuf":
        return None

    def stretch(start: int, stop: int) -> Array:
        with reading(path, _KIND), h5py.File(path, "r") as file:
            values = file[place]
            rows = tuple(slice(start, stop) if n == values.size else slice(None) for n in values.shape)
            return np.asarray(values[rows], dtype=float).ravel()

    return LongSignal(max(shape), stretch)


def _array(path: Path, dataset: Any) -> np.ndarray:
    check_growth(path, dataset.nbytes)
    return np.asarray(dataset[()]).T


class _Tree:
    """Nodes (`mat_tree`) of an open file."""

    def __init__(self, path: Path, file: Any) -> None:
        self._path, self._file, self._nodes = path, file, 0
        self._objects: Objects | None = None

    def load(self, node: Node) -> np.ndarray:
        """The values of a dataset."""
        values = node if isinstance(node, np.ndarray) else _array(self._path, node)
        return values["real"] + 1j * values["imag"] if values.dtype.names == ("real", "imag") else values

    def things(self, handle: Any) -> list[Any]:
        """The objects that a handle points at."""
        if self._objects is None:
            cells = self._cells_of_objects()
            self._objects = Objects(self.load(cells[0]).astype(np.uint8).tobytes(), cells, "<")
        return self._objects.of(handle)

    def _cells_of_objects(self) -> list[Node]:
        try:
            cells = self.node(self._file["#subsystem#"]["MCOS"], 0)
        except KeyError:
            cells = None
        if not isinstance(cells, list) or len(cells) < 3:
            raise ValueError("a variable holds an object, and the file's part of objects is missing")
        return cells

    def node(self, member: Any, depth: int) -> Node:
        """A group as a structure, references as a list, letters as a text; anything else stays a dataset."""
        import h5py

        self._nodes += 1
        if depth > DEEPEST or self._nodes > _MOST_NODES:
            raise ValueError(f"it holds more than {_MOST_NODES} members, or some more than {DEEPEST} deep")
        if isinstance(member, h5py.Group) and is_model(kind := _word(member, "MATLAB_class")):
            return Thing(kind, {})
        if isinstance(member, h5py.Group):
            return self._structure(member, depth)
        kind = _word(member, "MATLAB_class")
        if "MATLAB_empty" in member.attrs:  # its values are its sizes
            return "" if kind == "char" else [] if kind == "cell" else np.empty(0)
        if h5py.check_ref_dtype(member.dtype) is h5py.Reference:
            check_growth(self._path, member.nbytes)
            return [self.node(self._file[one], depth + 1) for one in np.asarray(member[()]).T.ravel(order="F") if one]
        if kind == "char":
            letters = self.load(member) if member.size <= _MOST_LETTERS else np.empty(0)
            return "".join(map(chr, letters.ravel(order="F").tolist()))
        small = member.dtype == np.uint32 and member.size < _MOST_LETTERS
        return (handle_of(self.load(member)) if small else None) or member

    def _structure(self, group: Any, depth: int) -> Node:
        """One structure, or a list of them where every field is a list of references and nothing says it is a cell."""
        import h5py

        own = {key: group[key] for key in group if _lies_here(group, key)}
        many = [key for key, m in own.items() if _is_list(m)]
        if own and len(many) == len(own) and "MATLAB_class" in group.attrs:
            fields = {key: self.node(m, depth + 1) for key, m in own.items()}
            counts = {len(values) for values in fields.values()}
            if len(counts) == 1:
                return [dict(zip(fields, row, strict=True)) for row in zip(*fields.values(), strict=True)]
        return {key: self.node(m, depth + 1) for key, m in own.items() if isinstance(m, h5py.Group | h5py.Dataset)}


def _is_list(member: Any) -> bool:
    """Whether a field holds one reference for each structure of a list: references, and no class of its own."""
    import h5py

    refers = isinstance(member, h5py.Dataset) and h5py.check_ref_dtype(member.dtype) is h5py.Reference
    return refers and "MATLAB_class" not in member.attrs


def _word(member: Any, name: str) -> str:
    value = member.attrs.get(name, b"")
    return value.decode("ascii", "replace") if isinstance(value, bytes) else str(value)


def _lies_here(group: Any, key: str) -> bool:
    """Whether a member lies in this file itself."""
    import h5py

    if not isinstance(group.get(key, getlink=True), h5py.HardLink):
        return False
    member = group[key]
    return not isinstance(member, h5py.Dataset) or not (member.is_virtual or member.external)
