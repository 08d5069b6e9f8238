"""Nouns out of files of other programs and into them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any

from loopshape.core.errors import refuse_unknown_keys
from loopshape.data.control.controller import Controller
from loopshape.data.control.gain_scheduled import GainScheduled
from loopshape.data.response.frf import FRF
from loopshape.data.signal.run import Run
from loopshape.design.tune import Tuning
from loopshape.toolbox.diagrams.diagram import Diagram


def read_table(file: str | Path, map_file: str | Path) -> Run:
    """The run in a table of another program (CSV, Parquet, MAT, MDF), whose columns a map names (TOML).

    The map says rate, units, loops and what was injected where; `docs/files.md` has its keys. Raises
    UnreadableInputError for a damaged file, WrongUseError for a map that does not fit it.
    """
    from loopshape.toolbox.formats.tables.import_file import import_file

    return import_file(Path(file), Path(map_file))


def read_frf(file: str | Path, **stated: Any) -> FRF:
    """The FRF in a file of another program (CSV, MAT, UFF), told by its ending.

    `stated` replaces what the file says or leaves out: relative_std (0: exact), averages, inputs, outputs, recording,
    loop, rate_hz. Raises WrongUseError where neither the file nor `stated` tells the error.
    """
    from loopshape.toolbox.formats.frf.frf_exchange import read_frf_file
    from loopshape.toolbox.formats.frf.frf_foreign import Stated

    refuse_unknown_keys("what is stated of an FRF is not known", stated, [f.name for f in fields(Stated)])
    return read_frf_file(Path(file), Stated(**stated))


def export(
    controllers: Controller | GainScheduled | Tuning | Diagram | Sequence[Controller | GainScheduled],
    folder: str | Path,
    to: str,
) -> tuple[Path, ...]:
    """Write controllers as the target runs them, in sections: "json", "matlab", or "c" (a C99 header); gives the files.

    A schedule is written as "json" or "c", a diagram too: its controllers, and what leads from one to the other.
    Raises WrongUseError for another format and for sections that are unstable as they will run.
    """
    from loopshape.toolbox.formats.controllers.controller_export import export_controllers

    if isinstance(controllers, Diagram):
        from loopshape.toolbox.diagrams.diagram_c import export_diagram

        return export_diagram(Path(folder), controllers, to)
    one = controllers.controller if isinstance(controllers, Tuning) else controllers
    return export_controllers(Path(folder), (one,) if isinstance(one, Controller | GainScheduled) else tuple(one), to)
