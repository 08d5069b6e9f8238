"""Feedforward, iterative and repetitive learning: a measured plant comes in, taps or a filter go out.

The next trial's feedforward is learned from recordings.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from loopshape.core.toolboxes import Command, Toolbox

if TYPE_CHECKING:
    from loopshape.toolbox.learning.feedforward import feedforward as feedforward
    from loopshape.toolbox.learning.learning import learning as learning
    from loopshape.toolbox.learning.next_trial import next_trial as next_trial
    from loopshape.toolbox.learning.repetitive import repetitive as repetitive
    from loopshape.toolbox.learning.verbs import tracking_error as tracking_error

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
