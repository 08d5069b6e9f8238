"""What an FRF says of itself beside its numbers, as JSON words; its arrays by name."""

from __future__ import annotations

import json
from collections.abc import Mapping
from copy import copy
from dataclasses import fields, make_dataclass
from functools import cache
from typing import Any, get_type_hints

from loopshape.core.errors import UnreadableInputError
from loopshape.core.json_ready import json_ready
from loopshape.data.response.frf import FRF
from loopshape.io.files import short
from loopshape.io.schema import read, table_of

#: names before version 2 of the formats, and those of now
RENAMED = {"trusted": "valid", "held_by": "recorded_under"}
ARRAYS = ("frequency_hz", "response", "covariance", "valid")
PERHAPS = (
    "coherence",
    "input_power",
    "output_power",
    "cross_power",
    "noise_covariance",
    "multiple_coherence",
    "partial_coherence",
)
_WORDS = tuple(one.name for one in fields(FRF) if one.name not in (*ARRAYS, *PERHAPS, "recorded_under"))


def frf_arrays(frf: FRF) -> dict[str, Any]:
    """The arrays that an FRF has, by name."""
    return {name: getattr(frf, name) for name in (*ARRAYS, *PERHAPS) if getattr(frf, name) is not None}


def frf_header(frf: FRF) -> dict[str, Any]:
    """Everything of an FRF but its arrays, ready for JSON; `frf_words` reads it back."""
    held = None if frf.recorded_under is None else table_of(frf.recorded_under) | {"name": frf.loop}
    made: dict[str, Any] = json_ready({"recorded_under": held} | {word: getattr(frf, word) for word in _WORDS})
    return made


def is_format(found: object, now: str) -> bool:
    """Whether a file's format is that of now or the version before, whose names `upgraded` turns into those of now."""
    return found in (now, now.removesuffix("2") + "1")


def arrays_in(file: Mapping[str, Any], before: str = "") -> dict[str, Any]:
    """The arrays of an FRF in a file whose names begin so, under the names of now."""
    names = (*ARRAYS, *PERHAPS, *RENAMED)
    return upgraded({name: file[key] for name in names if (key := f"{before}{name}") in file})


def upgraded(named: Mapping[str, Any]) -> dict[str, Any]:
    """Arrays or words of an FRF's file under the names of now."""
    return {RENAMED.get(name, name): value for name, value in named.items()}


def _refuse_half_characters(header: Mapping[str, Any], where: str) -> None:
    """JSON can spell half of a surrogate pair, which no file and no screen takes."""
    try:
        json.dumps(dict(header), ensure_ascii=False).encode("utf-8")
    except UnicodeEncodeError as error:
        near = error.object[max(error.start - 20, 0) : error.end + 20]
        raise UnreadableInputError(
            f"{where}: a word of the FRF holds half a character", short(ascii(near)), "write its names as UTF-8"
        ) from None


def frf_words(header: Mapping[str, Any], where: str) -> dict[str, Any]:
    """Keywords of `FRF` from its header; refuses words that are missing or of a wrong kind (`WrongUseError`)."""
    _refuse_half_characters(header, where)
    named = upgraded(header)
    words = {word: named[word] for word in _WORDS if word in named}
    if held := named.get("recorded_under"):
        words["recorded_under"] = {**held, "name": named["loop"]}
    if "hold" not in words and "zero-order hold" in str(named["method"]):  # as the method alone said until 2026-11-23
        words["hold"] = "included"
    return dict(vars(read(_header(), words, where, own=True)))


@cache
def _header() -> type:
    """The fields of `FRF` that are no arrays."""
    hints, own = get_type_hints(FRF), [copy(one) for one in fields(FRF) if one.name in (*_WORDS, "recorded_under")]
    return make_dataclass("Header", [(one.name, hints[one.name], one) for one in own])
