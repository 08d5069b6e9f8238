"""`loopshape examples`: the studies, maps and recordings that the documentation uses."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from loopshape.cli.output import AsJson, Output, Quiet


def examples(
    out: Annotated[Path, typer.Option(help="New folder for the copy.")] = Path("examples"),
    as_json: AsJson = False,
    quiet: Quiet = False,
) -> None:
    """Copy the package's examples into a folder. They are the tour's recording, studies, maps and requirements."""
    from loopshape.verbs.files import copy_examples

    output = Output(as_json, quiet)
    copied = [str(path) for path in copy_examples(out)]
    output.say("\n".join(["copied:", *(f"  {path}" for path in copied)]))
    output.json({"examples": copied})
