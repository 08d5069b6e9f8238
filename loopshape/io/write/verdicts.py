"""Verdicts in a file of their own, for a later check to be compared with."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from loopshape import __version__
from loopshape.core.errors import UnreadableInputError, WrongUseError
from loopshape.data.control.controller import Controller
from loopshape.data.requirement.requirements import LIMIT_OF
from loopshape.data.result.baseline import Checked
from loopshape.data.result.margins import Margins
from loopshape.data.result.verdict import RequirementResult, Verdict
from loopshape.io.config_table import refuse_doubles
from loopshape.io.files import make_folder, read_json, reading, write_json
from loopshape.io.schema import read, table_of

FORMAT = "loopshape-verdict/2"
#: what the first version called fields of a requirement's line and of what a detuning loses
_BEFORE = {"wished": "required", "found": "value", "spare": "slack"}
_AGAIN = "write it again: loopshape check ... --save-verdict"


def write_verdicts(path: Path, found: Sequence[Checked]) -> None:
    """Write the verdicts of all loops whole, with their controllers and a mark of the data of each operating point.

    Nothing in it depends on when or where it was written. NaN and infinite numbers stand as "nan", "inf" and "-inf".
    Refuses no verdict, and two of one loop.
    """
    if not found:
        raise WrongUseError("a file of verdicts holds at least one", "none", "check a loop first")
    refuse_doubles((one.verdict.loop for one in found), path.name, "verdicts")
    make_folder(path.parent)
    write_json(path, {"format": FORMAT, "loopshape": __version__, "loops": [_table(one) for one in found]})


def _table(one: Checked) -> dict[str, Any]:
    verdict = one.verdict
    return {
        "loop": verdict.loop,
        "outcome": verdict.outcome,
        "controller": table_of(one.controller),
        "data": one.data,
        "lines": list(verdict.lines),
        "margins": {name: one.table() for name, one in verdict.margins.items()},
        "warnings": list(verdict.warnings),
    }


def read_verdicts(path: Path) -> tuple[Checked, ...]:
    """The verdicts of a file.

    Refuses a file that is missing, of another kind or another version, damaged, or whose outcomes are not those of its
    own lines: such a file was changed by hand.
    """
    data = read_json(path)
    found = data.get("format") if isinstance(data, dict) else None
    if found == "loopshape-verdict/1":
        data, found = _upgraded(data), FORMAT
    if found != FORMAT:
        later = isinstance(found, str) and found.startswith("loopshape-verdict/")
        raise UnreadableInputError(
            f"{path} is not of the format {FORMAT}",
            f"format = {found!r}" if found is not None else "another file",
            f"it was written by another version of loopshape: {_AGAIN}" if later else _AGAIN,
        )
    with reading(path, "verdicts", WrongUseError):
        verdicts: Any = tuple(read(CheckedTable, table, path.name, own=True) for table in data["loops"])
        refuse_doubles((one.verdict.loop for one in verdicts), path.name, "verdicts")
    if not verdicts:
        raise UnreadableInputError(f"{path} holds no verdict", "an empty list", _AGAIN)
    return tuple(verdicts)


def _upgraded(data: Any, by_name: bool = False) -> Any:
    """A file of the first version in the words of this one, keys that are names as they are; a damaged one stays so."""
    if isinstance(data, list):
        return [_upgraded(one) for one in data]
    if not isinstance(data, dict):
        return data
    return {k if by_name else _BEFORE.get(k, k): _upgraded(v, k in ("data", "margins")) for k, v in data.items()}


@dataclass(frozen=True)
class CheckedTable:
    """A verdict in its file, with what it was made from."""

    loop: str
    outcome: str
    controller: Controller
    data: Mapping[str, str]
    lines: tuple[RequirementResult, ...]
    margins: Mapping[str, Margins]
    warnings: tuple[str, ...]

    @classmethod
    def unfolded(cls, table: Mapping[str, Any]) -> dict[str, Any]:
        """The table with the readings of margins each by itself."""
        return {**table, "margins": {name: _with_readings(one) for name, one in table["margins"].items()}}

    def made(self) -> Checked:
        """The verdict; refuses an outcome that is not that of its lines."""
        verdict = Verdict(self.loop, self.lines, self.margins, self.warnings)
        if verdict.outcome != self.outcome:
            raise ValueError(f"outcome {self.outcome!r}, and its lines say {str(verdict.outcome)!r}")
        if set(self.data) != set(self.margins) or not self.margins:
            raise ValueError("the operating points of data and margins differ")
        return Checked(verdict, self.controller, self.data)


def _with_readings(table: Mapping[str, Any]) -> dict[str, Any]:
    """Margins from values by name, with intervals, frequencies and bounds by the same."""
    rest = {name: value for name, value in table.items() if name not in LIMIT_OF}
    first = list(LIMIT_OF)[:10]  # which every file has
    readings: dict[str, Any] = {x: {"value": table[x]} for x in LIMIT_OF if x in first or x in table}
    for key, named in (("interval", "intervals"), ("at_hz", "at_hz"), ("bound", "bounds")):
        for name, value in rest.pop(named, {}).items():
            readings.setdefault(name, {})[key] = value
    return rest | {"readings": readings}
