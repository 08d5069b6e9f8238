"""Diagnostics XML of the LIGO and KAGRA control rooms (LIGO_LW): one excitation, its responses, and their coherence.

A result of type Spectrum holds, by its Subtype, 1 the amplitude spectral density of a channel, 2 the cross-spectra of
a channel A with channels B as A B*, 3 their coherence |<A B*>|²/(<|A|²> <|B|²>); so does dttxml read it. The response
from A to B is <B A*>/<|A|²>; its error follows from coherence and averages. Arrays are base64 of little-endian numbers.
"""

from __future__ import annotations

import base64
import re
import xml.etree.ElementTree as ET
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from xml.parsers import expat

import numpy as np

from loopshape.core.errors import UnreadableInputError
from loopshape.core.units import Array
from loopshape.io.files import reading, short
from loopshape.toolbox.formats.frf.frf_foreign import ForeignFRF

_LONGEST = 512 * 1024 * 1024  # bytes
_TYPES = {"float": "<f4", "floatComplex": "<c8", "double": "<f8", "doubleComplex": "<c16"}
_DENSITY, _CROSS, _COHERENCE = "1", "2", "3"
#: squared correlation of the power of neighbouring Hann segments that overlap by half (Welch 1967)
_HANN_HALF = 1.0 / 36.0
_HANN = "1"


@dataclass(frozen=True, eq=False)
class _Result:
    words: Mapping[str, str]
    values: np.ndarray

    @property
    def others(self) -> list[str]:
        """Names of the channels B, in the order of the rows."""
        numbered = {k: v for k, v in self.words.items() if k.startswith("ChannelB[") and v}
        return [numbered[k] for k in sorted(numbered, key=lambda name: int(name[9:-1]))]


def read_ligo_xml(path: Path) -> ForeignFRF:
    """Responses (lines, channels, 1) of all channels to the excitation, with their coherences.

    Refuses XML of another kind or with entities of its own, a test without excitation, and one without cross-spectra.
    Names become letters, figures and underscores, without a unit: the file states none.
    """
    root = _root(path)
    with reading(path, "diagnostics XML", ET.ParseError):
        test = _words(next((one for one in root if one.get("Type") == "TestParameter"), root))
        found = [_result(one) for one in root if str(one.get("Name")).startswith("Result[")]
    source = next((v for k, v in sorted(test.items()) if k.startswith("StimulusChannel[") and v), "")
    mine = {one.words["Subtype"]: one for one in found if one.words.get("ChannelA") == source}
    if not source or not {_DENSITY, _CROSS, _COHERENCE} <= set(mine):
        raise UnreadableInputError(
            f"{path.name} holds no response to an excitation",
            f"excitation {source!r}, results {', '.join(sorted(mine)) or 'none of it'}",
            "export a test with a stimulus, its cross-spectra and coherences",
        )  # fmt: skip
    with reading(path, "diagnostics XML"):
        return _responses(path, source, mine, test)


def _root(path: Path) -> ET.Element:
    with reading(path, "diagnostics XML", ET.ParseError, expat.ExpatError):
        if path.stat().st_size > _LONGEST:
            raise ValueError(f"more than {_LONGEST} bytes")
        text = path.read_bytes()
        _refuse_entities(text)
        root = ET.fromstring(text)
        if root.tag != "LIGO_LW":
            raise ValueError(f"its root is {short(root.tag, 40)}, not LIGO_LW")
    return root


def _refuse_entities(text: bytes) -> None:
    """Refuse entities in front of the root, in whatever encoding: diagnostics files define none."""

    def refuse(*_: object) -> None:
        raise ValueError("it defines entities, which diagnostics files do not")

    parser = expat.ParserCreate()
    parser.EntityDeclHandler = refuse
    parser.Parse(text, True)


def _words(element: ET.Element) -> dict[str, str]:
    return {str(p.get("Name")): (p.text or "").strip() for p in element.findall("Param")}


def _result(element: ET.Element) -> _Result:
    words, array = _words(element), element.find("Array")
    stream = None if array is None else array.find("Stream")
    if array is None or stream is None or stream.get("Encoding") != "LittleEndian,base64":
        return _Result(words, np.empty(0))
    values = np.frombuffer(base64.b64decode(stream.text or ""), _TYPES[str(array.get("Type"))])
    return _Result(words, values.reshape([int(dim.text or 0) for dim in array.findall("Dim")]))


def _responses(path: Path, source: str, mine: Mapping[str, _Result], test: Mapping[str, str]) -> ForeignFRF:
    density, cross, coherence = mine[_DENSITY], mine[_CROSS], mine[_COHERENCE]
    outputs, n = cross.others, density.values.size
    if coherence.others != outputs or cross.values.reshape(-1, n).shape[0] != len(outputs):
        raise ValueError("cross-spectra and coherences are of other channels")
    f = float(density.words["f0"]) + float(density.words["df"]) * np.arange(n, dtype=np.float64)
    power = np.asarray(density.values, dtype=float) ** 2
    response = np.conj(cross.values.reshape(-1, n)).astype(complex) / power
    gamma2 = np.asarray(coherence.values, dtype=float).reshape(-1, n)
    words = {
        "inputs": [_name(source)],
        "outputs": [_name(name) for name in outputs],
        "method": "spectra of a diagnostics test",
        "averages": _averages(int(density.words["Averages"]), test),
        "line_overlap": 1.94 if density.words.get("Window") == _HANN else 1.0,
    }
    note = (
        f"{int(density.words['Averages'])} averages at GPS {_time(path)}; the excitation drives, not the plant's input"
    )
    return ForeignFRF(
        str(path), f, response.T[:, :, None], words=words, notes=(note,),
        element_coherence=_between(gamma2).T[:, :, None],
    )  # fmt: skip


def _averages(count: int, test: Mapping[str, str]) -> float:
    """Independent averages: overlapping Hann segments share a part (Welch 1967), of others nothing is known."""
    overlap = float(test.get("Overlap", 0.0))
    if overlap == 0.5 and test.get("Window") == _HANN:
        return count / (1.0 + 2.0 * _HANN_HALF * (1.0 - 1.0 / count))
    return count * (1.0 - overlap) if overlap else float(count)


def _between(gamma2: Array) -> Array:
    """Coherences, single precision leaves a little above 1."""
    return np.where(np.abs(gamma2 - 1.0) < 1e-5, np.minimum(gamma2, 1.0), gamma2)


def _name(channel: str) -> str:
    return re.sub(r"[^A-Za-z0-9]+", "_", channel).strip("_") + "_1"


def _time(path: Path) -> str:
    with path.open("rb") as file:
        found = re.search(rb'Name="TestTime" Type="GPS">([\d.]+)<', file.read(1 << 16))
    return found[1].decode() if found else "unknown"
