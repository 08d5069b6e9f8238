"""The machine: simulated, or a real-time target over a wire; an experiment comes in, a recording goes out.

`c_target` is the reference target in C99.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from loopshape.core.toolboxes import Command, Toolbox

if TYPE_CHECKING:
    from loopshape.toolbox.rig.study import Study as Study
    from loopshape.toolbox.rig.verbs.adopt import adopt as adopt
    from loopshape.toolbox.rig.verbs.adopt import advise as advise
    from loopshape.toolbox.rig.verbs.machine import connect as connect
    from loopshape.toolbox.rig.verbs.machine import emulator as emulator
    from loopshape.toolbox.rig.verbs.machine import measure as measure
    from loopshape.toolbox.rig.verbs.stop import stop as stop

TOOLBOX = Toolbox(
    "rig",
    "The machine: simulated, or a real-time target over a wire; an experiment comes in, a recording goes out",
    commands=(
        Command(
            "Measure and import",
            "measure",
            "loopshape.toolbox.rig.commands.measure:measure",
            "loopshape measure examples/arm/identify.toml --out runs/arm",
            10,
        ),
        Command(
            "Measure and import",
            "simulate",
            "loopshape.toolbox.rig.commands.simulate:simulate",
            "loopshape simulate examples/arm/steps.toml --out runs/steps --effect payload=20",
            20,
        ),
        Command(
            "Measure and import",
            "adopt",
            "loopshape.toolbox.rig.commands.adopt:adopt",
            "loopshape adopt runs/axis controller.toml --study axis.toml --port tcp://127.0.0.1:4040 --out runs/adopt",
            30,
        ),
        Command(
            "Measure and import",
            "emulator",
            "loopshape.toolbox.rig.commands.emulator:emulator",
            "loopshape emulator --tcp 4040",
            60,
        ),
        Command(
            "Measure and import", "stop", "loopshape.toolbox.rig.commands.stop:stop", "loopshape stop runs/arm", 70
        ),
    ),
    looks={"distortion": "loopshape.toolbox.rig.distortion:remarks"},
    names={
        "Study": "loopshape.toolbox.rig.study",
        "adopt": "loopshape.toolbox.rig.verbs.adopt",
        "advise": "loopshape.toolbox.rig.verbs.adopt",
        "connect": "loopshape.toolbox.rig.verbs.machine",
        "emulator": "loopshape.toolbox.rig.verbs.machine",
        "measure": "loopshape.toolbox.rig.verbs.machine",
        "stop": "loopshape.toolbox.rig.verbs.stop",
    },
)
