"""Why the simulation lies: a run and a machine that can be followed come in, a gap report goes out.

Machines of one's own (`own`, `mechanism`) live here too.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from loopshape.core.toolboxes import Command, Toolbox

if TYPE_CHECKING:
    from loopshape.toolbox.gap.nouns.axis import axis as axis
    from loopshape.toolbox.gap.nouns.gap_report import GapReport as GapReport
    from loopshape.toolbox.gap.nouns.machine import Input as Input
    from loopshape.toolbox.gap.nouns.machine import Model as Model
    from loopshape.toolbox.gap.nouns.machine import ModelParameter as ModelParameter
    from loopshape.toolbox.gap.nouns.machine import Output as Output
    from loopshape.toolbox.gap.nouns.machine import Port as Port
    from loopshape.toolbox.gap.verbs import gap as gap
    from loopshape.toolbox.gap.verbs import identifiability as identifiability

TOOLBOX = Toolbox(
    "gap",
    "Why the simulation lies: a run and a machine that can be followed come in, a gap report goes out",
    commands=(
        Command("Diagnose", "gap", "loopshape.toolbox.gap.commands.gap:gap", "loopshape gap runs/arm", 10),
        Command(
            "Diagnose", "effects", "loopshape.toolbox.gap.commands.effects:effects", "loopshape effects arm-1dof", 20
        ),
    ),
    looks={"levels": "loopshape.toolbox.gap.two_runs.levels:remarks"},
    names={
        "axis": "loopshape.toolbox.gap.nouns.axis",
        "GapReport": "loopshape.toolbox.gap.nouns.gap_report",
        "Input": "loopshape.toolbox.gap.nouns.machine",
        "Model": "loopshape.toolbox.gap.nouns.machine",
        "ModelParameter": "loopshape.toolbox.gap.nouns.machine",
        "Output": "loopshape.toolbox.gap.nouns.machine",
        "Port": "loopshape.toolbox.gap.nouns.machine",
        "gap": "loopshape.toolbox.gap.verbs",
        "identifiability": "loopshape.toolbox.gap.verbs",
    },
)
