"""FRFs to and from other programs' files: one table of formats, an export that is whole or not at all, an import."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from loopshape.core.errors import UnreadableInputError, WrongUseError, refuse_unknown
from loopshape.data.control.controller import Controller
from loopshape.data.response.frf import FRF
from loopshape.io.config_table import refuse_doubles
from loopshape.io.files import PART, inside, make_folder, plain_name, put, staged, writing
from loopshape.io.folder_lock import locked
from loopshape.io.run.run_folder import RUN_TOML
from loopshape.io.write.frf_csv import frf_csv
from loopshape.io.write.frf_words import frf_arrays
from loopshape.io.write.frfs import FOLDER, has_any, read_frfs, write_frfs
from loopshape.toolbox.formats.frf.frf_csv import read_frf_csv
from loopshape.toolbox.formats.frf.frf_foreign import ForeignFRF, Stated, frf_of
from loopshape.toolbox.formats.frf.frf_hdf5 import read_frf_hdf5, write_frf_hdf5
from loopshape.toolbox.formats.frf.frf_ligo import read_ligo_xml
from loopshape.toolbox.formats.frf.frf_mat import read_frf_mat, write_frf_mat
from loopshape.toolbox.formats.frf.frf_table import read_frf_table
from loopshape.toolbox.formats.frf.frf_touchstone import read_touchstone
from loopshape.toolbox.formats.frf.frf_uff import read_frf_uff, write_frf_uff


@dataclass(frozen=True)
class Format:
    """A kind of file: `write` returns what is lost in it; `read` takes what the user states of channels."""

    ending: str
    write: Callable[[Path, FRF], tuple[str, ...]]
    read: Callable[[Path, Stated], ForeignFRF]


def _write_csv(path: Path, frf: FRF) -> tuple[str, ...]:
    frf_csv(path, frf, header=True)
    lost = [
        n for n in ("input_power", "output_power", "cross_power", "noise_covariance") if getattr(frf, n) is not None
    ]
    lost += [n for n in ("multiple_coherence", "partial_coherence") if getattr(frf, n) is not None]
    return (f"a table holds no {', '.join(lost)}: export to mat to keep them",) if lost else ()


def _write_mat(path: Path, frf: FRF) -> tuple[str, ...]:
    write_frf_mat(path, frf)
    return ()


FORMATS: dict[str, Format] = {
    "mat": Format(".mat", _write_mat, lambda path, _: read_frf_mat(path)),
    "csv": Format(".csv", _write_csv, read_frf_csv),
    "uff": Format(".uff", write_frf_uff, lambda path, _: read_frf_uff(path)),
    "hdf5": Format(".h5", write_frf_hdf5, lambda path, _: read_frf_hdf5(path)),
}
#: readers of what is not written
_READERS: dict[str, Callable[[Path, Stated], ForeignFRF]] = {
    **{name: one.read for name, one in FORMATS.items()},
    "table": lambda path, _: read_frf_table(path),
    "touchstone": lambda path, _: read_touchstone(path),
    "ligo": lambda path, _: read_ligo_xml(path),
}
_READ = {".txt": "table", ".tsv": "table", ".dat": "table", ".s1p": "touchstone", ".s2p": "touchstone", ".xml": "ligo"}
_ENDINGS = {".mat": "mat", ".csv": "csv", ".uff": "uff", ".unv": "uff", ".h5": "hdf5", ".hdf5": "hdf5"}


def export_frfs(frfs: Sequence[FRF], to: str, out: Path) -> tuple[tuple[Path, ...], tuple[str, ...]]:
    """One file `<recording>.<loop>.<ending>` for each FRF; returns the files, and what they do not hold.

    All are written beside each other first and put in place when the last is whole; one of the same name is replaced.
    """
    refuse_unknown("a format is not known", to, FORMATS)
    kind = FORMATS[to]
    names = [f"{frf.recording or 'all'}.{frf.loop or 'all'}{kind.ending}" for frf in frfs]
    refuse_doubles(names, str(out), "FRFs")
    make_folder(out)
    paths = [inside(out, name, "the name of an FRF's recording and loop") for name in names]
    with writing(out), staged(out, "export") as stage:
        notes = [note for name, frf in zip(names, frfs, strict=True) for note in kind.write(stage / name, frf)]
        for name, path in zip(names, paths, strict=True):
            put(stage / name, path)
    return tuple(paths), tuple(dict.fromkeys(notes))


def write_frf_file(path: Path, frf: FRF) -> tuple[str, ...]:
    """Write one FRF whole, in the format of the file's ending; gives what that format cannot hold."""
    kind = _ENDINGS.get(path.suffix.lower())
    if kind is None:
        raise WrongUseError("an FRF is not written to a file of this kind", str(path), f"use {', '.join(_ENDINGS)}")
    make_folder(path.parent)
    with writing(path), staged(path.parent, "export") as stage:
        notes = FORMATS[kind].write(stage / path.name, frf)
        put(stage / path.name, path)
    return notes


