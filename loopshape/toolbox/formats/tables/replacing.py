"""A run put in place of another: what was made of the old one goes with it."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from pathlib import Path

from loopshape.core.errors import UnreadableInputError
from loopshape.core.interrupts import undivided
from loopshape.data.signal.run import Run
from loopshape.io.config_table import ConfigTable
from loopshape.io.files import make_folder, plain_name, short, staged
from loopshape.io.folder_lock import locked
from loopshape.io.input_guard import own
from loopshape.io.run.journal import FILE as JOURNAL
from loopshape.io.run.run_folder import INDEX, RUN_TOML, has_run, read_run_words, refuse_foreign, write_run


def replace_run(folder: Path, run: Run) -> None:
    """Put a run in place of the one in a folder: written whole beside it first, so that a full disk takes neither.

    A kill leaves the old run or, from the first removal to the last move, a folder that is refused as a run and that
    the same call puts in order. Refuses what another process is writing, and a machine's run of a campaign that is
    being recorded, however little of it is being written now; a link to another folder is not followed.
    """
    make_folder(folder)
    with _campaign_held(folder), locked(folder):
        if not has_run(folder):
            refuse_foreign(folder)
        with staged(folder, "new") as stage:
            write_run(stage, run)
            with undivided():
                _remove_all_but_words(folder)
                names = sorted((path.name for path in stage.iterdir()), key=lambda name: name == RUN_TOML)
                for name in names:  # the old words stay to the last: they say what is to be removed
                    with _moving(folder / name):
                        os.replace(stage / name, folder / name)


def _campaign_held(folder: Path) -> AbstractContextManager[None]:
    """Hold the campaign that a run belongs to, which names its tables only once several of them are whole."""
    above = folder.resolve().parent
    return locked(above) if (above / INDEX).is_file() else nullcontext()


def _remove_all_but_words(folder: Path) -> None:
    """Remove tables, all that was made of them, and the journal."""
    if not has_run(folder):
        return
    listed = [folder / _plain_file(entry) for entry in read_run_words(folder).tables("recording")]
    made = [path for place in ("frf", "matrix") for path in _own_files(folder / place)]
    for path in (*listed, *made, folder / "fits.json", folder / JOURNAL):
        with _moving(path):
            path.unlink(missing_ok=True)


def _plain_file(entry: ConfigTable) -> str:
    return plain_name(entry.table.get("file"), "the file of a recording")


def _own_files(folder: Path) -> list[Path]:
    """FRFs and their tables in a folder of a run."""
    return [] if folder.is_symlink() else sorted(p for p in folder.glob("*") if p.suffix in (".npz", ".csv"))


@contextmanager
def _moving(path: Path) -> Iterator[None]:
    own(path)
    try:
        yield
    except OSError as error:
        raise UnreadableInputError(
            f"{path} cannot be removed or replaced", error.strerror or short(error), "check the folder and its rights"
        ) from None
