"""All that is known of a run, for its report: recordings, FRFs, fits, verdict, what is missing, files by SHA-256."""

from __future__ import annotations

import platform
from collections.abc import Callable, Collection, Sequence
from dataclasses import replace
from importlib.metadata import version
from pathlib import Path

from loopshape import __version__
from loopshape.core.errors import LoopshapeError, UnreadableInputError
from loopshape.data.control.controller import Controller
from loopshape.data.requirement.requirements import Requirements
from loopshape.data.response.frf import FRF
from loopshape.data.response.model import Fit
from loopshape.data.result.equivalent import Equivalent
from loopshape.data.signal.recording import Recording
from loopshape.data.signal.run import Run
from loopshape.identify.fit import modes
from loopshape.io.files import PART, reading
from loopshape.io.provenance import file_sha256
from loopshape.io.requirements import read_required
from loopshape.io.run.run_folder import RUN_TOML, check_recordings, read_run, recorded_under
from loopshape.io.write.check_files import read_diagram
from loopshape.io.write.controllers import read_controllers
from loopshape.io.write.fits import fits_of
from loopshape.io.write.frfs import FOLDER, MATRICES, has_any, read_all_loops, read_frfs, read_matrices
from loopshape.loop.verdict import LoopCheck, check_loops
from loopshape.toolbox.pages.report.run_report import (
    Envelope,
    FittedModel,
    GivenText,
    InputFile,
    Missing,
    RecordingSheet,
    RunReport,
    StoredFigure,
)  # fmt: skip
from loopshape.verbs.pictures import FIGURES

FIGURES_BYTES = 700_000  # of the pictures that a report carries beside the main ones, together
#: beginnings of the names of the main pictures, which no budget leaves out
_MAIN = ("nichols_", "loop_", "sensitivities_", "atlas_", "frf_", "matrix_", "interaction_", "gap")
#: what a report never reads: reports, and what a killed write left
_NO_INPUT = (".html", PART)
_BEGINNINGS = {"png": b"\x89PNG\r\n\x1a\n", "svg": b"<"}


def gather(
    folder: Path,
    controller: Path | None,
    require: Path | None,
    date: str,
    figures_bytes: int = FIGURES_BYTES,
    diagram: Path | None = None,
    author: str = "",
    *,
    matrix: bool = False,
) -> RunReport:
    """All that is known of a run and of a controller checked on its FRFs, or on what a diagram's tuned block meets.

    Several loops are checked at once, as `check_all` does, where `matrix` or the table [several] asks for it.

    Refuses a folder without recordings and FRFs, FRFs that are not those of the recordings, damaged files, and what
    `read_diagram` and `equivalent` refuse.
    """
    run, frfs, matrices = _measured(folder)
    fits = fits_of(folder)
    controllers = read_controllers(controller) if controller is not None else ()
    asked, whole = read_required(require) if require is not None else (None, None)
    requirements = asked or ()
    drawn = read_diagram(diagram, folder) if diagram is not None else None
    tuned = None if drawn is None else drawn.equivalent()
    if matrix or whole is not None:
        under = recorded_under(folder)
        found = check_loops(read_all_loops(folder), controllers, requirements, together=whole, recorded_under=under)
        checked = found.parts
    else:
        checked = _checked(frfs, controllers, requirements, fits, tuned)
    done = {one.verdict.loop for one in checked}
    sheets = _sheets(run) if run is not None else ()
    pages = {f"frf_{one.loop}_{one.recording}" for one in frfs}
    figures, left = stored_figures(folder, figures_bytes, lambda name: _rank(name, pages))
    given = [("controller", controller), ("requirements", require), ("diagram", diagram)]
    further = [path for _, path in given if path is not None]
    given += [("run", folder / "run.toml")] if run is not None else []
    return RunReport(
        name=folder.resolve().name,
        date=date,
        author=author,
        versions=_versions(),
        run=run,
        recordings=sheets,
        notes=tuple(str(note) for note in run.extra.get("notes", ())) if run is not None else (),
        frfs=frfs,
        matrices=matrices,
        fits=_with_modes(fits),
        checked=checked,
        unchecked=tuple(required.loop for required in requirements if required.loop not in done),
        controllers=controllers,
        missing=_missing(run, frfs if tuned is None else tuned.plants, matrices, fits, controllers, requirements, done),
        figures=figures,
        figures_left_out=left,
        files=input_files(folder, further),
        texts=tuple(given_text(what, path) for what, path in given if path is not None),
        diagram=drawn,
        inner={} if tuned is None else tuned.inner,
    )


