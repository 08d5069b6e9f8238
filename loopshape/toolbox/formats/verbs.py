"""Nouns out of files of other programs and into them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from loopshape.core.errors import WrongUseError, refuse_unknown_keys
from loopshape.data.arrays import real_array
from loopshape.data.control.controller import Controller
from loopshape.data.control.scheduled import Scheduled
from loopshape.data.response.frf import FRF
from loopshape.data.signal.run import Run
from loopshape.design.tune import Tuning
from loopshape.toolbox.diagrams.diagram import Diagram
from loopshape.toolbox.formats.controllers.limited import OutputLimits, Simulation

if TYPE_CHECKING:
    import control


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
    controllers: Controller | Scheduled | Tuning | Diagram | Sequence[Controller | Scheduled],
    folder: str | Path,
    to: str,
    limits: OutputLimits | None = None,
) -> tuple[Path, ...]:
    """Write controllers as the target runs them, in sections: "json", "matlab", or "c" (a C99 header); gives the files.

    A schedule is written as "json" or "c", a diagram too: its controllers, and what leads from one to the other.
    With `limits` the code limits the output and its rate, keeps its integrator from winding up and starts without a
    bump; `simulate` is the loop with them. Raises WrongUseError for another format and for sections that are unstable
    as they will run.
    """
    from loopshape.toolbox.formats.controllers.controller_export import export_controllers

    if isinstance(controllers, Diagram):
        if limits is not None:
            raise WrongUseError(
                "the limits of a diagram's outputs belong to its caller", "a diagram", "export it without"
            )
        from loopshape.toolbox.diagrams.diagram_c import export_diagram

        return export_diagram(Path(folder), controllers, to)
    one = controllers.controller if isinstance(controllers, Tuning) else controllers
    every = (one,) if isinstance(one, Controller | Scheduled) else tuple(one)
    return export_controllers(Path(folder), every, to, limits)


def simulate(
    P: control.LTI,
    C: Controller | Tuning,
    limits: OutputLimits,
    *,
    setpoint: ArrayLike | None = None,
    disturbance: ArrayLike | None = None,
) -> Simulation:
    """A loop at the controller's rate, from rest, whose controller is limited as its exported code is, bit for bit.

    `setpoint` (n,) is in the output's unit, `disturbance` (n,) is added to the plant's input; one of them may be left
    out. `P` is a system of python-control, sampled behind a zero-order hold. What a verdict says holds while the output
    is not limited: `limited_percent` of the answer is how much of the time it is. Raises WrongUseError for lengths that
    differ, a plant that answers within the sample, another rate, and a computation delay of parts of a sample.

    >>> import control, numpy as np, loopshape as ls
    >>> C = ls.controller(ls.gain(2.0), ls.pi(1.0), rate_hz=100.0)
    >>> P = control.tf([1.0], [0.1, 1.0])
    >>> ls.formats.simulate(P, C, ls.formats.OutputLimits(-1.2, 1.2), setpoint=np.ones(200))
    Simulation: 200 samples, error rms 0.1794, limited 0.5 %
    """
    from loopshape.toolbox.formats.controllers.limited import simulate

    given = [None if x is None else real_array(x, "a signal of a simulation", ndim=1) for x in (setpoint, disturbance)]
    sizes = {x.size for x in given if x is not None}
    if len(sizes) != 1:
        raise WrongUseError(
            "a simulation takes a setpoint, a disturbance, or both of one length", f"{sorted(sizes)} samples"
        )
    r, d = (np.zeros(max(sizes)) if x is None else x for x in given)
    controller = C.controller if isinstance(C, Tuning) else C
    return simulate(P, controller, limits, setpoint=r, disturbance=d)
