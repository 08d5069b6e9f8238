"""`loopshape export-excitation`: a study's signals as files for MATLAB, Simulink, C or a table."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from loopshape.cli.measure import StudyFile
from loopshape.cli.output import AsJson, Output, Quiet


def export_excitation(
    study: StudyFile,
    to: Annotated[str, typer.Option(help="csv, mat (MATLAB and Simulink), or c (a C99 header).")],
    out: Annotated[Path, typer.Option(help="Folder to write into, one file an experiment.")],
    as_json: AsJson = False,
    quiet: Quiet = False,
) -> None:
    """Write what a study injects and where its setpoints go, sample by sample, for a rig that loads files."""
    from loopshape.io.excitation_export import export_signals
    from loopshape.io.study import read_study
    from loopshape.model import registry
    from loopshape.rig.described import DescribedRig
    from loopshape.rig.simulated import experiment, plan

    output, read = Output(as_json, quiet), read_study(study)
    plant = DescribedRig(read.loops) if read.loops else registry.plant(read.plant)
    made = [experiment(read, plant, planned) for planned in plan(read, plant)]
    paths = export_signals(out, made, to)
    rows = [(path.name, e.injection, e.samples, e.rate_hz) for path, e in zip(paths, made, strict=True)]
    output.table(f"Signals in {out}", ("file", "injection", "samples", "Hz"), rows)
    output.json({"study": str(study), "format": to, "exported": [str(path) for path in paths]})
