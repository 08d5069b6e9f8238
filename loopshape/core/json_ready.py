"""Values as JSON knows them: the one place where nouns become plain words, numbers and lists."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from math import isfinite, isnan
from typing import Any

from loopshape.core.errors import WrongUseError


def named(noun: Any, *names: str) -> dict[str, Any]:
    """Fields and properties of a noun by name, for JSON."""
    return {name: getattr(noun, name) for name in names}


def json_ready(value: Any, unknown: str | None = "nan") -> Any:
    """The value in words that JSON knows, nan as `unknown`; refuses what has none (complex numbers, functions)."""
    if hasattr(value, "tolist"):  # numpy's arrays and numbers
        value = value.tolist()
    if value is None or isinstance(value, bool | int | str):
        return value
    if isinstance(value, float):
        return value if isfinite(value) else unknown if isnan(value) else str(value)
    if isinstance(value, Mapping):
        return {str(k): json_ready(v, unknown) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [json_ready(v, unknown) for v in value]
    if is_dataclass(value) and not isinstance(value, type):
        return {f.name: json_ready(getattr(value, f.name), unknown) for f in fields(value)}
    raise WrongUseError("a value has no form in JSON", repr(value)[:80], "turn it into numbers, words or lists")
