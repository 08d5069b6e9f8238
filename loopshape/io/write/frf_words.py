"""What an FRF says of itself beside its numbers, as JSON words; its arrays by name."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

from loopshape.core.errors import UnreadableInputError
from loopshape.core.json_ready import json_ready
from loopshape.data.control.controller import Controller
from loopshape.data.response.frf import FRF, Hold
from loopshape.io.config_table import ConfigTable
from loopshape.io.files import short
from loopshape.io.run.run_tables import controller_table, read_controller

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
_WORDS = (
    "inputs",
    "outputs",
    "method",
    "recording",
    "recordings",
    "loop",
    "rate_hz",
    "operating_point",
    "power_per",
    "line_overlap",
    "variance_freedom",
    "variance_pooled",
    "averages",
    "parameters",
    "notes",
    "open_loop",
    "hold",
    "method_numbers",
)


def frf_arrays(frf: FRF) -> dict[str, Any]:
    """The arrays that an FRF has, by name."""
    return {name: getattr(frf, name) for name in (*ARRAYS, *PERHAPS) if getattr(frf, name) is not None}


def frf_header(frf: FRF) -> dict[str, Any]:
    """Everything of an FRF but its arrays, ready for JSON; `frf_words` reads it back."""
    held = (
        None
        if frf.recorded_under is None
        else controller_table(frf.recorded_under) | {"rate_hz": frf.recorded_under.rate_hz}
    )
    made: dict[str, Any] = json_ready({"recorded_under": held} | {word: getattr(frf, word) for word in _WORDS})
    return made


def is_format(found: object, now: str) -> bool:
    """Whether a file's format is that of now or the version before, whose names `upgraded` turns into those of now."""
    return found in (now, now.removesuffix("2") + "1")


def upgraded(named: Mapping[str, Any]) -> dict[str, Any]:
    """Arrays or words of an FRF's file under the names of now."""
    return {RENAMED.get(name, name): value for name, value in named.items()}


def _recorded_under(header: Mapping[str, Any], where: str) -> Controller | None:
    held = header.get("recorded_under")
    if not held:
        return None
    table = {key: value for key, value in held.items() if key != "rate_hz"} | {"name": header["loop"]}
    return read_controller(ConfigTable(table, where), float(held["rate_hz"]))


def _flag(value: object) -> bool:
    if not isinstance(value, bool):
        raise TypeError(f"open_loop is true or false, not {value!r}")
    return value


def _hold(header: Mapping[str, Any]) -> Hold:
    """Files written before 2026-11-23 say it in the method alone."""
    before = Hold.INCLUDED if "zero-order hold" in str(header["method"]) else Hold.UNKNOWN
    return Hold(header.get("hold", before))


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
    """Keywords of `FRF` from its header; words that are missing or of a wrong kind raise what Python raises."""
    header = upgraded(header)
    _refuse_half_characters(header, where)
    return {
        "recorded_under": _recorded_under(header, where),
        "inputs": tuple(map(str, header["inputs"])),
        "outputs": tuple(map(str, header["outputs"])),
        "method": str(header["method"]),
        "recording": str(header["recording"]),
        "recordings": tuple(map(str, header.get("recordings", ()))),
        "loop": str(header["loop"]),
        "rate_hz": float(header["rate_hz"]),
        "operating_point": {str(k): float(v) for k, v in header["operating_point"].items()},
        "power_per": str(header.get("power_per", "Hz")),
        "line_overlap": float(header.get("line_overlap", 1.0)),
        "variance_freedom": float(header.get("variance_freedom", "inf")),
        "variance_pooled": int(header.get("variance_pooled", 1)),
        "averages": float(header.get("averages", "nan")),
        "parameters": {str(k): float(v) for k, v in header.get("parameters", {}).items()},
        "notes": tuple(map(str, header["notes"])),
        "open_loop": _flag(header.get("open_loop", False)),
        "hold": _hold(header),
        "method_numbers": {str(k): float(v) for k, v in header.get("method_numbers", {}).items()},
    }