def _rank(name: str, pages: Collection[str]) -> int:
    """0 for the main pictures, 2 for pages of single recordings, 1 for all others."""
    return 2 if name.rsplit(".", 1)[0] in pages else int(not name.startswith(_MAIN))


def _measured(folder: Path) -> tuple[Run | None, tuple[FRF, ...], tuple[FRF, ...]]:
    """Run, FRFs and matrices, as far as they are there; a matrix of one loop is the FRF of that loop."""
    frfs = read_frfs(folder) if has_any(folder, FOLDER) else ()
    read = read_matrices(folder) if has_any(folder, MATRICES) else ()
    known = {(one.loop, one.recording) for one in frfs}
    frfs += tuple(x for x in read if x.response.shape[1:] == (1, 1) and (x.loop, x.recording) not in known)
    matrices = tuple(one for one in read if one.response.shape[1:] != (1, 1))
    if not (folder / RUN_TOML).exists() and not (frfs or matrices):
        raise UnreadableInputError(
            "a report needs recordings or frequency responses",
            f"{folder}, which holds neither",
            "name a run's folder: measure, import or import-frf make one",
        )
    return (read_run(folder) if (folder / RUN_TOML).exists() else None), frfs, matrices


def _checked(
    frfs: Sequence[FRF],
    controllers: Sequence[Controller],
    requirements: Sequence[Requirements],
    fits: Sequence[Fit],
    tuned: Equivalent | None = None,
) -> tuple[LoopCheck, ...]:
    """Each controller whose loop was measured, compared with its requirements (against none where none are given).

    With a diagram (`tuned`) that is the tuned block's.
    """
    found = []
    frfs, fits = (frfs, fits) if tuned is None else (tuned.plants, ())
    for own in controllers:
        mine = tuple(one for one in frfs if one.loop == own.loop and one.response.shape[1:] == (1, 1))
        if not mine:
            continue
        given = [one for one in requirements if one.loop == own.loop]
        asked = given or [Requirements(own.loop)]
        checked = check_loops(mine, own, asked if tuned is None else [*map(tuned.asked, asked)], fits)
        found.append(replace(checked, requirements=tuple(given)))
    return tuple(found)


def _with_modes(fits: Sequence[Fit]) -> tuple[FittedModel, ...]:
    return tuple(FittedModel(one, modes(one) if one.structure.startswith("rational") else ()) for one in fits)


def _sheets(run: Run) -> tuple[RecordingSheet, ...]:
    """Each recording with its faults; a signal that cannot be read is a fault and not an error."""
    sheets = []
    for one in run.recordings:
        try:
            faults = tuple(check_recordings(replace(run, recordings=(one,))))
        except LoopshapeError as error:
            faults = (str(error),)
        sheets.append(RecordingSheet(one.info, one.rate_hz, _samples(one), _envelopes(run, one), faults))
    return tuple(sheets)


def _samples(recording: Recording) -> int:
    try:
        return recording.stored(next(iter(recording.columns))).size if recording.columns else 0
    except LoopshapeError:
        return 0


def _envelopes(run: Run, recording: Recording) -> tuple[Envelope, ...]:
    """Shapes of what was injected, commanded and measured in the excited loops, in all loops where none was."""
    info = recording.info
    loops = [run.loop(name) for name in info.excited] or list(run.loops)
    names = [
        name
        for loop in loops
        for name in (loop.reference if info.injection == "reference" else loop.injected, loop.control, loop.output)
        if name is not None
    ]
    found = []
    for name in dict.fromkeys(names):
        try:
            values = recording.signal(name)
        except LoopshapeError:
            continue
        found += [Envelope.of(name, values)] if values.size else []
    return tuple(found)


