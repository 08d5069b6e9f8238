"""`loopshape export`: a run's FRFs as files for other programs."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from loopshape.cli.output import AsJson, Output, Quiet, RunFolder


def export(
    run: RunFolder,
    to: Annotated[str, typer.Option(help="mat (MATLAB), csv, or uff (universal file 58; needs the extra uff).")],
    out: Annotated[Path | None, typer.Option(help="Folder to write into; default: export in the run.")] = None,
    as_json: AsJson = False,
    quiet: Quiet = False,
) -> None:
    """Write each FRF of a run as a file, all of them or none; import-frf reads them back."""
    from loopshape.io.files import inside
    from loopshape.io.frf_exchange import export_frfs
    from loopshape.io.frfs import FOLDER, MATRICES, has_any, read_frfs, read_matrices

    output = Output(as_json, quiet)
    folder = out or inside(run, "export", "the folder of exported FRFs")
    matrices = read_matrices(run) if has_any(run, MATRICES) else ()
    single = read_frfs(run) if not matrices or has_any(run, FOLDER) else ()
    frfs = (*single, *matrices)
    paths, lost = export_frfs(frfs, to, folder)
    columns = ["file", "recording", "loop", "outputs", "inputs", "lines"]
    rows = [
        [path.name, one.recording, one.loop, ", ".join(one.outputs), ", ".join(one.inputs), one.frequency_hz.size]
        for path, one in zip(paths, frfs, strict=True)
    ]
    output.table(f"FRFs in {folder}", columns, rows)
    output.warn(lost)
    output.json({"run": str(run), "format": to, "files": [str(path) for path in paths], "warnings": list(lost)})
