"""Whether a run is what was recorded: its tables against their hashes, its FRFs and fits against its recordings."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from loopshape.core.errors import LoopshapeError
from loopshape.core.stretches import Signal, stretches
from loopshape.data.signal.recording import Recording
from loopshape.io.files import PART, read_toml, reading, short
from loopshape.io.provenance import KEY, file_sha256
from loopshape.io.run.journal import ARRIVING, read_journal
from loopshape.io.run.journal import FILE as JOURNAL
from loopshape.io.run.run_folder import RUN_TOML, read_run
from loopshape.io.run.tables import ENDINGS
from loopshape.io.write.fits import FILE as FITS
from loopshape.io.write.fits import read_fits
from loopshape.io.write.frfs import FOLDER, MATRICES, has_any, read_frfs, read_matrices


@dataclass(frozen=True)
class Finding:
    """One checked item: its name, whether it is sound (None: undecidable), and the reason if not."""

    what: str
    sound: bool | None
    reason: str = ""


def verify(folder: Path, study: Path | None = None) -> list[Finding]:
    """All that can be checked of a run folder, and of the study that it came from where that is given.

    Refuses a folder that holds no readable run.
    """
    run = read_run(folder)
    entries = read_toml(folder / RUN_TOML).get("recording", [])
    marks = {str(entry["file"]): entry.get("sha256") for entry in entries}
    found = [_table(folder, file, mark) for file, mark in marks.items()]
    found += [_columns(recording) for recording in run.recordings]
    found += [_origin(run.extra.get(KEY)), *_study(run.extra.get("study_sha256"), study)]
    return [*found, *_made(folder), *_strange(folder, set(marks)), *_journal(folder, marks)]


def _table(folder: Path, file: str, noted: str | None) -> Finding:
    if noted is None:
        return Finding(f"table {file}", None, "run.toml notes no hash of it")
    try:
        same = file_sha256(folder / file) == noted
    except LoopshapeError as error:
        return Finding(f"table {file}", False, str(error))
    return Finding(f"table {file}", same, "" if same else "it is not the file that was written: its hash is another")


def _columns(recording: Recording) -> Finding:
    """Every column can be read, has as many rows as the others, and holds finite numbers."""
    columns, what = recording.columns, f"columns of {recording.info.file}"
    try:
        sizes = {recording.stored(name).size for name in columns}
        bad = [name for name in columns if not _finite(recording.stored(name))]
    except LoopshapeError as error:
        return Finding(what, False, str(error))
    if bad:
        return Finding(what, False, f"not finite: {short(', '.join(bad))}")
    if len(sizes) != 1:
        return Finding(what, False, f"rows differ: {sorted(sizes)}" if sizes else "there is none")
    return Finding(
        what, True, short(f"ended early: {recording.info.ended_early}") if recording.info.ended_early else ""
    )


def _finite(signal: Signal) -> bool:
    return all(np.isfinite(part).all() for (part,) in stretches(signal))


def _origin(words: object) -> Finding:
    if not isinstance(words, dict):
        return Finding("origin", None, "run.toml does not say which versions made it")
    return Finding("origin", True, short(", ".join(f"{key} {value}" for key, value in words.items()), 400))


def _study(noted: object, study: Path | None) -> Iterator[Finding]:
    if study is None:
        return
    same = file_sha256(study) == noted
    if not isinstance(noted, str):
        yield Finding(f"study {study.name}", None, "run.toml notes no hash of a study")
        return
    yield Finding(f"study {study.name}", same, "" if same else "it is not the study that the run was made by")


def _made(folder: Path) -> Iterator[Finding]:
    """FRFs, matrices and fits: readable, and of these recordings."""
    for what, there, read in (
        ("FRFs", has_any(folder, FOLDER), read_frfs),
        ("matrices", has_any(folder, MATRICES), read_matrices),
        ("fits", (folder / FITS).exists(), read_fits),
    ):
        if there:
            try:
                read(folder)
                yield Finding(what, True)
            except LoopshapeError as error:
                yield Finding(what, False, str(error))


def _strange(folder: Path, listed: set[str]) -> Iterator[Finding]:
    """Tables that the run does not list, and files whose writing was cut short."""
    with reading(folder, "a run's folder"):
        paths = sorted(folder.iterdir())
    for path in paths:
        if path.name.endswith(ARRIVING):
            yield Finding(
                path.name, None, "what was recorded of a recording that did not end; the next measurement keeps it"
            )
        elif path.name.endswith(PART):
            yield Finding(path.name, None, "a file whose writing was cut short; the next one written here removes it")
        elif path.name.endswith(ENDINGS) and path.name not in listed:
            yield Finding(path.name, None, "a table that run.toml does not list: it is not part of the run")


def _journal(folder: Path, marks: Mapping[str, object]) -> Iterator[Finding]:
    """What the journal calls finished is there, with that hash."""
    if not os.path.lexists(folder / JOURNAL):
        return
    try:
        lines, torn = read_journal(folder)
    except LoopshapeError as error:
        yield Finding("journal", None, str(error))
        return
    hashes = {file.split(".")[0]: mark for file, mark in marks.items()}
    done = {str(line.get("recording")): line.get("sha256") for line in lines if line["event"] == "finished"}
    lost = sorted(name for name, mark in done.items() if name not in hashes or hashes[name] not in (None, mark))
    words = [f"finished and not in the run as they were: {short(', '.join(lost), 400)}"] if lost else []
    words += [f"{torn} torn lines"] if torn else []
    yield Finding("journal", not lost, "; ".join(words))
