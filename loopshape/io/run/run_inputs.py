"""What a report of a run is made from, as it lies on disk: every file with its SHA-256, pictures, files of words."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from loopshape.io.files import PART, reading
from loopshape.io.provenance import file_sha256

if TYPE_CHECKING:
    from loopshape.loop.run_report import GivenText, InputFile, StoredFigure

FIGURES = "figures"
#: what a report never reads: reports, and what a killed write left
_NO_INPUT = (".html", PART)
_BEGINNINGS = {"png": b"\x89PNG\r\n\x1a\n", "svg": b"<"}


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
    from loopshape.loop.run_report import InputFile

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
    from loopshape.loop.run_report import StoredFigure

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
    from loopshape.loop.run_report import GivenText

    with reading(path, "text"):
        return GivenText(what, path.name, path.read_text(encoding="utf-8"))
