"""What is achievable: FRFs and requirements come in, the bandwidth that no controller exceeds goes out.

A controller of a given order near that bound goes out too, and a tuned structure grows.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from loopshape.core.toolboxes import Command, Toolbox

if TYPE_CHECKING:
    from loopshape.toolbox.limits.bound import Bound as Bound
    from loopshape.toolbox.limits.verbs import bound as bound
    from loopshape.toolbox.limits.verbs import max_order_design as max_order_design

TOOLBOX = Toolbox(
    "limits",
    "What is achievable: FRFs and requirements come in, the bandwidth that no controller exceeds goes out",
    commands=(
        Command(
            "Design",
            "bound",
            "loopshape.toolbox.limits.command:bound",
            "loopshape bound runs/axis controller.toml --require requirements.toml",
            30,
        ),
    ),
    searches={"grow": "loopshape.toolbox.limits.growth:grow"},
    names={
        "Bound": "loopshape.toolbox.limits.bound",
        "bound": "loopshape.toolbox.limits.verbs",
        "max_order_design": "loopshape.toolbox.limits.verbs",
    },
)
