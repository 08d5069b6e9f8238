"""Where a run leaves the model of its plant, or one of your own, and which effect causes it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from loopshape.core.errors import WrongUseError
from loopshape.data.run import Run
from loopshape.verbs.files import read

if TYPE_CHECKING:
    from loopshape.data.gap_report import GapReport
    from loopshape.data.machine import Model
    from loopshape.data.plant import Followable


def gap(
    run: Run | str | Path,
    *,
    model: Model | str | Path | None = None,
    table: bool = True,
    name: str | None = None,
    say: Callable[[str], None] = lambda step: None,
) -> GapReport:
    """Where a simulation leaves the machine, which effect causes it, and how far the gap shrinks with it added.

    `model` is a machine of your own, or the path of its `model.toml`, whose Python file is run (or whose MuJoCo model
    or FMU is read). Without it the run names its plant's model (`plant` in run.toml: an arm, or the servo axis). "none"
    and "unknown" are answers. `table` false leaves out the table of closed loops, which takes the longest. Raises
    WrongUseError for a run without a plant, and for a model whose channels are mapped with a wrong sign or unit.
    """
    from loopshape.diagnose.diagnose import diagnose

    whole = run if isinstance(run, Run) else read(run)
    plant = _followable(whole, model)
    return diagnose(plant, whole, name or ("run" if isinstance(run, Run) else Path(run).name), table=table, say=say)


def _followable(run: Run, model: Model | str | Path | None) -> Followable:
    """The user's machine, or the plant that the run names."""
    from loopshape.data.machine import Mechanism, Unit
    from loopshape.io.machine import read_model
    from loopshape.model.own.kinds import with_kinds
    from loopshape.model.own.mechanism import machine
    from loopshape.model.own.mockup import machine_of
    from loopshape.model.own.plant import OwnMachine
    from loopshape.model.registry import diagnosable

    if model is not None:
        own = read_model(Path(model)) if isinstance(model, str | Path) else model
        kinds = own.kinds
        if isinstance(own, Unit):
            own = machine_of(own)
        return OwnMachine(with_kinds(machine(own) if isinstance(own, Mechanism) else own, kinds))
    if run.plant is None:
        raise WrongUseError(
            "the run names no plant, so there is no model to compare with",
            "no key plant in run.toml",
            "name one (plant = ...), give a model of your own (--model model.toml), "
            "or a second run: loopshape gap RUN_REAL RUN_SIM",
        )
    return diagnosable(run.plant)
