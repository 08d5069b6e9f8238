"""Verdicts in a file of their own, for a later check to be compared with."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import fields, is_dataclass, replace
from enum import StrEnum
from pathlib import Path
from types import UnionType
from typing import Any, Union, cast, get_args, get_origin, get_type_hints

from loopshape import __version__
from loopshape.core.errors import UnreadableInputError, WrongUseError
from loopshape.data.requirement.requirements import LIMIT_OF
from loopshape.data.result.baseline import Checked
from loopshape.data.result.margins import Margins
from loopshape.data.result.verdict import RequirementResult, Verdict
from loopshape.io.config_table import ConfigTable, refuse_doubles
from loopshape.io.files import make_folder, read_json, reading, write_json
from loopshape.io.run.run_tables import controller_table, read_controller

FORMAT = "loopshape-verdict/2"
#: what the first version called fields of a requirement's line and of what a detuning loses
_BEFORE = {"wished": "required", "found": "value", "spare": "slack"}
_KEYS = {"loop", "outcome", "controller", "data", "lines", "margins", "warnings"}
#: what stands beside the values of margins, each by the names of limits
_NAMED: dict[str, Any] = {"intervals": tuple[float, float], "at_hz": float, "bounds": float}
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
    verdict, controller = one.verdict, one.controller
    return {
        "loop": verdict.loop,
        "outcome": verdict.outcome,
        "controller": {"name": controller.loop, "rate_hz": controller.rate_hz, **controller_table(controller)},
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
        verdicts = tuple(_read(table, path.name) for table in data["loops"])
        refuse_doubles((one.verdict.loop for one in verdicts), path.name, "verdicts")
    if not verdicts:
        raise UnreadableInputError(f"{path} holds no verdict", "an empty list", _AGAIN)
    return verdicts


def _upgraded(data: Any, by_name: bool = False) -> Any:
    """A file of the first version in the words of this one, keys that are names as they are; a damaged one stays so."""
    if isinstance(data, list):
        return [_upgraded(one) for one in data]
    if not isinstance(data, dict):
        return data
    return {k if by_name else _BEFORE.get(k, k): _upgraded(v, k in ("data", "margins")) for k, v in data.items()}


def _read(table: Mapping[str, Any], where: str) -> Checked:
    _only(table, _KEYS)
    margins = {str(name): _margins(one) for name, one in table["margins"].items()}
    lines = tuple(_noun(RequirementResult, one) for one in table["lines"])
    verdict = Verdict(str(table["loop"]), lines, margins, tuple(map(str, table["warnings"])))
    if verdict.outcome != table["outcome"]:
        raise ValueError(f"outcome {table['outcome']!r}, and its lines say {str(verdict.outcome)!r}")
    words = ConfigTable(table["controller"], where)
    controller = read_controller(words, words.positive("rate_hz"))
    data = {str(name): str(mark) for name, mark in table["data"].items()}
    if set(data) != set(margins) or not margins:
        raise ValueError("the operating points of data and margins differ")
    return Checked(verdict, controller, data)


def _margins(table: Mapping[str, Any]) -> Margins:
    """Margins from values by name, with intervals, frequencies and bounds by the same, and all other fields."""
    named = {key: {x: _typed(kind, one) for x, one in table.get(key, {}).items()} for key, kind in _NAMED.items()}
    first = list(LIMIT_OF)[:10]  # which every file has
    values = {name: _typed(float, table[name]) for name in LIMIT_OF if name in first or name in table}
    rest = {name: value for name, value in table.items() if name not in {*LIMIT_OF, *_NAMED}}
    bare = _noun(Margins, {"readings": {}, **rest})
    return replace(bare, readings=Margins.of(values, bare.stable, **named).readings)


def _only(table: Mapping[str, Any], known: set[str]) -> None:
    if unknown := set(table) - known:
        raise ValueError(f"unknown keys {', '.join(sorted(unknown))}")


def _noun(kind: type, table: Mapping[str, Any]) -> Any:
    """A dataclass from its table, each field as its type says; fields that it may lack keep their defaults."""
    _only(table, {f.name for f in fields(kind)})
    hints = get_type_hints(kind)
    return kind(**{name: _typed(hints[name], value) for name, value in table.items()})


def _typed(hint: Any, value: Any) -> Any:
    """A value from JSON as a type says; refuses one of another kind."""
    origin, args = get_origin(hint), get_args(hint)
    if is_dataclass(hint):
        return _noun(cast(type, hint), value)
    if origin in (Union, UnionType):
        (inner,) = (x for x in args if x is not type(None))
        return None if value is None else _typed(inner, value)
    if origin is tuple:
        inners = [args[0]] * len(value) if args[-1] is Ellipsis else list(args)
        return tuple(_typed(inner, one) for inner, one in zip(inners, value, strict=True))
    if origin is not None:  # Mapping[str, inner]
        return {str(name): _typed(args[1], one) for name, one in value.items()}
    if issubclass(hint, StrEnum) and isinstance(value, str) and value not in list(hint):
        raise ValueError(f"{value!r} is no outcome")
    kinds = (str, int, float) if hint is float else str if issubclass(hint, str) else hint
    if isinstance(value, bool) != (hint is bool) or not isinstance(value, kinds):
        raise TypeError(f"{value!r} is no {hint.__name__}")
    return hint(value)
