"""`loopshape verify`: is a run what was recorded?"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from loopshape.cli.output import AsJson, Output, Quiet, RunFolder


def verify(
    run: RunFolder,
    study: Annotated[Path | None, typer.Option(help="The study that the run should have been made by.")] = None,
    as_json: AsJson = False,
    quiet: Quiet = False,
) -> None:
    """Check a run's files against their hashes. The hashes were noted when the files were written."""
    from loopshape.verbs import files

    output = Output(as_json, quiet)
    found = files.verify(run, study)
    words = {True: "sound", False: "NOT SOUND", None: "cannot be told"}
    output.table(f"{run}:", ("what", "outcome", "why"), [(f.what, words[f.sound], f.reason) for f in found])
    wrong = [finding for finding in found if finding.sound is False]
    output.say("every file is what was written" if not wrong else f"{len(wrong)} not sound")
    output.json({"sound": not wrong, "findings": found})
    if wrong:
        raise typer.Exit(1)
