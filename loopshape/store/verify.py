"""Whether a run is what was recorded: its tables against their hashes, its FRFs and fits against its recordings."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from loopshape.errors import LoopshapeError
from loopshape.store.files import PART, read_toml
from loopshape.store.fits import FILE as FITS
from loopshape.store.fits import read_fits
from loopshape.store.frfs import FOLDER, MATRICES, read_frfs, read_matrices
from loopshape.store.journal import FILE as JOURNAL
from loopshape.store.journal import read_journal
from loopshape.store.provenance import KEY, file_sha256
from loopshape.store.run_folder import RUN_TOML, read_run
from loopshape.store.tables import ENDINGS


@dataclass(frozen=True)
class Finding:
    """One thing that was looked at: its name, whether it is sound (None: it cannot be told), and why not."""

    what: str
    sound: bool | None
    said: str = ""


def verify(folder: Path, study: Path | None = None) -> list[Finding]:
    """All that can be checked of a run folder, and of the study that it came from where that is given.

    Refuses a folder that holds no readable run.
    """
    run = read_run(folder)
    entries = read_toml(folder / RUN_TOML).get("recording", [])
    found = [_recording(folder, r.info.name, e.get("sha256")) for r, e in zip(run.recordings, entries, strict=True)]
    found += [_columns(recording) for recording in run.recordings]
    found += [_origin(run.extra.get(KEY)), _study(run.extra.get("study_sha256"), study)]
    found += [*_made(folder), *_strange(folder, {r.info.file for r in run.recordings}), *_journal(folder, entries)]
    return [finding for finding in found if finding.what]


def _recording(folder: Path, name: str, noted: object) -> Finding:
    file = next(r.info.file for r in read_run(folder).recordings if r.info.name == name)
    if not isinstance(noted, str):
        return Finding(f"table {file}", None, "run.toml notes no hash of it")
    if file_sha256(folder / file) != noted:
        return Finding(f"table {file}", False, "it is not the file that was written: its hash is another")
    return Finding(f"table {file}", True)


def _columns(recording: object) -> Finding:
    """Every column can be read, has as many rows as the others, and holds finite numbers."""
    columns = recording.columns  # type: ignore[attr-defined]
    what = f"columns of {recording.info.file}"  # type: ignore[attr-defined]
    try:
        sizes = {np.asarray(columns[name]).size for name in columns}
        bad = [name for name in columns if not np.isfinite(columns[name]).all()]
    except LoopshapeError as error:
        return Finding(what, False, str(error))
    if len(sizes) != 1 or bad:
        return Finding(what, False, f"not finite: {', '.join(bad)}" if bad else f"rows differ: {sorted(sizes)}")
    return Finding(what, True)


def _origin(words: object) -> Finding:
    if not isinstance(words, dict):
        return Finding("origin", None, "run.toml does not say which versions made it")
    return Finding("origin", True, ", ".join(f"{key} {value}" for key, value in words.items()))


def _study(noted: object, study: Path | None) -> Finding:
    if study is None:
        return Finding("", None)
    if not isinstance(noted, str):
        return Finding(f"study {study.name}", None, "run.toml notes no hash of a study")
    same = file_sha256(study) == noted
    return Finding(f"study {study.name}", same, "" if same else "it is not the study that the run was made by")


def _made(folder: Path) -> Iterator[Finding]:
    """FRFs, matrices and fits: readable, and of these recordings."""
    for what, there, read in (
        ("FRFs", (folder / FOLDER).is_dir(), read_frfs),
        ("matrices", (folder / MATRICES).is_dir(), read_matrices),
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
    for path in sorted(folder.iterdir()):
        if path.name.endswith(PART):
            yield Finding(path.name, None, "a file whose writing was cut short; the next measurement removes it")
        elif path.name.endswith(ENDINGS) and path.name not in listed:
            yield Finding(path.name, None, "a table that run.toml does not list: it is not part of the run")


def _journal(folder: Path, entries: list[dict]) -> Iterator[Finding]:
    """What the journal calls finished is there, with that hash."""
    if not (folder / JOURNAL).exists():
        return
    lines, torn = read_journal(folder)
    hashes = {str(e["file"]).split(".")[0]: e.get("sha256") for e in entries}
    done = {str(line.get("recording")): line.get("sha256") for line in lines if line["event"] == "finished"}
    lost = sorted(name for name, mark in done.items() if name not in hashes or hashes[name] not in (None, mark))
    words = [f"finished and not in the run as they were: {', '.join(lost)}"] if lost else []
    words += [f"{torn} torn lines"] if torn else []
    yield Finding("journal", not lost, "; ".join(words))
