"""Touchstone files (.s1p, .s2p) of network analysers: S, Y, Z, G or H parameters as a matrix of FRFs.

Format: EIA/IBIS Open Forum, Touchstone File Format Specification, version 1.1. Of version 2 only files that are laid
out as version 1 are read; noise parameters behind the network's own are left out.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from loopshape.core.errors import UnreadableInputError
from loopshape.core.units import ComplexArray, from_db, rad
from loopshape.io.files import reading, short
from loopshape.toolbox.formats.frf.frf_foreign import ForeignFRF
from loopshape.toolbox.formats.tables.text_layout import whole_text

_PER_HZ = {"HZ": 1.0, "KHZ": 1e3, "MHZ": 1e6, "GHZ": 1e9}
_PARTS = ("RI", "MA", "DB")
#: keywords of version 2 that leave the rows as version 1 has them
_HARMLESS = ("version", "number of ports", "number of frequencies", "reference", "network data", "end", "noise data",
             "number of noise frequencies", "begin information", "end information")  # fmt: skip
_AS_IN_1 = (("two-port data order", "21_12"), ("matrix format", "full"))
_KINDS = ("S", "Y", "Z", "G", "H")


def read_touchstone(path: Path) -> ForeignFRF:
    """The parameters as responses (lines, ports, ports): output k, input l is parameter kl; none has an error.

    Refuses frequencies that do not rise, but for the noise parameters at the end of a .s2p, which are counted.
    """
    ports = int(path.suffix[2])
    most_bytes = 1 << 26
    text = whole_text(path, most_bytes)
    lines = [line.split("!")[0].strip() for line in text.splitlines()]
    unit, kind, parts = _options(path, next((line for line in lines if line.startswith("#")), ""))
    with reading(path, "Touchstone"):
        _refuse_keywords([line.lower() for line in lines if line.startswith("[")])
        rows = [[float(cell) for cell in line.split()] for line in lines if line and line[0] not in "#["]
        wide = 1 + 2 * ports**2
        end = next((k for k, row in enumerate(rows) if k and row[0] <= rows[k - 1][0]), len(rows))
        if not rows or any(len(row) != wide for row in rows[:end]):
            raise ValueError(f"rows of {wide} numbers are due with {ports} ports")
        noise = 5  # numbers in a row of noise parameters
        if any(ports != 2 or len(row) != noise for row in rows[end:]):
            before, after = rows[end - 1][0], rows[end][0]
            raise ValueError(f"its frequencies do not rise at row {end + 1}: {after:g} after {before:g}; sort the rows")
    values = np.array(rows[:end])
    matrix = _complex(values[:, 1::2], values[:, 2::2], parts).reshape(-1, ports, ports)
    matrix = matrix.transpose(0, 2, 1) if ports == 2 else matrix  # of two ports 21 stands before 12
    words = {
        "outputs": [f"{kind.lower()}{k + 1}_1" for k in range(ports)],
        "inputs": [f"a{k + 1}_1" for k in range(ports)],
    }
    left = (f"{len(rows) - end} rows of noise parameters were left out",) if end < len(rows) else ()
    return ForeignFRF(str(path), values[:, 0] * _PER_HZ[unit], matrix, words=words, notes=left)


def _refuse_keywords(lines: Sequence[str]) -> None:
    """Refuse what version 2 may say of another order or form of the rows than version 1 has."""
    for line in lines:
        keyword, _, content = line[1:].partition("]")
        if keyword not in _HARMLESS and (keyword, content.strip()) not in _AS_IN_1:
            raise ValueError(f"its rows are of version 2, and {line} changes them; save it as version 1")


def _options(path: Path, line: str) -> tuple[str, str, str]:
    """Unit of frequency, kind and parts from the option line; the specification's defaults where it is silent."""
    words = line.removeprefix("#").upper().split()
    unit = next((word for word in words if word in _PER_HZ), "GHZ")
    kind = next((word for word in words if word in _KINDS), "S")
    parts = next((word for word in words if word in _PARTS), "MA")
    known = {unit, kind, parts, "R"}
    if not line or any(word not in known and not word.replace(".", "").isdigit() for word in words):
        raise UnreadableInputError(
            f"{path.name} has no option line of a Touchstone file", short(line) or "no line that begins with #",
            "write # HZ S RI R 50 above the rows",
        )  # fmt: skip
    return unit, kind, parts


def _complex(one: np.ndarray, two: np.ndarray, parts: str) -> ComplexArray:
    if parts == "RI":
        return np.asarray(one + 1j * two)
    size = from_db(one) if parts == "DB" else one
    return np.asarray(size * np.exp(1j * rad(two)))
