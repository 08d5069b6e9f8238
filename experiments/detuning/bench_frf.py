"""For studies of tuning: the motor bench's FRF of real recordings, its fit and its requirements."""

from __future__ import annotations

from pathlib import Path

from loopshape.data.requirement.requirements import Requirements
from loopshape.data.response.frf import FRF
from loopshape.data.response.model import Fit
from loopshape.identify.fit import fit
from loopshape.identify.frequency_response import estimate_frf
from loopshape.identify.structures import Rational
from loopshape.io.requirements import read_requirements
from loopshape.toolbox.formats.tables.import_file import import_file

FOLDER = Path(__file__).parents[2] / "examples" / "motor_bench"


def motor_bench() -> tuple[list[FRF], list[Fit], Requirements]:
    """The bench's FRF, its fit and its requirements."""
    run = import_file(FOLDER / "multisine_type_a.parquet", FOLDER / "map.toml")
    frf = estimate_frf(run.recordings[0], run.loops[0])
    model = fit(frf, Rational(2, 4, delay=True), weighting="relative")
    return [frf], [model], read_requirements(FOLDER / "requirements.toml")[0]
