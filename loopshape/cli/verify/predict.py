"""`loopshape predict`: what a controller will make of the plants that were measured, before it runs."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from loopshape.cli.output import AsJson, Output, Quiet, RunFolder, point

if TYPE_CHECKING:
    from loopshape.data.result.prediction import Indicators, Prediction


def predict(
    run: RunFolder,
    controller: Annotated[Path, typer.Argument(help="A controller file (TOML).", show_default=False)],
    out: Annotated[Path, typer.Option(help="The prediction file to write (.npz).")],
    seed: Annotated[int, typer.Option(min=0, help="Seed of the draws behind the steps' intervals.")] = 0,
    figures: Annotated[bool, typer.Option(help="Draw |S|, |T| and the step of each operating point.")] = True,
    as_json: AsJson = False,
    quiet: Quiet = False,
) -> None:
    """Predict S, T and the step of each loop.

    Under a controller; `loopshape compare` compares a later run with it.
    """
    from loopshape.cli.verify.verdicts import fits_of
    from loopshape.core.errors import WrongUseError
    from loopshape.io.write.controllers import read_controllers
    from loopshape.io.write.frfs import read_frfs
    from loopshape.io.write.predictions import write_predictions
    from loopshape.verbs.chain import predict as predict_loop

    output = Output(as_json, quiet)
    frfs, fits, controllers = read_frfs(run), fits_of(run), read_controllers(controller)
    pairs = [(one, mine) for one in controllers if (mine := [frf for frf in frfs if frf.loop == one.loop])]
    if not pairs:
        raise WrongUseError(
            "the run has no FRF of a loop of these controllers",
            f"loops {', '.join(one.loop for one in controllers)} and FRFs of {', '.join({f.loop for f in frfs})}",
        )
    made: list[Prediction] = []
    with output.progress("predict", len(pairs)) as step:
        for own, mine in pairs:
            made += predict_loop(mine, own, fits=fits, seed=seed)
            step(own.loop)
    write_predictions(out, made)
    _report(made, output)
    drawn = _draw(made, out) if figures else []
    output.say("\n".join([f"prediction written to {out}", *drawn]))
    output.json({"prediction": str(out), "figures": drawn, "predictions": made})


def _report(made: Sequence[Prediction], output: Output) -> None:
    from loopshape.core.units import db

    for loop in dict.fromkeys(one.loop for one in made):
        mine = [one for one in made if one.loop == loop]
        rows = [
            [
                one.recording,
                point(one.sensitivity.operating_point, one.sensitivity.parameters),
                one.stability,
                float(db(one.sensitivity.response).max()),
                float(db(one.complementary.response).max()),
                *_cells(None if one.step is None else one.step.indicators),
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


def _cells(read: Indicators | None) -> list[str]:
    """Indicators with their 95 % intervals as people read them."""
    from loopshape.data.result.prediction import INDICATORS

    if read is None:
        return ["-"] * len(INDICATORS)
    return [indicator_text(read, name) for name in INDICATORS]


def indicator_text(read: Indicators, name: str) -> str:
    """One indicator with its interval, shares as percent."""
    from loopshape.data.result.prediction import INDICATORS

    scale = 100.0 if INDICATORS[name] == "1" else 1.0
    value, interval = scale * getattr(read, name), read.intervals.get(name)
    text = f"{value:.3g}" if abs(value) >= 5e-4 else "0"
    if interval is None or scale * (interval[1] - interval[0]) < 5e-4:
        return text
    return f"{text} ({scale * interval[0]:.3g} .. {scale * interval[1]:.3g})"


def _draw(made: Sequence[Prediction], out: Path) -> list[str]:
    from loopshape.cli.pictures import save
    from loopshape.view.verdict.prediction import prediction_page

    drawn = []
    for loop in dict.fromkeys(one.loop for one in made):
        figure = prediction_page([one for one in made if one.loop == loop])
        drawn.append(str(save(figure, out.with_name(f"{out.stem}_{loop}.png"))))
    return drawn
