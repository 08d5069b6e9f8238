"""`loopshape learning`: what each trial of a repeated move learns from the last one's error, and if that converges."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from loopshape.cli.output import AsJson, Output, Quiet, RunFolder
from loopshape.toolbox.learning.commands.feedforward import plant_of
from loopshape.verbs.pictures import figures_of


def learning(
    run: RunFolder,
    controller: Annotated[Path, typer.Argument(help="A controller file (TOML).", show_default=False)],
    out: Annotated[Path, typer.Option(help="The file of the learning filters to write (JSON).")],
    band_hz: Annotated[tuple[float, float], typer.Option(help="Lowest and highest frequency that is learned.")],
    recording: Annotated[str | None, typer.Option(help="Of several FRFs that of this recording.")] = None,
    taps: Annotated[int | None, typer.Option(min=1, help="How many; default: half a period of the band's end.")] = None,
    preview: Annotated[int | None, typer.Option(min=0, help="Samples ahead; default: 60 % of the taps.")] = None,
    integrators: Annotated[int | None, typer.Option(min=0, help="The plant's; default: by its lowest lines.")] = None,
    figures: Annotated[bool, typer.Option(help="Draw what is left from trial to trial.")] = True,
    as_json: AsJson = False,
    quiet: Quiet = False,
) -> None:
    """Design the filters of iterative learning control.

    From a measured plant, with their convergence condition at each frequency.

    Exit code 1 where trials do not converge, or the FRF's error leaves it undecided.
    """
    from loopshape.core.outcomes import Outcome
    from loopshape.io.write.check_files import controller_of
    from loopshape.io.write.controllers import read_controllers
    from loopshape.toolbox.learning.files import write_learning
    from loopshape.toolbox.learning.learning import learning as learn
    from loopshape.toolbox.learning.picture import learning_factor
    from loopshape.verbs.pictures import save
    from loopshape.view.style import figure_of

    output = Output(as_json, quiet)
    plant = plant_of(run, recording)
    own = controller_of(read_controllers(controller), plant.loop)
    made = learn(plant, own, band_hz=band_hz, taps=taps, preview=preview, integrators=integrators)
    write_learning(out, made)
    k = int(made.factor_high.argmax())
    rows = [[plant.loop, made.converges, made.factor[k], made.factor_high[k], made.frequency_hz[k]]]
    output.table("Learning", ["loop", "converges", "most that is left", "95 % below", "at [Hz]"], rows)
    picture = figures_of(run) / f"learning_{plant.loop or 'loop'}.png"
    drawn = [str(save(figure_of(learning_factor(made)), picture))] if figures else []
    output.say("\n".join([f"filters written to {out}", *drawn]))
    output.json({"learning": str(out), **made.to_dict(), "figures": drawn})
    if made.converges is not Outcome.PASSED:
        raise typer.Exit(1)
