"""What a controller will make of a plant before it runs, and whether a measurement bears it out; two FRFs as well.

Predictions go out, and comparisons of S, steps and profiles, each confirmed, refuted or undecided; and what became of a
kept verdict.
"""

from __future__ import annotations

from loopshape.core.toolboxes import Command, Toolbox

TOOLBOX = Toolbox(
    "validation",
    "Whether a measurement bears a prediction out: predictions and a run under their controllers, or two FRFs",
    commands=(
        Command(
            "Verify",
            "predict",
            "loopshape.toolbox.validation.predicted.command:predict",
            "loopshape predict runs/axis controller.toml --out prediction.npz",
            20,
        ),
        Command(
            "Verify",
            "compare",
            "loopshape.toolbox.validation.command:compare",
            "loopshape compare runs/after prediction.npz",
            30,
        ),
    ),
    comparisons={"verdict": "loopshape.toolbox.validation.kept.against:against"},
    verbs={
        "Prediction": "loopshape.toolbox.validation.predicted.nouns",
        "compare": "loopshape.toolbox.validation.verbs",
        "predict": "loopshape.toolbox.validation.predicted.verbs",
    },
    writers={"Prediction.npz": "loopshape.toolbox.validation.predicted.file:write_predictions"},
    files={".npz": "loopshape.toolbox.validation.predicted.file:read_predictions"},
)
