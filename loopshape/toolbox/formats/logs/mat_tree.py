"""What the variables of a MAT file hold, as signals by name: structures, cells, tables and Simulink's objects.

The readers of both kinds of file (`mat5`, `mat73`) make nodes: an array (or a dataset that is loaded later), a text, a
dictionary (a structure), a list (a cell, or a list of structures), a `Handle` (objects, kept elsewhere in the file), or
a `Thing` (an object of an older kind, kept in its place).

| class | signals | source |
|---|---|---|
| timeseries | the object's name, `time of NAME`; its unit | `Data_`, `Time_`, `TimeInfo` |
| Simulink.SimulationData.Dataset | `outer.ELEMENT` by each element's name | `Storage.Elements`, `Values` of a signal |
| table, timetable | `outer.VARIABLE`; `time of outer.VARIABLE` | `data`, `varNames`, `rowTimes` |
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from loopshape.core.errors import UnreadableInputError
from loopshape.core.units import UNITS
from loopshape.toolbox.formats.drafts.column_words import unit_of_word
from loopshape.toolbox.formats.logs.mdf4 import TIME_OF

#: structures and cells within each other; objects within objects (they may point back); members of a file, all counted
DEEPEST, DEEPEST_OBJECT, MOST = 16, 8, 200_000
_LABELS = ("Name", "name", "label", "Label", "blockName")
#: members that a Simulink object keeps its elements in; they stand in no signal's name
_WITHIN = {"any", "Storage", "Storage_", "Elements", "Elements_", "Values"}
_SIMULINK = "Simulink."
_CLOSED = "MatFileDatasetStorage"  # its signals lie in records that no document describes
#: MATLAB's objects of models and of data in parts of their own: no signals by name (`iddata`: its OutputData, by hand)
_MODELS = {"iddata", "idfrd", "idss", "idtf", "idpoly", "idproc", "idgrey", "tf", "ss", "zpk", "frd", "pid", "genss"}
_SECONDS = {"weeks": 604800.0, "days": 86400.0, "hours": 3600.0, "minutes": 60.0, "milliseconds": 1e-3,
            "microseconds": 1e-6, "nanoseconds": 1e-9}  # fmt: skip

Node = Any


@dataclass(frozen=True, eq=False)
class Handle:
    """What stands in the place of objects: their marks (n,), which `Objects` resolves."""

    marks: np.ndarray


@dataclass(frozen=True)
class Thing:
    """An object: its class, and its properties as nodes."""

    kind: str
    properties: Mapping[str, Node]


@dataclass
class MatContent:
    """Signals of a file by name (arrays, or datasets loaded later), their units, and objects that stay closed."""

    load: Callable[[Node], np.ndarray]
    things: Callable[[Handle], Sequence[Thing]]
    arrays: dict[str, Node] = field(default_factory=dict)
    units: dict[str, str] = field(default_factory=dict)
    closed: list[str] = field(default_factory=list)
    looked_at: int = 0

    def add(self, name: str, node: Node, depth: int = 0) -> None:
        """Everything within a node under its name; `ValueError` for what lies too deep or is too much."""
        self.looked_at += 1
        if depth > DEEPEST or self.looked_at > MOST:
            raise ValueError(f"{name} lies more than {DEEPEST} deep, or it holds more than {MOST} members")
        if isinstance(node, dict):
            for key, value in node.items():
                self.add(f"{name}.{key}", value, depth + 1)
        elif isinstance(node, list):
            self._list(name, node, depth)
        elif isinstance(node, Thing):
            self._thing(name, node, depth + 1)
        elif isinstance(node, Handle) and depth > DEEPEST_OBJECT:
            self.closed.append(name)
        elif isinstance(node, Handle):
            things = self.things(node)
            for k, thing in enumerate(things, start=1):
                self._thing(name if len(things) == 1 else f"{name}({k})", thing, depth + 1)
        elif not isinstance(node, str):
            self.arrays[name] = node

    def _list(self, name: str, nodes: Sequence[Node], depth: int) -> None:
        """Members of a cell that hold something, and a list of structures; a cell of texts or numbers stays closed."""
        labels = _labels([self._label(node) for node in nodes])
        for k, (node, label) in enumerate(zip(nodes, labels, strict=True), start=1):
            if isinstance(node, dict | list | Handle):
                self.add(f"{name}.{label}" if label else name if len(nodes) == 1 else f"{name}({k})", node, depth + 1)

    def _label(self, node: Node) -> str:
        """The name that a structure or an object bears, "" for none."""
        members: Mapping[str, Node] = node if isinstance(node, dict) else {}
        if isinstance(node, Handle):
            things = self.things(node)
            members = things[0].properties if len(things) == 1 else {}
        return next((members[key] for key in _LABELS if isinstance(members.get(key), str)), "")

    def _thing(self, name: str, thing: Thing, depth: int) -> None:
        kind, inner = thing.kind, thing.properties
        if kind.lower().endswith("timeseries"):
            self._series(name, inner)
        elif kind == "timetable" and isinstance(table := inner.get("any"), dict):
            self._table(name, table, "varNames", "varUnits")
        elif kind == "table":
            props = inner.get("props")
            units = {"VariableUnits": props.get("VariableUnits")} if isinstance(props, dict) else {}
            self._table(name, {**inner, **units}, "varnames", "VariableUnits")
        elif kind.endswith(_CLOSED):
            self.closed.append(f"{name} ({kind})")
        else:
            self._others(name, kind, inner, depth)

    def _others(self, name: str, kind: str, inner: Mapping[str, Node], depth: int) -> None:
        if is_model(kind):
            self.closed.append(f"{name} ({kind})")
            return
        for key, value in inner.items():
            if key == "any" and isinstance(value, dict):  # what the class itself said to save
                self._others(name, kind, value, depth + 1)
            elif kind.startswith(_SIMULINK):
                if key in _WITHIN:
                    self.add(name, value, depth + 1)
            else:
                self.add(f"{name}.{key}", value, depth + 1)

    def _series(self, name: str, inner: Mapping[str, Node]) -> None:
        """Values (n, m) over time, and their stamps in s."""
        data = self._first(inner, "Data_", "Data")
        if data is None:
            return
        info = self._members(inner.get("TimeInfo"))
        times = self._first(inner, "Time_", "Time")
        values, t = self.load(data), None if times is None else self.load(times).ravel()
        t = _even_times(info, self._number) if t is None else t
        if t is None or t.size not in (values.shape[0], values.shape[-1]):
            raise ValueError(f"{name} has no time for each of its values")
        values = values if values.shape[0] == t.size else np.moveaxis(values, -1, 0)
        self._stamped(name, values.reshape(t.size, -1), t * _SECONDS.get(str(info.get("Units", "")).lower(), 1.0))
        self._unit(name, self._members(inner.get("DataInfo")).get("Units"))

    def _stamped(self, name: str, values: np.ndarray, t_s: np.ndarray) -> None:
        self.arrays[name] = values.ravel() if values.shape[1] == 1 else values
        self.arrays[TIME_OF + name] = t_s
        self.units[TIME_OF + name] = "s"

    def _unit(self, name: str, stated: Node) -> None:
        """The unit of a signal, as text or as Simulink's object of it."""
        stated = self._members(stated).get("Name", stated) if isinstance(stated, Handle) else stated
        if isinstance(stated, str) and stated and unit_of_word(stated) in UNITS:
            self.units[name] = stated

    def _table(self, name: str, table: Mapping[str, Node], names_key: str, units_key: str) -> None:
        """Columns of numbers of a table, and the stamps of its rows where it has some."""
        columns, names, units = (table.get(key) or [] for key in ("data", names_key, units_key))
        t_s = self._row_times(table.get("rowTimes"), table.get("numRows"))
        for k, (node, label) in enumerate(zip(columns, names, strict=False)):
            if isinstance(node, str | list | dict):
                continue
            values = self._row_times(node, None) if isinstance(node, Handle) else self.load(node)
            if values is None or values.dtype.kind not in "biuf":
                continue
            own = f"{name}.{label}"
            values = values.reshape(values.shape[0], -1)
            if t_s is not None and t_s.size == values.shape[0]:
                self._stamped(own, values, t_s)
            else:
                self.arrays[own] = values.ravel() if values.shape[1] == 1 else values
            if isinstance(node, Handle):
                self.units[own] = "s"
            self._unit(own, units[k] if k < len(units) else None)

    def _row_times(self, stated: Node, rows: Node) -> np.ndarray | None:
        """Stamps in s of a duration or a datetime (since 1970), or of a step or rate that a structure states."""
        if isinstance(stated, Handle):
            inner = self._members(stated)
            node = next((inner[key] for key in ("millis", "data") if key in inner), None)
            return None if node is None else np.real(self.load(node)).ravel().astype(float) / 1e3
        if not isinstance(stated, dict) or rows is None:
            return None
        start = self._row_times(stated.get("origin"), None)
        rate, step = stated.get("sampleRate"), self._row_times(stated.get("stepSize"), None)
        every = 1.0 / self._number(rate) if self._number(stated.get("specifiedAsRate")) or step is None else step[0]
        return float(start[0] if start is not None else 0.0) + every * np.arange(int(self._number(rows)))

    def _members(self, node: Node) -> Mapping[str, Node]:
        if isinstance(node, Handle):
            things = self.things(node)
            return things[0].properties if things else {}
        return node if isinstance(node, dict) else {}

    def _first(self, inner: Mapping[str, Node], *names: str) -> Node | None:
        """The first of these members that holds numbers."""
        found = (inner.get(name) for name in names)
        return next((n for n in found if n is not None and not isinstance(n, str | list | dict) and n.size), None)

    def _number(self, node: Node) -> float:
        """The number that a node holds, or nan."""
        if node is None or isinstance(node, str | list | dict | Handle) or node.size != 1:
            return float("nan")
        return float(np.real(self.load(node).ravel()[0]))


