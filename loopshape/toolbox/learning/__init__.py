"""Feedforward, iterative and repetitive learning: a measured plant comes in, taps or a filter go out.

The next trial's feedforward is learned from recordings.
"""

from __future__ import annotations

from loopshape.core.toolboxes import Command, Toolbox

TOOLBOX = Toolbox(
    "learning",
    "Feedforward, iterative and repetitive learning: a measured plant comes in, taps or a filter go out",
    commands=(
        Command(
            "Design",
            "feedforward",
            "loopshape.toolbox.learning.commands.feedforward:feedforward",
            "loopshape feedforward runs/axis --band-hz 0.5 20 --out feedforward.json",
            50,
        ),
        Command(
            "Design",
            "learning",
            "loopshape.toolbox.learning.commands.learning:learning",
            "loopshape learning runs/axis controller.toml --band-hz 0.5 20 --out learning.json",
            60,
        ),
        Command(
            "Design",
            "next-trial",
            "loopshape.toolbox.learning.commands.next_trial:next_trial",
            "loopshape next-trial runs/move learning.json --out next.csv",
            70,
        ),
    ),
    names={
        "feedforward": "loopshape.toolbox.learning.feedforward",
        "learning": "loopshape.toolbox.learning.learning",
        "next_trial": "loopshape.toolbox.learning.next_trial",
        "repetitive": "loopshape.toolbox.learning.repetitive",
        "tracking_error": "loopshape.toolbox.learning.verbs",
    },
)
