"""Block diagrams around one tuned block: a diagram and measured plants come in, equivalent plants go out.

Common diagrams, their files, their picture, their C code.
"""

from __future__ import annotations

from loopshape.core.toolboxes import Toolbox

TOOLBOX = Toolbox(
    "diagrams",
    "Block diagrams around one tuned block: a diagram and measured plants come in, equivalent plants go out",
    formats={"loopshape-diagram/1": "loopshape.toolbox.diagrams.files:read_diagram"},
    parts={"Block diagram": "loopshape.toolbox.diagrams.report_parts:diagram"},
    names={
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
