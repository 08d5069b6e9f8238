"""For studies of tuning: the arm's 24 FRFs of the example study with their fits, and small tables."""

from __future__ import annotations

import csv
from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path

from loopshape.data.response.frf import FRF
from loopshape.data.response.model import Fit
from loopshape.identify.fit import fit, structure_by_name
from loopshape.identify.frequency_response import estimate_frf
from loopshape.toolbox.arm.arm1 import Arm1
from loopshape.toolbox.rig.files.study import read_study
from loopshape.toolbox.rig.simulated import header, measure

EXAMPLES = Path(__file__).parents[2] / "examples" / "arm"


def measured() -> tuple[list[FRF], list[Fit]]:
    """The 24 FRFs of the angle loop in the example study, and their third-order fits."""
    study, plant = read_study(EXAMPLES / "identify.toml"), Arm1()
    study = replace(study, experiments=tuple(e for e in study.experiments if e.excites == "theta2"))
    loop = header(study, plant).loop("theta2")
    frfs = [estimate_frf(recording, loop) for recording in measure(study, plant)]
    return frfs, [fit(frf, structure_by_name("third_order")) for frf in frfs]


def write(path: Path, columns: Sequence[str], rows: Iterable[Sequence]) -> None:
    """A small table, also shown."""
    rows = [[f"{cell:.4g}" if isinstance(cell, float) else cell for cell in row] for row in rows]
    with path.open("w", newline="") as file:
        csv.writer(file).writerows([columns, *rows])
    for line in (columns, *rows):
        print("  ".join(str(cell) for cell in line))
