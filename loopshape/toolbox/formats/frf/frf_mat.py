"""An FRF as a MAT file: in MATLAB's order (outputs, inputs, lines), and back from it or from any `response`."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from loopshape.core.errors import UnreadableInputError
from loopshape.core.units import Array, hz
from loopshape.data.response.frf import FRF
from loopshape.io.csv_text import CsvShape
from loopshape.io.files import reading, short, write_whole
from loopshape.io.write.frf_words import PERHAPS, frf_arrays, frf_header, is_format, upgraded
from loopshape.toolbox.formats.frf.frf_foreign import ForeignFRF
from loopshape.toolbox.formats.logs.mat5 import read_mat5
from loopshape.toolbox.formats.tables.sources import open_source

FORMAT = "loopshape-frf-mat/2"
#: a variable with the lines, and its unit; without a unit of its own `frequency_unit` says it, else it is Hz
_LINES = {"frequency_hz": "Hz", "frequency": "", "omega_rad_s": "rad/s"}
#: other words for them, taken with a note
_HABITS = {"hz": "Hz", "f_hz": "Hz", "freq_hz": "Hz", "f": "Hz", "freq": "Hz", "w": "rad/s", "omega": "rad/s"}
_UNITS = {"Hz": 1.0, "rad/s": hz(1.0), "rad/TimeUnit": hz(1.0)}


def write_frf_mat(path: Path, frf: FRF) -> None:
    """Write all that an FRF holds: arrays with lines last, names as cells of texts, the rest as JSON in `header`."""
    from scipy.io import savemat

    data: dict[str, Any] = {name: np.moveaxis(values, 0, -1) for name, values in frf_arrays(frf).items()}
    data = {name: values[:, None] if values.ndim == 1 else values for name, values in data.items()}
    header = frf_header(frf)
    texts = {name: header[name] for name in ("method", "recording", "loop")}
    lists = {name: _cell(header[name]) for name in ("inputs", "outputs", "notes")}
    words = {"format": FORMAT, "rate_hz": frf.rate_hz, "header": json.dumps(header)}

    def write(part: Path) -> None:
        savemat(str(part), data | texts | lists | words, appendmat=False, do_compression=True)

    write_whole(path, write)


def _cell(texts: list[str]) -> np.ndarray:
    cell = np.empty((len(texts), 1), dtype=object)
    cell[:, 0] = texts
    return cell


def read_frf_mat(path: Path) -> ForeignFRF:
    """A MAT file (5 to 7.3) with `response` and `frequency_hz`, `frequency` or `omega_rad_s`; see docs/frf_files.md.

    Other words for frequencies (hz, f, freq, w, omega), and a response that is the only complex variable, are taken
    with a note. A response goes over outputs, inputs and lines, or is a vector for one of each. Of v7.3 only numbers
    are read.
    """
    held, taken = _by_habit(upgraded(_variables(path)))
    words = _words(path, held)
    f, notes = _lines(path, held)
    notes = (*notes, *taken)
    if "response" not in held:
        raise UnreadableInputError(f"{path} holds no response", short(", ".join(held) or "nothing"), "call it response")
    response = _lines_first(path, "response", held["response"], f.size, 2).astype(complex)
    arrays: dict[str, np.ndarray] = {}
    wide = {"covariance": 2, "noise_covariance": 2, "partial_coherence": 2, "multiple_coherence": 1}
    for name in ("covariance", "valid", *PERHAPS):
        if name in held:
            arrays[name] = _lines_first(path, name, held[name], f.size, wide.get(name, 0))
    if "valid" in arrays:
        arrays["valid"] = arrays["valid"] != 0
    for name in ("coherence", "input_power", "output_power", "multiple_coherence", "partial_coherence"):
        if name in arrays and arrays[name].dtype.kind == "c":
            raise UnreadableInputError(f"{name} of {path} is real", "complex numbers")
    std = _lines_first(path, "std", held["std"], f.size, 2) if "std" in held else None
    one = "coherence" in arrays and response.shape[1:] == (1, 1)
    coherence = arrays["coherence"][:, None, None] if one else None
    return ForeignFRF(str(path), f, response, arrays, words, notes, coherence, std)


def _by_habit(held: dict[str, np.ndarray]) -> tuple[dict[str, np.ndarray], tuple[str, ...]]:
    """Frequencies under another word, and the one complex variable as the response, with a note of each."""
    notes: list[str] = []
    words = [name for name in held if name.lower() in _HABITS]
    if len(words) == 1 and not any(name in held for name in _LINES):
        unit = _HABITS[words[0].lower()]
        held = {**held, "omega_rad_s" if unit == "rad/s" else "frequency_hz": held[words[0]]}
        notes.append(f"frequency was taken from {words[0]}, in {unit}")
    found = [name for name, values in held.items() if values.dtype.kind == "c"]
    if "response" not in held and len(found) == 1:
        held = {**held, "response": held[found[0]]}
        notes.append(f"response was taken from {found[0]}, the only complex variable")
    return held, tuple(notes)


def _variables(path: Path) -> dict[str, np.ndarray]:
    """Numbers and texts by name; the complex numbers of v7.3 lie as pairs named real and imag."""
    import h5py

    with reading(path, "MAT"):
        path.open("rb").close()
        new = h5py.is_hdf5(path)
    if not new:
        with reading(path, "MAT"):
            return read_mat5(path, texts=True)
    source = open_source(path, CsvShape())
    found = {name: source.load(name) for name in source.names}
    for name, values in found.items():
        if values.dtype.names == ("real", "imag"):
            found[name] = values["real"] + 1j * values["imag"]
    return found


def _words(path: Path, held: Mapping[str, np.ndarray]) -> dict[str, Any]:
    """The words of `header`, then those that stand on their own, which a user may have changed."""
    text = _text(held, "format")
    if text and not is_format(text, FORMAT):
        raise UnreadableInputError(f"{path} is not of the format {FORMAT}", repr(text), "take format out of it")
    words: dict[str, Any] = {}
    if _text(held, "header"):
        with reading(path, "the words of an FRF"):
            words = json.loads(_text(held, "header"))
            if not isinstance(words, dict):
                raise ValueError("header is no table")
    words |= {name: _text(held, name) for name in ("method", "recording", "loop") if _text(held, name)}
    for name in ("inputs", "outputs", "notes"):
        values = held.get(name)
        if values is not None and values.dtype.kind == "U" and values.size:
            words[name] = [str(v) for v in np.atleast_1d(values)]
    for name in ("rate_hz", "averages"):
        if name in held and held[name].dtype.kind in "iuf" and held[name].size == 1:
            words[name] = float(held[name].ravel()[0])
    return words


def _text(held: Mapping[str, np.ndarray], name: str) -> str:
    values = held.get(name)
    return str(values) if values is not None and values.dtype.kind == "U" and not values.ndim else ""


def _lines(path: Path, held: Mapping[str, np.ndarray]) -> tuple[Array, tuple[str, ...]]:
    """Lines (nf,) in Hz, and a note where their unit was taken for granted."""
    given = [name for name in _LINES if name in held]
    if len(given) != 1:
        raise UnreadableInputError(
            f"{path} gives its frequencies once", f"variables {short(', '.join(held) or 'none')}",
            f"use one of {', '.join(_LINES)}",
        )  # fmt: skip
    values = held[given[0]]
    if values.dtype.kind not in "iuf" or values.size != max(values.shape, default=0):
        raise UnreadableInputError(
            f"{given[0]} of {path} is a vector of real numbers", f"{values.dtype} {values.shape}"
        )
    unit = _LINES[given[0]] or _text(held, "frequency_unit")
    if unit and unit not in _UNITS:
        raise UnreadableInputError(f"frequency_unit of {path} is not known", repr(unit), f"use {' or '.join(_UNITS)}")
    notes = () if unit else ("frequency was taken to be in Hz: frequency_unit says otherwise",)
    return _UNITS[unit or "Hz"] * values.ravel().astype(float), notes


def _lines_first(path: Path, name: str, values: np.ndarray, lines: int, wide: int) -> np.ndarray:
    """An array in MATLAB's order with lines in front; `wide` axes besides them (vectors: 1 x 1).

    MATLAB drops a last axis of length 1, which is put back.
    """
    if values.dtype.kind not in "biufc":
        raise UnreadableInputError(f"{name} of {path} is not an array of numbers", f"{values.dtype}", "convert it")
    if values.size == lines == max(values.shape, default=0):
        return values.reshape((lines, *[1] * wide))
    if lines == 1 and values.ndim == wide:
        values = values[..., None]
    if values.ndim != wide + 1 or values.shape[-1] != lines:
        raise UnreadableInputError(
            f"{name} of {path} goes over its {lines} lines last",
            " x ".join(map(str, values.shape)), "use outputs x inputs x frequencies" if wide == 2 else "",
        )  # fmt: skip
    return np.ascontiguousarray(np.moveaxis(values, -1, 0))