def _missing(
    run: Run | None,
    frfs: Sequence[FRF],
    matrices: Sequence[FRF],
    fits: Sequence[Fit],
    controllers: Sequence[Controller],
    requirements: Sequence[Requirements],
    done: Collection[str],
) -> tuple[Missing, ...]:
    """What would be there after the whole chain and is not, each with its command."""
    command = "loopshape report RUN --controller controller.toml --require requirements.toml"
    found = []
    if run is None:
        found.append(Missing("The recordings: these frequency responses came from elsewhere."))
    if not frfs and not done:
        more = "No frequency response of a single loop:" if matrices else "No frequency responses yet:"
        found.append(Missing(more, "loopshape frf RUN"))
    if frfs and not fits:
        found.append(Missing("No fitted models:", "loopshape fit RUN"))
    if frfs and not controllers:
        tune = "loopshape tune RUN --require requirements.toml --out controller.toml"
        found.append(Missing("No controller was given, so there are no loops, margins and verdict; make one:", tune))
        found.append(Missing("and name it:", command))
    if controllers and not requirements:
        found.append(Missing("No requirements were given, so margins are reported without verdict:", command))
    measured, governed = {one.loop for one in frfs} | set(done), {one.loop for one in controllers}
    found += [
        Missing(f"Loop {c.loop} of the controller file has no frequency response.")
        for c in controllers
        if c.loop not in measured
    ]
    for required in requirements if controllers else ():
        if required.loop not in measured:
            found.append(Missing(f"Requirements name loop {required.loop}, which has no frequency response."))
        elif required.loop not in governed:
            found.append(Missing(f"Requirements name loop {required.loop}, for which the controller file has none."))
    return tuple(found)


def _versions() -> dict[str, str]:
    """Versions of what computed."""
    names = ("numpy", "scipy", "control", "matplotlib", "numba")
    return {"loopshape": __version__, "Python": platform.python_version()} | {name: version(name) for name in names}


def input_files(folder: Path, further: Sequence[Path] = ()) -> tuple[InputFile, ...]:
    """Every file of a run folder by its name within it, then `further` files that lie elsewhere, by their bare names.

    Hidden files, reports (`.html`), halves of killed writes and links that leave the folder are no inputs.
    """
    inner = sorted(path for path in folder.rglob("*") if _is_input(path, folder))
    known = {path.resolve() for path in inner}
    named = [(path.relative_to(folder).as_posix(), path) for path in inner]
    named += [(path.name, path) for path in further if path.resolve() not in known]
    return tuple(_input(name, path) for name, path in named)


def _is_input(path: Path, folder: Path) -> bool:
    inner = path.relative_to(folder)
    plain = not any(part.startswith(".") for part in inner.parts) and not path.name.endswith(_NO_INPUT)
    return plain and path.is_file() and _stays(path, folder)


def _stays(path: Path, folder: Path) -> bool:
    """Whether a path leads to a file of the folder: a report must not carry what a link fetches from elsewhere."""
    return path.resolve().is_relative_to(folder.resolve())


def _input(name: str, path: Path) -> InputFile:
    with reading(path, "a file of a run"):
        size = path.stat().st_size
    return InputFile(name, size, file_sha256(path))


def stored_figures(
    folder: Path, limit_bytes: int, rank: Callable[[str], int]
) -> tuple[tuple[StoredFigure, ...], dict[str, str]]:
    """Pictures (PNG, SVG) of a run up to a sum of bytes, and why each other one is left out.

    They are taken by rising `rank` of their name, then by name; those of rank 0 enter whatever their size; of the
    others one too large is passed over and smaller ones after it still enter.
    """
    found, left, used = [], {}, 0
    paths = [p for p in (folder / FIGURES).glob("*") if p.is_file() and not p.name.startswith(".")]
    for path in sorted(paths, key=lambda p: (rank(p.name), p.name)):
        if not _stays(path, folder):
            left[path.name] = "a link that leaves the run's folder"
            continue
        with reading(path, "a picture"):
            data = path.read_bytes()
        kind = path.suffix.removeprefix(".").lower()
        if kind not in _BEGINNINGS or not data.lstrip().startswith(_BEGINNINGS[kind]):
            left[path.name] = "no PNG or SVG"
        elif rank(path.name) > 0 and used + len(data) > limit_bytes:
            left[path.name] = (
                f"{len(data) / 1e6:.1f} MB more would exceed the {limit_bytes / 1e6:g} MB kept for pictures"
            )
        else:
            found.append(StoredFigure(path.name, kind, data))
            used += len(data) if rank(path.name) > 0 else 0
    return tuple(found), left


def given_text(what: str, path: Path) -> GivenText:
    """A file of words as it stands; refuses one that is no UTF-8."""
    with reading(path, "text"):
        return GivenText(what, path.name, path.read_text(encoding="utf-8"))
