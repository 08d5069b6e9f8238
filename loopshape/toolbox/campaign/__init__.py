"""One study on many simulated machines: a campaign file comes in, a folder of runs and a table go out.

Work is shared out to processes of this machine or to a Dask cluster.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from loopshape.core.toolboxes import Command, Toolbox

if TYPE_CHECKING:
    from loopshape.toolbox.campaign.verbs import campaign as campaign

TOOLBOX = Toolbox(
    "campaign",
    "One study on many simulated machines: a campaign file comes in, a folder of runs and a table go out",
    commands=(
        Command(
            "Measure and import",
            "campaign",
            "loopshape.toolbox.campaign.commands:campaign",
            "loopshape campaign campaign.toml --out runs/many --workers 2",
            30,
        ),
    ),
    names={
        "campaign": "loopshape.toolbox.campaign.verbs",
    },
)
