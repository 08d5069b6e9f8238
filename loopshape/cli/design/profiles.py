"""`loopshape profiles`: the limits of standards and of practice, and a file of them to change."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from loopshape.cli.output import AsJson, Output, Quiet


def profiles(
    file: Annotated[Path | None, typer.Argument(help="A file of profiles; default: those that come along.")] = None,
    out: Annotated[Path | None, typer.Option(help="Write the file that comes along here, to be changed.")] = None,
    as_json: AsJson = False,
    quiet: Quiet = False,
) -> None:
    """List the standards whose limits `--profile` takes.

    Of each for check and tune: limits, standard, clause, who confirms.
    """
    from loopshape.io.profiles import OWN, read_profiles

    output = Output(as_json, quiet)
    known = read_profiles(file or OWN)
    if out is not None:
        _write(out)
    rows = [
        [one.name, ", ".join(f"{name} {value:g}" for name, value in one.limits.items()), _read(one.unread), one.edition]
        for one in known.values()
    ]
    output.table("Profiles", ["name", "limits", "read in its own text", "edition"], rows)
    for one in known.values():
        output.paragraph(f"{one.name}: {one.standard}; {one.clause}. {one.confirm}")
    output.json({"profiles": list(known.values()), "file": str(out) if out else None})


def _read(unread: tuple[str, ...]) -> str:
    return "no" if unread else "-"


def _write(out: Path) -> None:
    from loopshape.core.errors import WrongUseError
    from loopshape.io.files import make_folder, write_text_whole
    from loopshape.io.profiles import OWN

    if out.exists():
        raise WrongUseError(f"{out} is there already", "profiles are not written over a file", "give another name")
    make_folder(out.parent)
    write_text_whole(out, OWN.read_text(encoding="utf-8"))
