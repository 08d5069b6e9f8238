"""Names to things: the one place where a plant's name finds its plant."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, cast

from loopshape.core.errors import WrongUseError, meant

if TYPE_CHECKING:
    from loopshape.toolbox.gap.nouns.plant import Followable
    from loopshape.toolbox.rig.simulated import Rig

PLANTS = ("arm-1dof", "servo-axis", "arm-2dof", "arm-2dof-pairs")


def plant(name: str) -> Rig:
    """A simulated plant by name; refuses an unknown one."""
    if name == "arm-1dof":
        from loopshape.toolbox.arm.arm1 import Arm1

        return Arm1()
    if name == "arm-2dof":
        from loopshape.toolbox.arm.arm2 import Arm2

        return Arm2()
    if name == "arm-2dof-pairs":
        from loopshape.toolbox.arm.arm2 import Arm2
        from loopshape.toolbox.arm.strategies2 import PAIRS

        return Arm2(PAIRS)
    if name == "servo-axis":
        from loopshape.toolbox.servo.axis import ServoAxis

        return ServoAxis(zero_is_ordinary=True)
    raise WrongUseError("a plant is not known", f"{name!r}", f"{meant(name, PLANTS)}use one of {', '.join(PLANTS)}")


def diagnosable(name: str) -> Followable:
    """A plant whose gap can be diagnosed, by name; refuses an unknown one."""
    found: Any = plant(name)
    if not hasattr(found, "effects"):
        raise WrongUseError("this plant has no catalogue of effects", f"{name!r}", "compare two runs instead")
    return cast("Followable", found)
