"""Which experiment to make: a first short recording comes in, a plan with its excitation goes out.

`tone` tells what a recording holds by itself: rms, and tones that the excitation does not explain.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from loopshape.core.toolboxes import Command, Toolbox

if TYPE_CHECKING:
    from loopshape.toolbox.planning.tone.verbs import tones as tones
    from loopshape.toolbox.planning.verbs import enough as enough
    from loopshape.toolbox.planning.verbs import plan as plan
    from loopshape.toolbox.planning.verbs import write_plan as write_plan

TOOLBOX = Toolbox(
    "planning",
    "Which experiment to make: a first short recording comes in, a plan with its excitation goes out",
    commands=(
        Command(
            "Estimate",
            "plan",
            "loopshape.toolbox.planning.commands.plan:plan",
            "loopshape plan runs/axis --std-percent 5",
            40,
        ),
        Command(
            "Estimate", "tones", "loopshape.toolbox.planning.commands.tones:tones", "loopshape tones runs/axis", 50
        ),
    ),
    looks={"growth": "loopshape.toolbox.planning.tone.verbs:growing"},
    names={
        "tones": "loopshape.toolbox.planning.tone.verbs",
        "enough": "loopshape.toolbox.planning.verbs",
        "plan": "loopshape.toolbox.planning.verbs",
        "write_plan": "loopshape.toolbox.planning.verbs",
    },
)
