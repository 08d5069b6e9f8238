"""FRFs beside the run that they were measured from: `frf/<recording>.<loop>.npz`, and a table for people."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from loopshape.controller import Controller
from loopshape.errors import UnreadableInputError, WrongUseError
from loopshape.frf import FRF
from loopshape.store.files import inside, json_ready, make_folder, reading, write_text_whole, write_whole
from loopshape.store.run_folder import excited_names, recording_digests
from loopshape.store.run_tables import controller_table, read_controller
from loopshape.store.words import Words, refuse_doubles
from loopshape.units import Array

FORMAT = "loopshape-frf/1"
FOLDER = "frf"
_ARRAYS = ("frequency_hz", "response", "covariance", "trusted")
_PERHAPS = (
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
)


def write_frfs(run_folder: Path, frfs: Sequence[FRF]) -> tuple[Path, ...]:
    """Write each FRF whole, replacing that of the same recording and loop; returns the files.

    Refuses two FRFs of one recording and loop, and names that are not plain.
    """
    names = [f"{frf.recording or 'all'}.{frf.loop or 'all'}.npz" for frf in frfs]
    refuse_doubles(names, FOLDER, "FRFs")
    make_folder(run_folder / FOLDER)
    paths = [inside(run_folder / FOLDER, name, "the name of a FRF's recording and loop") for name in names]
    sources = recording_digests(run_folder)
    for path, frf in zip(paths, frfs, strict=True):
        _write(path, frf, sources.get(frf.recording, ""))
    if sources:  # FRFs of recordings that the run no longer has, or estimated before with other loops
        for path in set((run_folder / FOLDER).glob("*.npz")) - set(paths):
            path.unlink()
    return tuple(paths)


def _write(path: Path, frf: FRF, source: str) -> None:
    held = None if frf.held_by is None else controller_table(frf.held_by) | {"rate_hz": frf.held_by.rate_hz}
    header = {"format": FORMAT, "source": source, "held_by": held} | {word: getattr(frf, word) for word in _WORDS}
    arrays = {name: getattr(frf, name) for name in (*_ARRAYS, *_PERHAPS) if getattr(frf, name) is not None}
    text = np.array(json.dumps(json_ready(header)))

    def write(part: Path) -> None:
        with part.open("wb") as file:
            np.savez_compressed(file, header=text, **arrays)

    write_whole(path, write)


def read_frfs(run_folder: Path) -> tuple[FRF, ...]:
    """All FRFs of a run, in the order of their files' names.

    Refuses a run that has none, damaged files, a FRF whose recording has changed or gone since it was
    estimated, and a run with an estimation recording that has no FRF yet.
    """
    folder = run_folder / FOLDER
    paths = sorted(path for path in folder.glob("*.npz") if not path.name.startswith("."))
    if not paths:
        raise UnreadableInputError("a run has no FRF yet", str(folder), "estimate them first: loopshape frf RUN")
    found = [_read(inside(folder, path.name, "a FRF's file")) for path in paths]
    if any(source for _, source in found):
        _check_fresh(run_folder, found)
    return tuple(frf for frf, _ in found)


def _check_fresh(run_folder: Path, found: Sequence[tuple[FRF, str]]) -> None:
    sources = recording_digests(run_folder)
    stale = [frf.recording for frf, source in found if source and sources.get(frf.recording) != source]
    missing = sorted(excited_names(run_folder) - {frf.recording for frf, _ in found})
    if stale or missing:
        words = [f"changed or gone: {', '.join(stale)}"] if stale else []
        words += [f"without a FRF: {', '.join(missing)}"] if missing else []
        raise UnreadableInputError(
            f"the FRFs of {run_folder} are not those of its recordings", "; ".join(words), "run: loopshape frf RUN"
        )


def _read(path: Path) -> tuple[FRF, str]:
    with reading(path, "FRF"), path.open("rb") as raw, np.load(raw, allow_pickle=False) as file:
        header = json.loads(str(file["header"]))
        found = header["format"]
        arrays = {name: file[name] for name in (*_ARRAYS, *_PERHAPS) if name in file.files}
    if found != FORMAT:
        raise UnreadableInputError(f"{path} is not of the format {FORMAT}", repr(found), "estimate it again")
    with reading(path, "FRF", WrongUseError):
        return FRF(**arrays, **_words(header), held_by=_held_by(header, str(path))), str(header.get("source", ""))


def _held_by(header: dict[str, Any], where: str) -> Controller | None:
    held = header.get("held_by")
    if not held:
        return None
    table = {key: value for key, value in held.items() if key != "rate_hz"} | {"name": header["loop"]}
    return read_controller(Words(table, where), float(held["rate_hz"]))


def _words(header: dict[str, Any]) -> dict[str, Any]:
    return {
        "inputs": tuple(map(str, header["inputs"])),
        "outputs": tuple(map(str, header["outputs"])),
        "method": str(header["method"]),
        "recording": str(header["recording"]),
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
    }


def frf_csv(path: Path, frf: FRF) -> None:
    """Write a FRF as a table: frequency_hz, re, im, std, coherence, trusted (1 or 0).

    `std` is sqrt(E|d|²) of the complex error, in the response's unit. A larger FRF than 1 x 1 has re, im
    and std of each element, named by output and input; coherence is empty where there is none.
    """
    columns: dict[str, Array] = {"frequency_hz": frf.frequency_hz}
    for row, output in enumerate(frf.outputs):
        for column, source in enumerate(frf.inputs):
            tail = "" if frf.response.shape[1:] == (1, 1) else f"_{output}_{source}"
            element = frf.response[:, row, column]
            columns |= {f"re{tail}": element.real, f"im{tail}": element.imag}
            columns[f"std{tail}"] = np.sqrt(frf.variance[:, row, column])
    rows = [",".join([*columns, "coherence", "trusted"])]
    for k, values in enumerate(zip(*columns.values(), strict=True)):
        coherence = "" if frf.coherence is None else repr(float(frf.coherence[k]))
        rows.append(",".join([*(repr(float(v)) for v in values), coherence, str(int(frf.trusted[k]))]))
    write_text_whole(path, "\n".join(rows) + "\n")
