"""An FRF as a universal file of type 58, as modal analysis exchanges them; read by the library pyuff (optional).

The format holds a function for each pair of a response and a reference: frequency responses (type 4), coherences
(type 6). It has no room for a covariance, nor for which lines are valid. Source: SDRC universal dataset 58,
"Function at nodal DOF". pyuff trusts what it reads, so sizes, tags and heads are checked before, counts after.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from loopshape.core.errors import LoopshapeError, UnreadableInputError, WrongUseError
from loopshape.data.response.frf import FRF
from loopshape.io.files import reading, short, write_bytes_whole
from loopshape.toolbox.formats.frf.frf_foreign import ForeignFRF
from loopshape.toolbox.formats.logs.mdf4 import TIME_OF

FORMAT = "loopshape-uff/1"
LIMIT_BYTES = 512 * 2**20
_HISTORY, _FRF, _COHERENCE, _TIME, _FREQUENCY = 1, 4, 6, 17, 18
_TAG = re.compile(rb"    -1(?=[\r\n]| {74}|\Z)")
_DIRECTIONS = {0: "", 1: "_x", 2: "_y", 3: "_z", 4: "_rx", 5: "_ry", 6: "_rz"}

Pair = tuple[tuple[str, int, int], tuple[str, int, int]]


def _pyuff() -> Any:
    try:
        import pyuff
    except ImportError:
        raise WrongUseError(
            "universal files are read by the library pyuff", "an installation without it",
            "pip install 'loopshape[uff]'",
        ) from None  # fmt: skip
    return pyuff


def write_frf_uff(path: Path, frf: FRF) -> tuple[str, ...]:
    """Write responses and, of one input, coherences, in binary (58b) double precision; returns what is lost.

    Text would cut frequencies to six figures. Names of over 80 characters have no room and are refused.
    """
    parts = [
        _function(frf, row, column, kind)
        for kind, there in ((_FRF, True), (_COHERENCE, _own_coherence(frf) is not None))
        for row in range(len(frf.outputs))
        for column in range(len(frf.inputs))
        if there
    ]
    write_bytes_whole(path, b"".join(parts))
    more = " and no coherence of several inputs" if len(frf.inputs) > 1 else ""
    return (
        f"a universal file holds no covariance{more}, and no valid frequencies: state --relative-std, or --averages"
        " where there is a coherence, when you read it",
    )


def _own_coherence(frf: FRF) -> np.ndarray | None:
    """Ordinary coherence (nf, ny) of a single input; None where there is none, or are several inputs."""
    if len(frf.inputs) > 1:
        return None
    if frf.multiple_coherence is not None:
        return frf.multiple_coherence
    return frf.coherence[:, None] if frf.coherence is not None and len(frf.outputs) == 1 else None


def _function(frf: FRF, row: int, column: int, kind: int) -> bytes:
    """One dataset 58b, little-endian, uneven lines; names stand in the ID lines, places in the nodes.

    Written here, for pyuff 2.5 writes 58b with a wrong number of bytes and loses the head where it starts a file.
    """
    coherence, f = _own_coherence(frf), frf.frequency_hz
    if kind == _FRF or coherence is None:
        element = frf.response[:, row, column]
        data, ordinate = np.stack([f, element.real, element.imag], axis=1), 6
    else:
        data, ordinate = np.stack([f, coherence[:, row]], axis=1), 4
    method = frf.method.encode("ascii", "replace").decode()
    about = " | ".join([frf.recording, frf.loop, repr(float(frf.rate_hz)), repr(float(frf.averages))])
    lines = [_id_line(text) for text in (frf.outputs[row], frf.inputs[column], about, _format(frf.response.shape))]
    head = [
        f"{-1:6d}",
        f"{58:6d}b{1:6d}{2:6d}{11:12d}{data.nbytes:12d}{0:6d}{0:6d}{0:12d}{0:12d}",
        *lines,
        f"{' '.join(method.split())[:80] or 'NONE':80s}",
        f"{kind:5d}{0:10d}{0:5d}{0:10d} {'NONE':10s}{row + 1:10d}{0:4d} {'NONE':10s}{column + 1:10d}{0:4d}",
        f"{ordinate:10d}{f.size:10d}{0:10d}{0.0:13.5e}{0.0:13.5e}{0.0:13.5e}",
        _axis(_FREQUENCY, "Frequency", "Hz"), *(_axis(quantity, "NONE", "NONE") for quantity in (1, 1, 0)),
    ]  # fmt: skip
    return "\n".join([*head, ""]).encode("ascii") + data.astype("<f8").tobytes() + b"    -1\n"


def _format(shape: Sequence[int]) -> str:
    """Format and size of the matrix, by which a file that lost whole functions is known."""
    return f"{FORMAT}, {shape[1]} x {shape[2]}"


def _id_line(text: str) -> str:
    if len(text) > 80 or not text.isascii() or not text.isprintable():
        raise WrongUseError("a universal file has 80 plain letters for names", repr(text), "export to mat or csv")
    return f"{text:80s}"


def _axis(quantity: int, label: str, unit: str) -> str:
    return f"{quantity:10d}{0:5d}{0:5d}{0:5d} {label:20s} {unit:20s}"


def read_frf_uff(path: Path) -> ForeignFRF:
    """The FRFs of a universal file as one matrix, its rows the responses, its columns the references.

    Functions of other types are passed over with a note. Refuses a file that is no universal file, cut short or over
    512 MB, a function whose head and data disagree, a pair that stands twice or is missing, and different lines.
    """
    sets = _functions(path)
    frfs, coherences = _by_pair(path, sets, _FRF), _by_pair(path, sets, _COHERENCE)
    if not frfs:
        found = ", ".join(sorted({str(s["func_type"]) for s in sets})) or "none"
        raise UnreadableInputError(f"{path} holds no frequency response (58, type 4)", f"types {found}", _way(found))
    rows = list(dict.fromkeys(pair[0] for pair in frfs))
    columns = list(dict.fromkeys(pair[1] for pair in frfs))
    f = np.asarray(next(iter(frfs.values()))["x"], dtype=float)
    response = _matrix(path, frfs, rows, columns, f)
    coherence = None
    if len(columns) == 1 and {pair[0] for pair in coherences} >= set(rows):
        # some write a coherence without its reference
        own = {(pair[0], columns[0]): s for pair, s in coherences.items()}
        coherence = np.real(_matrix(path, own, rows, columns, f))
    words, notes = _words(frfs, rows, columns)
    stated = str(next(iter(frfs.values()))["id4"])
    if stated.startswith(FORMAT) and stated != _format(response.shape):
        raise UnreadableInputError(f"{path} is cut short or put together", stated, "export it again")
    others = len(sets) - len(frfs) - len(coherences)
    if others:
        notes.append(f"{others} functions of {path.name} are neither FRF nor coherence and were passed over")
    return ForeignFRF(str(path), f, response, {}, words, tuple(notes), element_coherence=coherence)


def _way(types: str) -> str:
    return "time histories are read by loopshape import" if str(_HISTORY) in types.split(", ") else "export FRFs"


def read_uff_histories(path: Path) -> dict[str, np.ndarray]:
    """Time histories (type 1) of a universal file by their node, `ch1_x`, and stamps `time of ch1_x` in s.

    Refuses a file without any, and one of a node that stands twice.
    """
    found: dict[str, np.ndarray] = {}
    for name, s in _histories(path):
        if name in found:
            raise UnreadableInputError(f"{path} holds one node twice", name, "leave one measurement in it")
        found |= {name: np.asarray(s["data"], dtype=float), TIME_OF + name: np.asarray(s["x"], dtype=float)}
    if not found:
        raise UnreadableInputError(
            f"{path} holds no time history (58, type 1)", path.name,
            f"frequency responses are read by: loopshape import-frf {path} --out FOLDER",
        )  # fmt: skip
    return found


def uff_units(path: Path) -> dict[str, str]:
    """The unit that each time history states, and s of the stamps."""
    units = {name: str(s.get("ordinate_axis_units_lab", "")).strip() for name, s in _histories(path)}
    return {n: "" if u == "NONE" else u for n, u in units.items()} | {TIME_OF + n: "s" for n in units}


def _histories(path: Path) -> list[tuple[str, dict[str, Any]]]:
    sets = [s for s in _functions(path) if s["func_type"] == _HISTORY and s["abscissa_spec_data_type"] in (0, 1, _TIME)]
    places = [(str(s["rsp_ent_name"]), int(s["rsp_node"]), int(s["rsp_dir"])) for s in sets]
    return [(_name("ch", place).removesuffix("_1"), s) for place, s in zip(places, sets, strict=True)]


def _functions(path: Path) -> list[dict[str, Any]]:
    """All datasets 58 of a file, as pyuff reads them."""
    pyuff = _pyuff()
    _check_file(path)
    try:
        with reading(path, "UFF", Exception):  # pyuff raises bare exceptions
            file = pyuff.UFF(str(path))
            numbers = [int(k) for k in np.flatnonzero(np.asarray(file.get_set_types()) == 58)]
            sets = [file.read_sets(k) for k in numbers]
            for s in sets:
                _check_set(s)
    except LoopshapeError:
        raise
    return sets


def _check_file(path: Path) -> None:
    """Size, the first tag, and that every tag has its partner: pyuff drops a last set that was cut."""
    with reading(path, "UFF"):
        size = path.stat().st_size
        if size > LIMIT_BYTES:
            raise ValueError(f"it has {size / 2**20:.0f} MB, and {LIMIT_BYTES // 2**20} are read at most")
        raw = path.read_bytes()
        if not re.match(rb"\s*-1 *\r?\n *\d+", raw[:200]):
            raise ValueError("it does not begin as a universal file does")
        if len(_TAG.findall(raw)) % 2:
            raise ValueError("its last set has no end: it is cut short")


def _check_set(s: Mapping[str, Any]) -> None:
    """Refuse a function whose data are not what its head says."""
    x, data, count = np.asarray(s["x"]), np.asarray(s["data"]), s["num_pts"]
    if s["func_type"] not in (_FRF, _COHERENCE):
        return
    if not 0 < count == x.size == data.size:
        raise ValueError(f"a function of {count} points has {data.size} values on {x.size} lines")
    if s["func_type"] == _FRF and s["ord_data_type"] not in (5, 6):
        raise ValueError("a frequency response of real numbers")
    if s["abscissa_spec_data_type"] not in (0, 1, _FREQUENCY):
        raise ValueError(f"a function over the quantity {s['abscissa_spec_data_type']}, which is no frequency")
    if not (np.isfinite(x).all() and np.isfinite(data).all()):
        raise ValueError("values that are not numbers")


def _by_pair(path: Path, sets: Sequence[dict[str, Any]], kind: int) -> dict[Pair, dict[str, Any]]:
    found: dict[Pair, dict[str, Any]] = {}
    for s in sets:
        if s["func_type"] != kind:
            continue
        response, reference = ((str(s[f"{end}_ent_name"]), s[f"{end}_node"], s[f"{end}_dir"]) for end in ("rsp", "ref"))
        if (response, reference) in found:
            raise UnreadableInputError(
                f"{path} holds one pair twice",
                f"node {response[1]} by node {reference[1]}",
                "leave one measurement in it",
            )
        found[(response, reference)] = s
    return found


def _matrix(path: Path, sets: Mapping[Pair, Any], rows: list[Any], columns: list[Any], f: np.ndarray) -> np.ndarray:
    """Values (nf, ny, nu) of all pairs; refuses a pair that is missing or on other frequencies."""
    made = np.empty((f.size, len(rows), len(columns)), dtype=complex)
    for i, row in enumerate(rows):
        for j, column in enumerate(columns):
            s = sets.get((row, column))
            if s is None or not np.array_equal(s["x"], f):
                raise UnreadableInputError(
                    f"{path} is no whole matrix of responses at the same frequencies",
                    f"{'no function' if s is None else 'other frequencies'} of node {row[1]} by node {column[1]}",
                    "export every pair alike, or one pair",
                )  # fmt: skip
            made[:, i, j] = s["data"]
    return made


def _words(frfs: Mapping[Pair, Any], rows: list[Any], columns: list[Any]) -> tuple[dict[str, Any], list[str]]:
    """Words and notes: our own from the ID lines, else channels after their nodes, without a unit."""
    first = next(iter(frfs.values()))
    if str(first.get("id4")).startswith(FORMAT):
        outputs = [str(frfs[(row, columns[0])]["id1"]) for row in rows]
        inputs = [str(frfs[(rows[0], column)]["id2"]) for column in columns]
        places = [part.strip() for part in f"{first['id3']} | | |".split("|")]
        words = {"recording": places[0], "loop": places[1], "rate_hz": places[2] or 0.0, "averages": places[3] or "nan"}
        return words | {"outputs": outputs, "inputs": inputs, "method": str(first["id5"])}, []
    outputs, inputs = [_name("y", row) for row in rows], [_name("u", column) for column in columns]
    labels = [str(first.get(f"{part}_axis_units_lab", "")) for part in ("ordinate", "orddenom")]
    note = f"channels are called after their nodes, and their numbers stand as in the file (units {short(labels)})"
    about = [str(first[k]) for k in ("id1", "id4") if str(first[k]) not in ("", "NONE")]
    return {"outputs": outputs, "inputs": inputs, "method": "; ".join(about) or "a universal file"}, [note]


def _name(letter: str, place: tuple[str, int, int]) -> str:
    _, node, direction = place
    word = _DIRECTIONS.get(abs(direction), f"_d{abs(direction)}")
    return f"{letter}{node}{'_minus' if direction < 0 else ''}{word}_1"
