"""Verdicts in a file of their own, for a later check to be compared with."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from loopshape import __version__
from loopshape.core.errors import UnreadableInputError, WrongUseError
from loopshape.data.control.controller import Controller
from loopshape.data.control.scheduled import Scheduled
from loopshape.data.requirement.requirements import LIMIT_OF
from loopshape.data.result.margins import IN_EVERY_FILE, Margins
from loopshape.data.result.verdict import Order, RequirementResult, Verdict
from loopshape.io.config_table import refuse_doubles
from loopshape.io.files import make_folder, read_json, reading, write_json
from loopshape.io.run.run_tables import Schedule
from loopshape.io.schema import read, table_of

FORMAT = "loopshape-verdict/3"
#: what the first version called fields of a requirement's line and of what a detuning loses
_BEFORE = {"wished": "required", "found": "value", "spare": "slack"}
_AGAIN = "write it again: loopshape check ... --save-verdict"


def write_verdicts(path: Path, found: Sequence[Verdict]) -> None:
    """Write verdicts whole, with their controllers and a mark of the data of each operating point.

    Nothing in it depends on when or where it was written. NaN and infinite numbers stand as "nan", "inf" and "-inf".
    Refuses no verdict, two of one loop, and one that no check made.
    """
    if not found:
        raise WrongUseError("a file of verdicts holds at least one", "none", "check a loop first")
    refuse_doubles((part.loop for one in found for part in one.parts), path.name, "verdicts")
    for one in found:
        _refuse_unmarked(one, WrongUseError)
    make_folder(path.parent)
    write_json(path, {"format": FORMAT, "loopshape": __version__, "loops": [_table(one) for one in found]})


def _refuse_unmarked(found: Verdict, kind: type[Exception]) -> None:
    if set(found.data) != set(found.margins) or not found.margins:
        raise kind("the operating points of data and margins differ: a verdict that is kept is made by check")


def _table(one: Verdict, whole: bool = True) -> dict[str, Any]:
    return {
        "loop": one.loop,
        "outcome": one.outcome,
        **({"controllers": [_controller(own) for own in one.controllers]} if whole else {}),
        "data": one.data,
        "lines": one.lines,
        "margins": {name: m.table() for name, m in one.margins.items()},
        "warnings": one.warnings,
        **({"orders": one.orders} if one.orders else {}),
        **({"each": [_table(part, whole=False) for part in one.each]} if one.each else {}),
    }


def _controller(one: Controller | Scheduled) -> dict[str, Any]:
    if isinstance(one, Scheduled):
        return {"name": one.loop, "rate_hz": one.rate_hz, **one.to_table()}
    return table_of(one)


def read_verdicts(path: Path) -> tuple[Verdict, ...]:
    """The verdicts of a file.

    Refuses a file that is missing, of another kind or another version, damaged, or whose outcomes are not those of its
    own lines: such a file was changed by hand.
    """
    data = read_json(path)
    found = data.get("format") if isinstance(data, dict) else None
    if found == "loopshape-verdict/1":
        data, found = _renamed(data), "loopshape-verdict/2"
    later = isinstance(found, str) and found.startswith("loopshape-verdict/")
    if found not in (FORMAT, "loopshape-verdict/2"):
        raise UnreadableInputError(
            f"{path} is not of the format {FORMAT}",
            f"format = {found!r}" if found is not None else "another file",
            f"it was written by another version of loopshape: {_AGAIN}" if later else _AGAIN,
        )
    with reading(path, "verdicts", WrongUseError):
        loops = [_listed(one) for one in data["loops"]] if found != FORMAT else data["loops"]
        verdicts: Any = tuple(read(VerdictTable, table, path.name, own=True) for table in loops)
        refuse_doubles((part.loop for one in verdicts for part in one.parts), path.name, "verdicts")
        if any(not one.controllers for one in verdicts):
            raise WrongUseError("a verdict in a file has its controllers", "none")
    if not verdicts:
        raise UnreadableInputError(f"{path} holds no verdict", "an empty list", _AGAIN)
    return tuple(verdicts)


def _renamed(data: Any, by_name: bool = False) -> Any:
    """A file of version 1 in the words of version 2, keys that are names as they are; a damaged one stays so."""
    if isinstance(data, list):
        return [_renamed(one) for one in data]
    if not isinstance(data, dict):
        return data
    return {k if by_name else _BEFORE.get(k, k): _renamed(v, k in ("data", "margins")) for k, v in data.items()}


def _listed(table: Any) -> dict[str, Any]:
    """A verdict of version 2, which has one controller, as this version has it."""
    return {**{k: v for k, v in table.items() if k != "controller"}, "controllers": [table["controller"]]}


@dataclass(frozen=True)
class VerdictTable:
    """A verdict in its file, with what it was made from; those `each` have the controllers of the whole."""

    loop: str
    outcome: str
    data: Mapping[str, str]
    lines: tuple[RequirementResult, ...]
    margins: Mapping[str, Margins]
    warnings: tuple[str, ...]
    controllers: tuple[Controller | Schedule, ...] = ()
    orders: tuple[Order, ...] = ()
    each: tuple[VerdictTable, ...] = field(default=())

    @classmethod
    def unfolded(cls, table: Mapping[str, Any]) -> dict[str, Any]:
        """The table with the readings of margins each by itself."""
        return {**table, "margins": {name: _with_readings(one) for name, one in table["margins"].items()}}

    def made(self) -> Verdict:
        """The verdict; refuses an outcome that is not that of its lines."""
        own: Any = self.controllers
        each: Any = tuple(replace(one, controllers=own) for one in self.each)
        found = Verdict(self.loop, self.lines, self.margins, self.warnings, each, self.orders, own, self.data)
        if found.outcome != self.outcome:
            raise ValueError(f"outcome {self.outcome!r}, and its lines say {str(found.outcome)!r}")
        _refuse_unmarked(found, ValueError)
        return found


def _with_readings(table: Mapping[str, Any]) -> dict[str, Any]:
    """Margins from values by name, with intervals, frequencies and bounds by the same."""
    rest = {name: value for name, value in table.items() if name not in LIMIT_OF}
    readings: dict[str, Any] = {x: {"value": table[x]} for x in LIMIT_OF if x in IN_EVERY_FILE or x in table}
    for key, named in (("interval", "intervals"), ("at_hz", "at_hz"), ("bound", "bounds")):
        for name, value in rest.pop(named, {}).items():
            readings.setdefault(name, {})[key] = value
    return rest | {"readings": readings}
