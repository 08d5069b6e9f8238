"""FRFs beside the run that they were measured from: `frf/<recording>.<loop>.npz`, a plant's matrices in `matrix/`."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from loopshape import __version__
from loopshape.core.errors import UnreadableInputError, WrongUseError
from loopshape.data.response.frf import FRF
from loopshape.data.signal.run import Run
from loopshape.io.config_table import refuse_doubles
from loopshape.io.files import inside, make_folder, reading, write_whole
from loopshape.io.folder_lock import locked
from loopshape.io.input_guard import own
from loopshape.io.run.run_folder import excited_names, has_run, marks_as_read, read_run
from loopshape.io.size_limit import check_zip
from loopshape.io.write.frf_csv import frf_csv as frf_csv  # tables for people stand beside the FRFs
from loopshape.io.write.frf_words import arrays_in, frf_arrays, frf_header, frf_words, is_format

FORMAT = "loopshape-frf/2"
FOLDER, MATRICES = "frf", "matrix"


def write_frfs(run_folder: Path, frfs: Sequence[FRF], run: Run | None = None) -> tuple[Path, ...]:
    """Write each FRF whole, replacing that of the same recording and loop; returns the files.

    With the `run` that they were estimated from, as it was read, each bears the mark of its recordings, and FRFs of
    recordings that the run does not have are removed. Refuses two FRFs of one recording and loop, names that are not
    plain, and a run that another process is writing.
    """
    return _write_all(run_folder, frfs, run, FOLDER)


def write_matrices(run_folder: Path, frfs: Sequence[FRF], run: Run | None = None) -> tuple[Path, ...]:
    """As `write_frfs`, for a plant's matrices, in a folder of their own."""
    return _write_all(run_folder, frfs, run, MATRICES)


def _write_all(run_folder: Path, frfs: Sequence[FRF], run: Run | None, place: str) -> tuple[Path, ...]:
    names = [f"{frf.recording or 'all'}.{frf.loop or 'all'}.npz" for frf in frfs]
    refuse_doubles(names, place, "FRFs")
    make_folder(run_folder / place)
    inside(run_folder, place, "the folder of a run's FRFs")
    paths = [inside(run_folder / place, name, "the name of an FRF's recording and loop") for name in names]
    sources = {} if run is None else marks_as_read(run, {name for frf in frfs for name in _names(frf)})
    with locked(run_folder):
        for path, frf in zip(paths, frfs, strict=True):
            _write(path, frf, _source(sources, frf))
        if run is not None:  # FRFs of recordings that the run no longer has, or estimated before with other loops
            for path in set((run_folder / place).glob("*.npz")) - set(paths):
                own(path)
                path.unlink()
    return tuple(paths)


def _names(frf: FRF) -> tuple[str, ...]:
    return frf.recordings or (frf.recording,)


def _source(sources: Mapping[str, str], frf: FRF) -> str:
    """Mark of the recordings that an FRF names; empty where one is not known."""
    marks = [sources.get(name, "") for name in _names(frf)]
    return "+".join(marks) if all(marks) else ""


def _write(path: Path, frf: FRF, source: str) -> None:
    text = np.array(json.dumps({"format": FORMAT, "loopshape": __version__, "source": source} | frf_header(frf)))
    arrays = frf_arrays(frf)

    def write(part: Path) -> None:
        with part.open("wb") as file:
            np.savez_compressed(file, header=text, **arrays)

    write_whole(path, write)


def has_any(run_folder: Path, place: str) -> bool:
    """Whether a run's folder holds FRFs in a place: FRFs of loops, or matrices."""
    return any((run_folder / place).glob("*.npz"))


def read_frfs(run_folder: Path) -> tuple[FRF, ...]:
    """All FRFs of a run, in the order of their files' names.

    Refuses a folder that does not exist, a run that has none, damaged files, an FRF whose recording has changed or gone
    since it was estimated, and a run with an estimation recording that has no FRF yet.
    """
    return _read_all(run_folder, FOLDER, "a run has no FRF yet", "estimate them first: loopshape frf RUN")


def read_matrices(run_folder: Path) -> tuple[FRF, ...]:
    """All matrices of a plant in a run, in the order of their files' names; refuses as `read_frfs` does."""
    return _read_all(
        run_folder, MATRICES, "a run has no plant's matrix yet", "estimate it first: loopshape frf RUN --matrix"
    )


def read_all_loops(run_folder: Path) -> tuple[FRF, ...]:
    """A run's matrices, else its imported FRFs of several inputs; refuses a run that has neither."""
    found = read_matrices(run_folder) if has_any(run_folder, MATRICES) else ()
    found = found or tuple(one for one in read_frfs(run_folder) if len(one.inputs) > 1)
    if not found:
        raise WrongUseError(
            "several loops need the plant's matrix, and the run has FRFs of single loops only",
            str(run_folder), "estimate it first: loopshape frf RUN --matrix",
        )  # fmt: skip
    return found


def _read_all(run_folder: Path, place: str, none: str, way_out: str) -> tuple[FRF, ...]:
    if not run_folder.exists():
        raise UnreadableInputError("a run's folder does not exist", str(run_folder), "check its name")
    folder = run_folder / place
    paths = sorted(path for path in folder.glob("*.npz") if not path.name.startswith("."))
    if not paths:
        raise UnreadableInputError(none, str(folder), way_out)
    found = [_read(inside(folder, path.name, "an FRF's file")) for path in paths]
    if any(source for _, source in found):
        _check_fresh(run_folder, found, place)
    return tuple(frf for frf, _ in found)


def _check_fresh(run_folder: Path, found: Sequence[tuple[FRF, str]], place: str) -> None:
    run = read_run(run_folder) if place == FOLDER or has_run(run_folder) else None
    sources = {} if run is None else marks_as_read(run, [recording.info.name for recording in run.recordings])
    wanted = excited_names(run) if run is not None and place == FOLDER else set()
    stale = [frf.recording for frf, source in found if source and _source(sources, frf) != source]
    missing = sorted(wanted - {name for frf, _ in found for name in _names(frf)})
    if stale or missing:
        words = [f"changed or gone: {', '.join(stale)}"] if stale else []
        words += [f"without an FRF: {', '.join(missing)}"] if missing else []
        raise UnreadableInputError(
            f"the FRFs of {run_folder} are not those of its recordings", "; ".join(words), "run: loopshape frf RUN"
        )


def _read(path: Path) -> tuple[FRF, str]:
    with reading(path, "FRF"), path.open("rb") as raw, np.load(raw, allow_pickle=False) as file:
        check_zip(path)
        header = json.loads(str(file["header"]))
        found = header["format"]
        arrays = arrays_in(file)
    if not is_format(found, FORMAT):
        raise UnreadableInputError(f"{path} is not of the format {FORMAT}", repr(found), "estimate it again")
    with reading(path, "FRF", WrongUseError):
        return FRF(**arrays, **frf_words(header, str(path))), str(header.get("source", ""))
