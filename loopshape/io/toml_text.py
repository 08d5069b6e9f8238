"""TOML as a person would write it: numbers first, then tables, with small tables on one line."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

from loopshape.core.errors import WrongUseError

_BARE = re.compile(r"[A-Za-z0-9_-]+")


def toml_text(data: Mapping[str, Any]) -> str:
    """Text of a TOML file: `[table]` and `[[table]]` at the top, inline tables below; None is left out."""
    top = {key: _plain(value) for key, value in data.items() if value is not None}
    lines = [_pair(key, value) for key, value in top.items() if not isinstance(value, dict) and not _is_tables(value)]
    for key, value in top.items():
        if isinstance(value, dict):
            lines += ["", f"[{_key(key)}]", *_pairs(value)]
        elif _is_tables(value):
            for table in value:
                lines += ["", f"[[{_key(key)}]]", *_pairs(table)]
    return "\n".join(lines).lstrip("\n") + "\n"


def _plain(value: Any) -> Any:
    """Mappings as dicts without None, tuples and arrays as lists, numpy numbers as numbers."""
    if hasattr(value, "tolist"):  # of numpy, which writing a file of words need not import
        return value.tolist()
    if isinstance(value, Mapping):
        return {str(k): _plain(v) for k, v in value.items() if v is not None}
    if isinstance(value, list | tuple):
        return [_plain(v) for v in value]
    return value


def _is_tables(value: Any) -> bool:
    return isinstance(value, list) and bool(value) and all(isinstance(v, dict) for v in value)


def _pairs(table: Mapping[str, Any]) -> list[str]:
    return [_pair(key, value) for key, value in table.items()]


def _pair(key: str, value: Any) -> str:
    if _is_tables(value):
        rows = "".join(f"  {_inline(table)},\n" for table in value)
        return f"{_key(key)} = [\n{rows}]"
    return f"{_key(key)} = {_inline(value)}"


def _inline(value: Any) -> str:
    if isinstance(value, dict):
        return "{ " + ", ".join(f"{_key(k)} = {_inline(v)}" for k, v in value.items()) + " }" if value else "{}"
    if isinstance(value, list):
        return "[" + ", ".join(_inline(v) for v in value) + "]"
    return _leaf(value)


def _leaf(value: Any) -> str:
    import tomli_w

    try:
        return tomli_w.dumps({"x": value}).removeprefix("x = ").rstrip("\n")
    except TypeError:
        raise WrongUseError("a value has no form in TOML", repr(value), "use numbers, words or lists") from None


def _key(key: str) -> str:
    import tomli_w

    return key if _BARE.fullmatch(key) else tomli_w.dumps({key: 0}).removesuffix(" = 0\n")
