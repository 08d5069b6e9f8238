"""What verbs take: a plant as an FRF, several or a diagram; a controller, or the tuning that holds it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from loopshape.core.errors import WrongUseError
from loopshape.data.control.controller import Controller
from loopshape.data.requirement.requirements import Requirements
from loopshape.data.response.frf import FRF
from loopshape.data.result.equivalent import Diagram

if TYPE_CHECKING:
    from loopshape.design.tune import Tuning

Plants = FRF | Sequence[FRF] | Diagram


def controller_of(given: Controller | Tuning) -> Controller:
    """The controller, also of a tuning."""
    if isinstance(given, Controller):
        return given
    from loopshape.design.tune import Tuning

    return given.controller if isinstance(given, Tuning) else given


def required_of(
    R: Requirements | Sequence[Requirements] | None, together: Requirements | None
) -> tuple[list[Requirements], Requirements | None]:
    """Requirements of each loop, and of all together: of several the one without a name, as `ls.read` gives them."""
    asked = [R] if isinstance(R, Requirements) else list(R or ())
    rest = [one for one in asked if not one.loop]
    if len(asked) < 2 or len(rest) != 1 or together is not None:
        return asked, together
    return [one for one in asked if one.loop], rest[0]


def equivalent_plants(P: Plants, R: Requirements) -> tuple[tuple[FRF, ...], Requirements]:
    """The plants, and the requirements with what a diagram tells of their unstable poles."""
    if not isinstance(P, Diagram):
        return plants_of(P), R
    found = P.equivalent()
    return found.plants, found.asked(R)


def plants_of(P: Plants) -> tuple[FRF, ...]:
    """FRFs of one loop, of a diagram those that its tuned block meets; several without a name are numbered."""
    if isinstance(P, Diagram):
        return equivalent_plants(P, Requirements(P.tuned))[0]
    plants = (P,) if isinstance(P, FRF) else tuple(P)
    if wrong := [type(x).__name__ for x in plants if not isinstance(x, FRF)]:
        raise WrongUseError(
            "a plant is an FRF, or a sequence of them",
            ", ".join(wrong),
            "make one with ls.FRF.from_arrays or from_control",
        )
    return plants
