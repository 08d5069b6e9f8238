"""`loopshape export-controller`: controllers as biquads for the target, in JSON, MATLAB or C99."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from loopshape.cli.output import AsJson, Output, Quiet


def export_controller(
    controller: Annotated[Path, typer.Argument(help="A controller file, as tune writes it.", show_default=False)],
    to: Annotated[str, typer.Option(help="json, matlab, or c (a C99 header with a step function).")],
    out: Annotated[Path, typer.Option(help="Folder to write into, one file a loop.")],
    as_json: AsJson = False,
    quiet: Quiet = False,
) -> None:
    """Write each controller of a file as it runs: its sections, rounded to its precision, as check judges them."""
    from loopshape.io.controller_export import export_controllers
    from loopshape.io.controllers import read_controllers

    output, controllers = Output(as_json, quiet), read_controllers(controller)
    paths = export_controllers(out, controllers, to)
    columns = ["file", "loop", "digest", "precision", "sections", "moved by rounding [%]"]
    rows = [
        [path.name, one.loop, one.digest, one.precision, len(one.blocks), 100.0 * one.moved_by_rounding()]
        for path, one in zip(paths, controllers, strict=True)
    ]
    output.table(f"Controllers in {out}", columns, rows)
    keys = ("file", "loop", "digest", "precision", "sections", "moved_by_rounding_percent")
    told = [dict(zip(keys, [str(path), *row[1:]], strict=True)) for path, row in zip(paths, rows, strict=True)]
    output.json({"controllers": str(controller), "format": to, "exported": told})
