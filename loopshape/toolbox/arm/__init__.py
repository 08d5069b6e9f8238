"""The pneumatic muscle arm (van den Brink, DCT 2007.002): its numbers, its simulation, its demo.

An experiment comes in, a recording goes out; the gap toolbox follows it through `effect`.
"""

from __future__ import annotations

from loopshape.core.toolboxes import Command, Toolbox

TOOLBOX = Toolbox(
    "arm",
    "The pneumatic muscle arm (van den Brink, DCT 2007.002): its numbers, its simulation, its demo",
    commands=(
        Command("Start", "demo", "loopshape.toolbox.arm.commands.demo:demo", "loopshape demo --out demo", 10),
        Command(
            "Diagnose",
            "equilibria",
            "loopshape.toolbox.arm.commands.equilibria:equilibria",
            "loopshape equilibria --out figures",
            30,
        ),
    ),
    plants={
        "arm-1dof": "loopshape.toolbox.arm.arm1:Arm1",
        "arm-2dof": "loopshape.toolbox.arm.arm2:Arm2",
        "arm-2dof-pairs": "loopshape.toolbox.arm.arm2:arm2_pairs",
    },
    boards={"arm-1dof": "loopshape.toolbox.arm.emulated:BOARD"},
    effect_pages={"arm-1dof": "loopshape.toolbox.arm.effects_page:draw_effects"},
)
