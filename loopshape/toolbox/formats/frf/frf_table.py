"""FRFs in tables of others: magnitude and phase, real and imaginary part, of analysers and of circuit simulators.

Columns are told by the words and units of the header: frequency (Hz, kHz, MHz, rad/s), magnitude (dB, or a ratio),
phase (deg, rad; wrapped or not), real and imaginary part, coherence, std. Lines above the header are passed over, as
Bode 100 and SIMPLIS write them. LTspice writes a cell of two parts, `(-3.01dB,-45°)` or `0.5,-0.5`. What neither the
header nor the values tell is refused: nothing is guessed of dB and ratios.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path

import numpy as np

from loopshape.core.errors import UnreadableInputError
from loopshape.core.units import TWO_PI, Array, ComplexArray, from_db, rad
from loopshape.io.csv_text import read_csv_table
from loopshape.io.files import short
from loopshape.toolbox.formats.drafts.column_words import split_unit
from loopshape.toolbox.formats.frf.frf_foreign import ForeignFRF
from loopshape.toolbox.formats.tables.text_layout import TextLayout, read_layout, whole_text

_PER_HZ = {"hz": 1.0, "khz": 1e3, "mhz": 1e6, "ghz": 1e9, "rad/s": 1.0 / TWO_PI, "rad/sec": 1.0 / TWO_PI}
_WORDS = {
    "frequency": ("frequency", "freq", "frequenz", "f", "omega", "w", "hz"),
    "magnitude": ("magnitude", "mag", "gain", "amplitude", "abs", "modulus", "betrag", "db", "level", "amp"),
    "phase": ("phase", "angle", "arg", "phas", "deg"),
    "real": ("real", "re"),
    "imag": ("imag", "im", "imaginary"),
    "coherence": ("coherence", "coh", "gamma2"),
    "std": ("std", "sigma"),
}
_POLAR, _CARTESIAN = ("magnitude", "phase"), ("real", "imag")
_PAIR = re.compile(r"\(?\s*([-+\d.eE]+)\s*(dB)?\s*,\s*([-+\d.eE]+)\s*(°|deg|Â°|\ufffd)?\s*\)?", re.IGNORECASE)


def read_frf_table(path: Path) -> ForeignFRF:
    """The FRF of one input and output in a table; of several traces the first that is whole, with a note.

    Refuses a table whose header does not say what its columns are, and rows that are no numbers.
    """
    if (found := _of_pairs(path)) is not None:
        return found
    layout = read_layout(path)
    table = read_csv_table(path, layout.shape)
    places = _places(path, layout)
    columns = {what: table.column(table.names[k]) for what, (k, _) in places.items()}
    units = {what: unit for what, (_, unit) in places.items()}
    f = _frequency(path, columns["frequency"], units["frequency"])
    response, notes = _response(path, columns, units)
    order = np.argsort(f, kind="stable")
    return ForeignFRF(
        str(path), f[order], response[order, None, None], notes=(*layout.guesses[1:], *notes, *_passed(layout, places)),
        element_coherence=_shaped(columns.get("coherence"), order), std=_shaped(columns.get("std"), order),
    )  # fmt: skip


def _shaped(values: Array | None, order: np.ndarray) -> Array | None:
    return None if values is None else values[order, None, None]


def _places(path: Path, layout: TextLayout) -> dict[str, tuple[int, str]]:
    """Column and unit of each part, of one trace; refuses a header that does not tell enough, or tells of several.

    Analysers write a trace in several forms, each as a column: real and imaginary part go before magnitude and phase.
    Parts of two traces make a response where there is no more than one of each.
    """
    columns = [_column(name, layout.units[k]) for k, name in enumerate(layout.names)]
    frequency = next((k for k, c in enumerate(columns) if c.kind == "frequency"), None)
    traces = list(dict.fromkeys(c.trace for c in columns if c.kind in (*_POLAR, *_CARTESIAN)))
    for parts, trace in product((_CARTESIAN, _POLAR), (*traces, None)):
        mine = [(k, c) for k, c in enumerate(columns) if trace is None or c.trace == trace]
        found = {part: [(k, c.unit) for k, c in mine if c.kind == part] for part in parts}
        alone = trace is not None or all(len(places) == 1 for places in found.values())
        if frequency is not None and alone and all(found.values()):
            beside = {c.kind: (k, c.unit) for k, c in reversed(mine) if c.kind in ("coherence", "std")}
            return {
                "frequency": (frequency, columns[frequency].unit),
                **{part: places[0] for part, places in found.items()},
                **beside,
            }
    raise UnreadableInputError(
        f"{path.name} is no table of an FRF", short(", ".join(layout.names)) or "no header",
        "name its columns: frequency (Hz) with magnitude (dB) and phase (deg), or with real and imag;"
        " a recording in time is read by loopshape import or ls.formats.read_table(file, map)",
    )  # fmt: skip


@dataclass(frozen=True)
class _Column:
    """What a column's title tells: its part ("" for none), its unit, and of which trace it is."""

    kind: str
    unit: str
    trace: tuple[str, ...]