def is_model(kind: str) -> bool:
    """Whether a class is one of MATLAB's models, or its data with parts of their own."""
    return kind.rpartition(".")[2] in _MODELS


def _labels(found: Sequence[str]) -> Sequence[str]:
    """Labels where each has one of its own, else none."""
    return found if all(found) and len(set(found)) == len(found) else [""] * len(found)


def _even_times(info: Mapping[str, Node], number: Callable[[Node], float]) -> np.ndarray | None:
    """Stamps that a series' TimeInfo states by start, step and length; None where it does not."""
    keys = ("Start_", "Increment_", "Length")
    start, step, length = (number(info.get(key, info.get(key.rstrip("_")))) for key in keys)
    return start + step * np.arange(int(length)) if np.isfinite(start + step + length) and length > 0 else None


def refuse_closed(path: Path, found: MatContent) -> None:
    """Refuse a file whose signals all lie in objects that stay closed: Simulink's records, MATLAB's models."""
    if found.closed and not found.arrays:
        if all(is_model(one.rpartition("(")[2].rstrip(")")) for one in found.closed):
            raise UnreadableInputError(
                f"{path.name} holds objects of MATLAB and no signals", ", ".join(found.closed[:3]),
                "in MATLAB save arrays: u = data.InputData; y = data.OutputData; Ts = data.Ts; save('r.mat', 'u', 'y',"
                " 'Ts'); of a model save its frequency response",
            )  # fmt: skip
        raise UnreadableInputError(
            f"{path.name} keeps its signals in Simulink's own records", ", ".join(found.closed[:3]),
            "in MATLAB save it again without -v7.3, or save the Values (timeseries) of its elements",
        )  # fmt: skip
