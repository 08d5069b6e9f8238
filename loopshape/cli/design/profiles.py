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
    from loopshape.verbs import files

    output = Output(as_json, quiet)
    known = files.profiles(file)
    if out is not None:
        files.write_profiles(out)
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
