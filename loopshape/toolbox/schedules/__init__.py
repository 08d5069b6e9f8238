"""One robust controller against one for each operating point, and schedules out to a target.

FRFs over operating points come in, a comparison and files go out.
"""

from __future__ import annotations

from loopshape.core.toolboxes import Command, Toolbox

TOOLBOX = Toolbox(
    "schedules",
    "One robust controller against one for each operating point, and schedules out to a target",
    commands=(
        Command(
            "Design",
            "schedule",
            "loopshape.toolbox.schedules.command:schedule",
            "loopshape schedule runs/axis --controller controller.toml --require requirements.toml",
            80,
        ),
    ),
)
