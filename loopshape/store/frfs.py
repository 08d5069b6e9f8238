"""FRFs beside the run that they were measured from: `frf/<recording>.<loop>.npz`, and a table for people."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from loopshape.errors import UnreadableInputError, WrongUseError
from loopshape.frf import FRF
from loopshape.store.files import inside, make_folder, reading, write_whole
from loopshape.store.frf_csv import frf_csv as frf_csv  # tables for people stand beside the FRFs
from loopshape.store.frf_words import ARRAYS, PERHAPS, frf_arrays, frf_header, frf_words
from loopshape.store.run_folder import excited_names, recording_digests
from loopshape.store.words import refuse_doubles

FORMAT = "loopshape-frf/1"
FOLDER = "frf"


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
    text = np.array(json.dumps({"format": FORMAT, "source": source} | frf_header(frf)))
    arrays = frf_arrays(frf)

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
        arrays = {name: file[name] for name in (*ARRAYS, *PERHAPS) if name in file.files}
    if found != FORMAT:
        raise UnreadableInputError(f"{path} is not of the format {FORMAT}", repr(found), "estimate it again")
    with reading(path, "FRF", WrongUseError):
        return FRF(**arrays, **frf_words(header, str(path))), str(header.get("source", ""))