def read_frf_file(path: Path, stated: Stated | None = None) -> FRF:
    """The FRF of a file, its kind told by its ending; refuses one whose error neither file nor user states.

    A recording without a name is called after the file, a loop without one after the outputs.
    """
    known = _ENDINGS | _READ
    kind = known.get(path.suffix.lower())
    if kind is None:
        raise UnreadableInputError("an FRF in a file of this kind is not read", str(path), f"use {', '.join(known)}")
    stated = stated or Stated()
    frf = frf_of(_READERS[kind](path, stated), stated)
    if stated.negative:
        frf = negated(frf)
    if stated.complete_loop is not None:
        frf = without_controller(frf, stated.complete_loop)
    return replace(
        frf,
        recording=frf.recording or path.stem.replace(".", "-"),
        loop=frf.loop or _loop_of(frf.outputs),
        notes=(*frf.notes, f"imported from {path.name}"),
    )


def _loop_of(outputs: Sequence[str]) -> str:
    """A loop's name after its outputs; of many, which a file's name does not hold, the first and how many more."""
    whole = "+".join(outputs)
    return whole if len(whole) <= 80 else f"{outputs[0]}+{len(outputs) - 1}"


def _check_names(frfs: Sequence[FRF]) -> None:
    """Refuse names that are no file's before a folder is made for them."""
    for frf in frfs:
        for name, option in ((frf.recording, "--recording"), (frf.loop, "--loop")):
            if name:
                plain_name(name, f"the name of an FRF ({option} gives another)")


def add_frfs(folder: Path, frfs: Sequence[FRF], *, replace_same: bool = False) -> tuple[Path, ...]:
    """Put FRFs into a folder of imported FRFs, which commands read as a run's; the same ones again change nothing.

    Refuses a run with recordings, whose FRFs are its own, a folder that holds other things, and another FRF of the same
    recording and loop unless it is to be replaced.
    """
    if (folder / RUN_TOML).exists():
        raise WrongUseError(
            "the FRFs of a run come from its recordings, and others are not mixed in",
            str(folder),
            "choose another folder",
        )
    _check_names(frfs)
    make_folder(folder)
    with locked(folder):
        ours = (PART, "figures", "fits.json", "export", FOLDER)
        foreign = [p.name for p in folder.iterdir() if not p.name.endswith(ours)]
        if foreign:
            raise WrongUseError(
                "a folder that is no run is not written into",
                f"{folder}, which holds {', '.join(sorted(foreign)[:5])}",
                "choose a new or an empty folder",
            )
        there = read_frfs(folder) if has_any(folder, FOLDER) else ()
        old = {(one.recording, one.loop): one for one in there}
        taken = [one for one in frfs if (one.recording, one.loop) in old]
        other = [one for one in taken if not _same(one, old[(one.recording, one.loop)])]
        if other and not replace_same:
            raise WrongUseError(
                f"{folder} has another FRF of this recording and loop",
                ", ".join(f"{one.recording} of {one.loop}" for one in other),
                "add --replace, or give it another name (--recording, --loop)",
            )
        return write_frfs(folder, frfs)


def _same(one: FRF, two: FRF) -> bool:
    """Whether all numbers, names and rates are the same."""
    a, b = frf_arrays(one), frf_arrays(two)
    names = (one.inputs, one.outputs, one.rate_hz) == (two.inputs, two.outputs, two.rate_hz)
    return names and a.keys() == b.keys() and all(np.array_equal(a[name], b[name]) for name in a)


def negated(A: FRF) -> FRF:
    """-A, with its error: the response of a loop whose measurement held the sign of its summing point."""
    cross = None if A.cross_power is None else -A.cross_power
    return replace(A, response=-A.response, cross_power=cross, notes=(*A.notes, "the sign was turned, as stated"))


def without_controller(L: FRF, controller: Controller) -> FRF:
    """P = L/C of a loop L = C P that was measured whole under a known controller, with L's error over |C|.

    L is 1 x 1. What the controller's response holds (delay, hold) is divided out with it. Refuses several channels,
    frequencies from half the controller's rate on, and lines at which C is zero.
    """
    if L.response.shape[1:] != (1, 1):
        raise WrongUseError("one controller is divided out of one loop", f"{L.response.shape[1:]} channels", "pick one")
    C = controller.response(L.frequency_hz)[:, None, None]
    if not np.all(np.abs(C) > 0.0):
        bad = L.frequency_hz[np.abs(C[:, 0, 0]) == 0.0][0]
        raise WrongUseError(
            "where the controller is zero the loop tells nothing of the plant", f"at {bad:g} Hz", "leave it out"
        )
    noise = None if L.noise_covariance is None else L.noise_covariance / np.abs(C) ** 2
    return replace(
        L, response=L.response / C, covariance=L.covariance / np.abs(C) ** 2, noise_covariance=noise, input_power=None,
        output_power=None, cross_power=None, rate_hz=L.rate_hz or controller.rate_hz, recorded_under=controller,
        notes=(*L.notes, "measured as the complete loop: its controller was divided out"),
    )  # fmt: skip
