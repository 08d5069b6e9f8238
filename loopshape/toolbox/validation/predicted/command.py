"""`loopshape predict`: what a controller will make of the plants that were measured, before it runs."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from loopshape.cli.output import AsJson, Output, Quiet, RunFolder, point

if TYPE_CHECKING:
    from loopshape.toolbox.validation.predicted.nouns import Prediction


def predict(
    run: RunFolder,
    controller: Annotated[Path, typer.Argument(help="A controller file (TOML).", show_default=False)],
    out: Annotated[Path, typer.Option(help="The prediction file to write (.npz).")],
    require: Annotated[
        Path | None, typer.Option(help="Requirements (TOML): its integrators and unstable poles of the plant.")
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the draws behind the steps' intervals.")] = 0,
    figures: Annotated[bool, typer.Option(help="Draw |S|, |T| and the step of each operating point.")] = True,
    as_json: AsJson = False,
    quiet: Quiet = False,
) -> None:
    """Predict S, T and the step of each loop.

    With the controller in place of the recorded one; `loopshape compare` compares a later run with it.
    """
    from loopshape.toolbox.validation.predicted.verbs import draw_predictions, predict_run
    from loopshape.verbs.files import write

    output = Output(as_json, quiet)
    made = predict_run(run, controller, require, seed=seed, watch=output)
    write(made, out)
    _report(made, output)
    drawn = draw_predictions(out, made) if figures else []
    output.say("\n".join([f"prediction written to {out}", *drawn]))
    output.json({"prediction": str(out), "figures": drawn, "predictions": made})


def _report(made: Sequence[Prediction], output: Output) -> None:
    from loopshape.toolbox.validation.predicted.nouns import indicator_texts

    for loop in dict.fromkeys(one.loop for one in made):
        mine = [one for one in made if one.loop == loop]
        rows = [
            [
                one.recording,
                point(one.sensitivity.operating_point, one.sensitivity.parameters),
                one.stability,
                *one.peaks_db,
                *(["-"] * len(STEP_COLUMNS) if one.step is None else indicator_texts(one.step.indicators)),
            ]
            for one in mine
        ]
        columns = ["recording", "operating point", "closed loop", "|S| [dB]", "|T| [dB]", *STEP_COLUMNS]
        output.table(f"Predicted for loop {loop}", columns, rows)
    output.warn(f"{one.loop} at {one.recording}: {note}" for one in made for note in one.notes)
    doubts = {note for one in made if one.step is not None for note in one.step.notes}
    if doubts:
        output.say(f"steps rest on fits, and {len(doubts)} of them are doubted (--json has the words)")


STEP_COLUMNS = ("t_r [s]", "t_s 2 % [s]", "t_s 5 % [s]", "overshoot [%]", "e_ss [%]")
