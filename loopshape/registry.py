"""Names to things: the one place where a plant's name finds its plant."""

from __future__ import annotations

from typing import TYPE_CHECKING

from loopshape.errors import WrongUseError

if TYPE_CHECKING:
    from loopshape.rigs.simulated import Rig

PLANTS = ("arm-1dof",)


def plant(name: str) -> Rig:
    """A simulated plant by name; refuses an unknown one."""
    if name == "arm-1dof":
        from loopshape.plants.arm.arm1 import Arm1

        return Arm1()
    raise WrongUseError("a plant is not known", f"{name!r}", f"use one of {', '.join(PLANTS)}")
