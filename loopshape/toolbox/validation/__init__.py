"""Whether a measurement bears a prediction out: predictions and a run under their controllers come in, or two FRFs.

Comparisons of S, steps and profiles go out, each confirmed, refuted or undecided; and what became of a kept verdict.
"""

from __future__ import annotations

from loopshape.core.toolboxes import Command, Toolbox

TOOLBOX = Toolbox(
    "validation",
    "Whether a measurement bears a prediction out: predictions and a run under their controllers, or two FRFs",
    commands=(
        Command(
            "Verify",
            "compare",
            "loopshape.toolbox.validation.command:compare",
            "loopshape compare runs/after prediction.npz",
            30,
        ),
    ),
    comparisons={"verdict": "loopshape.toolbox.validation.kept.against:against"},
    verbs={"compare": "loopshape.toolbox.validation.verbs"},
)
