"""One robust controller against one for each operating point, and schedules out to a target.

FRFs over operating points come in, a comparison, a picture of |S| over all points and files go out.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from loopshape.core.toolboxes import Command, Toolbox

if TYPE_CHECKING:
    from loopshape.toolbox.schedules.gain_scheduled import GainScheduled as GainScheduled
    from loopshape.toolbox.schedules.verbs import gain_scheduled as gain_scheduled
    from loopshape.toolbox.schedules.verbs import read_gain_scheduled as read_gain_scheduled
    from loopshape.toolbox.schedules.verbs import schedule as schedule

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
    names={
        "GainScheduled": "loopshape.toolbox.schedules.gain_scheduled",
        "gain_scheduled": "loopshape.toolbox.schedules.verbs",
        "read_gain_scheduled": "loopshape.toolbox.schedules.verbs",
        "schedule": "loopshape.toolbox.schedules.verbs",
    },
    controllers={"nodes": "loopshape.toolbox.schedules.table:ScheduleTable"},
    pictures={"atlas": "loopshape.toolbox.schedules.atlas:sensitivity_atlas"},
)
