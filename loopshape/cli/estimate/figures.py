"""`loopshape figures`: all pictures that a run can give."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from loopshape.cli.output import AsJson, Output, Quiet, RunFolder


def figures(
    run: RunFolder,
    out: Annotated[Path | None, typer.Option(help="Where to; default: figures in the run.")] = None,
    controller: Annotated[Path | None, typer.Option(help="A controller file: draws its loops too.")] = None,
    require: Annotated[Path | None, typer.Option(help="Requirements: draws their limits too.")] = None,
    as_json: AsJson = False,
    quiet: Quiet = False,
) -> None:
    """Draw the figures of a run. FRFs with their fits, parameter maps, and with a controller its loops."""
    from loopshape.verbs.pictures import draw_run

    output = Output(as_json, quiet)
    drawn = draw_run(run, out, controllers=controller, requirements=require, watch=output)
    output.say("\n".join(drawn))
    output.json({"figures": drawn})
