"""Block diagrams around one tuned block: a diagram and measured plants come in, equivalent plants go out.

Common diagrams, their files, their picture, their C code. How the loops of one plant meet, and what decouples them.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from loopshape.core.toolboxes import Command, Toolbox

if TYPE_CHECKING:
    from loopshape.toolbox.diagrams.common_diagrams import cascade as cascade
    from loopshape.toolbox.diagrams.common_diagrams import disturbance_observer as disturbance_observer
    from loopshape.toolbox.diagrams.common_diagrams import dual_stage as dual_stage
    from loopshape.toolbox.diagrams.common_diagrams import prefilter as prefilter
    from loopshape.toolbox.diagrams.common_diagrams import two_sensors as two_sensors
    from loopshape.toolbox.diagrams.coupling.decouple import decouple as decouple
    from loopshape.toolbox.diagrams.coupling.decouple import decoupled as decoupled
    from loopshape.toolbox.diagrams.diagram import Diagram as Diagram
    from loopshape.toolbox.diagrams.diagram import Part as Part
    from loopshape.toolbox.diagrams.diagram_run import simulate as simulate
    from loopshape.toolbox.diagrams.equivalent import Equivalent as Equivalent
    from loopshape.toolbox.diagrams.equivalent import equivalent as equivalent
    from loopshape.toolbox.diagrams.multirate import multirate as multirate
    from loopshape.toolbox.diagrams.transfer import transfer as transfer
    from loopshape.toolbox.diagrams.wired import Wired as Wired

TOOLBOX = Toolbox(
    "diagrams",
    "Block diagrams around one tuned block: a diagram and measured plants come in, equivalent plants go out",
    commands=(
        Command(
            "Estimate",
            "interaction",
            "loopshape.toolbox.diagrams.coupling.command:interaction",
            "loopshape interaction runs/arm2",
            30,
        ),
    ),
    verbs={"interaction": "loopshape.toolbox.diagrams.coupling.interaction"},
    formats={"loopshape-diagram/1": "loopshape.toolbox.diagrams.files:read_diagram"},
    parts={"Block diagram": "loopshape.toolbox.diagrams.report_parts:diagram"},
    names={
        "decouple": "loopshape.toolbox.diagrams.coupling.decouple",
        "decoupled": "loopshape.toolbox.diagrams.coupling.decouple",
        "multirate": "loopshape.toolbox.diagrams.multirate",
        "cascade": "loopshape.toolbox.diagrams.common_diagrams",
        "disturbance_observer": "loopshape.toolbox.diagrams.common_diagrams",
        "dual_stage": "loopshape.toolbox.diagrams.common_diagrams",
        "prefilter": "loopshape.toolbox.diagrams.common_diagrams",
        "two_sensors": "loopshape.toolbox.diagrams.common_diagrams",
        "Diagram": "loopshape.toolbox.diagrams.diagram",
        "Part": "loopshape.toolbox.diagrams.diagram",
        "simulate": "loopshape.toolbox.diagrams.diagram_run",
        "Equivalent": "loopshape.toolbox.diagrams.equivalent",
        "equivalent": "loopshape.toolbox.diagrams.equivalent",
        "transfer": "loopshape.toolbox.diagrams.transfer",
        "Wired": "loopshape.toolbox.diagrams.wired",
    },
)