def _column(name: str, unit: str) -> _Column:
    title, own = split_unit(name)
    unit = (unit or own).strip("[]() ").lower()
    words = [word for word in re.split(r"[^a-zα-ω0-9]+", title.lower()) if word]
    if unit in (*_WORDS["real"], *_WORDS["imag"]):  # the form stands where others write a unit
        words, unit = [*words, unit], ""
    unit = "db" if "db" in words else unit or next((word for word in words if word in _PER_HZ), "")
    known = {word for some in _WORDS.values() for word in some}
    return _Column(_kind(words, unit) or "", unit, tuple(word for word in words if word not in known))


def _kind(words: Sequence[str], unit: str) -> str | None:
    if unit in _PER_HZ:
        return "frequency"
    named = [kind for kind, known in _WORDS.items() if any(word in known for word in words)]
    if cartesian := [kind for kind in _CARTESIAN if kind in named]:  # the real part of a gain
        return cartesian[0]
    if unit == "db" and "phase" not in named:
        return "magnitude"
    if unit in ("deg", "°", "degree", "degrees") and ("magnitude" not in named[:1] or set(words) & {"gain"}):
        return "phase"  # of a gain too: Bode 100 writes "Gain (Degree)"
    for kind in ("phase", "coherence", "std", "magnitude", "frequency"):
        if kind in named:
            return kind
    return None


def _frequency(path: Path, values: Array, unit: str) -> Array:
    if unit and unit not in _PER_HZ:
        raise UnreadableInputError(f"the unit of frequency in {path.name} is not known", repr(unit), "use Hz or rad/s")
    return values * _PER_HZ[unit or "hz"]


def _response(
    path: Path, columns: Mapping[str, Array], units: Mapping[str, str]
) -> tuple[ComplexArray, tuple[str, ...]]:
    notes = () if units["frequency"] else ("the frequency bears no unit: taken for Hz",)
    if {"real", "imag"} <= set(columns):
        return np.asarray(columns["real"] + 1j * columns["imag"]), notes
    magnitude, more = _magnitude(path, columns["magnitude"], units["magnitude"])
    phase, still_more = _phase(path, columns["phase"], units["phase"])
    return np.asarray(magnitude * np.exp(1j * phase)), (*notes, *more, *still_more)


def _magnitude(path: Path, values: Array, unit: str) -> tuple[Array, tuple[str, ...]]:
    """The ratio: of dB by its unit, or because a ratio is not negative."""
    if unit == "db":
        return from_db(values), ()
    if np.any(values < 0.0):
        return from_db(values), ("the magnitude bears no unit and has negative values: taken for dB",)
    if unit in ("1", "abs", "v/v", "-", "ratio", "lin"):
        return values, ()
    raise UnreadableInputError(
        f"the magnitude in {path.name} is dB or a ratio, and nothing tells", repr(unit) if unit else "no unit",
        "write (dB) or (abs) behind its name in the header",
    )  # fmt: skip


def _phase(path: Path, values: Array, unit: str) -> tuple[Array, tuple[str, ...]]:
    """The phase in rad: by its unit, or in degrees where it goes beyond two turns of rad."""
    if unit in ("deg", "°", "degree", "degrees", "grad"):
        return rad(values), ()
    if unit in ("rad", "radian", "radians"):
        return values, ()
    if np.abs(values).max() > 2.0 * TWO_PI:
        return rad(values), ("the phase bears no unit and goes beyond two turns of rad: taken for degrees",)
    raise UnreadableInputError(
        f"the phase in {path.name} is deg or rad, and nothing tells", repr(unit) if unit else "no unit",
        "write (deg) or (rad) behind its name in the header",
    )  # fmt: skip


def _passed(layout: TextLayout, places: Mapping[str, tuple[int, str]]) -> tuple[str, ...]:
    taken = {k for k, _ in places.values()}
    left = [name for k, name in enumerate(layout.names) if k not in taken and name]
    return (f"columns left out: {short(', '.join(left))}",) if left else ()


def _of_pairs(path: Path) -> ForeignFRF | None:
    """LTspice's export: a frequency and cells of two parts, separated by tabs; None for another file."""
    most_bytes = 1 << 26
    text = whole_text(path, most_bytes)
    lines = [line for line in text.splitlines() if line.strip()]
    if len(lines) < 2 or "\t" not in lines[0] or _PAIR.fullmatch(lines[1].split("\t")[-1].strip()) is None:
        return None
    names, f, response = lines[0].split("\t"), [], []
    for number, line in enumerate(lines[1:], start=2):
        cells = line.split("\t")
        pair = _PAIR.fullmatch(cells[1].strip()) if len(cells) == len(names) else None
        if pair is None:
            raise UnreadableInputError(
                f"line {number} of {path.name} is no frequency with a pair", short(line, 60), "export it again"
            )
        f.append(float(cells[0]))
        response.append(_pair(pair))
    left = (f"columns left out: {short(', '.join(names[2:]))}",) if len(names) > 2 else ()
    notes = (f"trace {names[1]}, frequencies in Hz as LTspice writes them", *left)
    return ForeignFRF(str(path), np.array(f), np.array(response)[:, None, None], notes=notes)


def _pair(pair: re.Match[str]) -> complex:
    """Magnitude in dB and phase in degrees where the cell says so, else real and imaginary part."""
    one, two = float(pair[1]), float(pair[3])
    if pair[2]:
        return complex(float(from_db(one)) * np.exp(1j * float(rad(two))))
    return complex(one, two)
