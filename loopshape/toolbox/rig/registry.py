"""Names to things: the one place where the name of a plant in a study finds what a toolbox declares for it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, cast

from loopshape.core.errors import WrongUseError, meant
from loopshape.core.toolboxes import found, function_at

if TYPE_CHECKING:
    from loopshape.toolbox.gap.nouns.plant import SimulationModel
    from loopshape.toolbox.rig.simulated import Rig


def plant(name: str) -> Rig:
    """A simulated plant by name; refuses an unknown one."""
    return cast("Rig", declared("plants", name, "a plant is not known")())


def diagnosable(name: str) -> SimulationModel:
    """A plant whose gap can be diagnosed, by name; refuses an unknown one."""
    rig: Any = plant(name)
    if not hasattr(rig, "effects"):
        raise WrongUseError("this plant has no catalogue of effects", f"{name!r}", "compare two runs instead")
    return cast("SimulationModel", rig)


def declared(what: str, name: str, problem: str) -> Any:
    """What a toolbox declares for a plant's name among its `plants`, `boards` or `effect_pages`; refuses another."""
    known = found().all(what)
    if name not in known:
        raise WrongUseError(problem, f"{name!r}", f"{meant(name, tuple(known))}use one of {', '.join(sorted(known))}")
    return function_at(known[name])
