"""Values as JSON knows them: the one place where nouns become plain words, numbers and lists."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from math import isfinite, isnan
from pathlib import PurePath
from typing import Any, ClassVar

from loopshape.core.errors import WrongUseError


def keys(*names: str, **paths: str) -> dict[str, str]:
    """Keys of a JSON object and where each is found: fields and properties by name, others by a path as "band_hz.0"."""
    return {name: name for name in names} | paths


def _found(noun: Any, path: str) -> Any:
    """What stands at the end of a path; None where something on the way is None."""
    for step in path.split("."):
        if noun is None:
            return None
        noun = noun[int(step)] if step.isdigit() else getattr(noun, step)
    return noun


class Plain:
    """A noun that has a form in JSON: its fields and those of `ALSO`, or what `IN_JSON` lists instead of all."""

    IN_JSON: ClassVar[Mapping[str, str]] = {}
    ALSO: ClassVar[Mapping[str, str]] = {}

    def to_dict(self) -> dict[str, Any]:
        """Plain values for JSON; what is not known is None."""
        paths = self.IN_JSON or keys(*(f.name for f in fields(self)), **self.ALSO)  # type: ignore[arg-type]
        return {key: json_ready(_found(self, path), None) for key, path in paths.items()}


def json_ready(value: Any, unknown: str | None = "nan") -> Any:
    """The value in words that JSON knows, nan as `unknown`; refuses what has none (complex numbers, functions).

    With None for what is unknown it is an answer, in which nouns stand by their `to_dict` or as in their files; else it
    is part of a file that is read back, with all their fields and nothing else.
    """
    if hasattr(value, "tolist"):  # numpy's arrays and numbers
        value = value.tolist()
    if value is None or isinstance(value, bool | int | str):
        return value
    if isinstance(value, float):
        return value if isfinite(value) else unknown if isnan(value) else str(value)
    if unknown is None and hasattr(value, "to_dict"):
        return value.to_dict()
    if isinstance(value, Mapping):
        return {str(k): json_ready(v, unknown) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [json_ready(v, unknown) for v in value]
    if isinstance(value, PurePath):
        return str(value)
    if unknown is None and hasattr(value, "to_table"):
        return json_ready(value.to_table(), None)
    if is_dataclass(value) and not isinstance(value, type):
        return {f.name: json_ready(getattr(value, f.name), unknown) for f in fields(value)}
    raise WrongUseError("a value has no form in JSON", repr(value)[:80], "turn it into numbers, words or lists")
