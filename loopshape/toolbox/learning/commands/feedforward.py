"""`loopshape feedforward`: the inverse of a measured plant over a band, as taps on a setpoint known ahead."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from loopshape.cli.output import AsJson, Output, Quiet, RunFolder
from loopshape.verbs.pictures import figures_of

if TYPE_CHECKING:
    from loopshape.data.control.controller import Controller
    from loopshape.data.response.frf import FRF
    from loopshape.toolbox.learning.taps import Feedforward
    from loopshape.toolbox.learning.tracking import TrackingError


def feedforward(
    run: RunFolder,
    out: Annotated[Path, typer.Option(help="The file of the taps to write (JSON).")],
    band_hz: Annotated[tuple[float, float] | None, typer.Option(help="Lowest and highest frequency.")] = None,
    recording: Annotated[str | None, typer.Option(help="Of several FRFs that of this recording.")] = None,
    taps: Annotated[int | None, typer.Option(min=1, help="How many; default: half a period of the band's end.")] = None,
    preview: Annotated[int | None, typer.Option(min=0, help="Samples ahead; default: 60 % of the taps.")] = None,
    integrators: Annotated[int | None, typer.Option(min=0, help="The plant's; default: by its lowest lines.")] = None,
    unstable_poles: Annotated[int | None, typer.Option(min=0, help="The plant's; default: none, for --move.")] = None,
    controller: Annotated[Path | None, typer.Option(help="A controller file: predict the error of --move.")] = None,
    move: Annotated[
        tuple[float, float, float, float] | None,
        typer.Option(help="Third-order setpoint: distance, velocity, acceleration, jerk."),
    ] = None,
    figures: Annotated[bool, typer.Option(help="Draw the inverse's error, the taps, the error of the move.")] = True,
    as_json: AsJson = False,
    quiet: Quiet = False,
) -> None:
    """Design feedforward: the inverse of a measured plant.

    Over a band; with --controller and --move predict the error with it and without.
    """
    from loopshape.core.errors import WrongUseError
    from loopshape.io.files import write_json
    from loopshape.io.write.check_files import controller_of
    from loopshape.io.write.controllers import read_controllers
    from loopshape.toolbox.learning.feedforward import feedforward as invert

    if (controller is None) != (move is None):
        raise WrongUseError("an error is predicted of a controller along a move", "one of them", "give both or none")
    output = Output(as_json, quiet)
    plant = plant_of(run, recording)
    made = invert(plant, band_hz=band_hz, taps=taps, preview=preview, integrators=integrators)
    write_json(out, made.to_dict())
    rows = [[made.loop, *made.band_hz, made.taps.size, made.preview, made.inverse_error.max(), made.inverse_high.max()]]
    columns = ["loop", "from [Hz]", "to [Hz]", "taps", "samples ahead", "largest |1 - P F|", "95 % below"]
    output.table("Feedforward", columns, rows)
    errors = {}
    if controller is not None and move is not None:
        own = controller_of(read_controllers(controller), plant.loop)
        errors = _errors(plant, made, own, move, {"integrators": integrators, "unstable_poles": unstable_poles})
        rows = [[name, e.rms, *e.rms_interval, e.largest, *e.largest_interval] for name, e in errors.items()]
        output.table("Predicted error", ["", "rms", "95 % from", "to", "largest", "95 % from", "to"], rows)
    drawn = [_draw(run, made, errors, plant)] if figures else []
    output.say("\n".join([f"taps written to {out}", *drawn]))
    answer = {name: {"rms": e.rms, "rms_interval": e.rms_interval, "largest": e.largest,
                   "largest_interval": e.largest_interval} for name, e in errors.items()}  # fmt: skip
    output.json({"feedforward": str(out), **made.to_dict(), "errors": answer, "figures": drawn})


def plant_of(run: Path, recording: str | None) -> FRF:
    """The one FRF of a run, or that of a recording; refuses several."""
    from loopshape.core.errors import WrongUseError
    from loopshape.io.write.frfs import read_frfs

    found = [frf for frf in read_frfs(run) if recording in (None, frf.recording)]
    if len(found) != 1:
        raise WrongUseError(
            "an inverse is made from one FRF", f"{len(found)} of {run}",
            f"name it with --recording: {', '.join(frf.recording for frf in read_frfs(run))}",
        )  # fmt: skip
    return found[0]


def _errors(
    plant: FRF,
    made: Feedforward,
    own: Controller,
    move: tuple[float, float, float, float],
    declared: dict[str, int | None],
) -> dict[str, TrackingError]:
    """Of the move, without feedforward and with it."""
    from loopshape.toolbox.learning.verbs import setpoint_of, tracking_error

    setpoint = setpoint_of(*move, rate_hz=own.rate_hz, rest_s=4.0 / plant.valid_band_hz[0])
    return {
        name: tracking_error(plant, own, setpoint, one, **declared)
        for name, one in (("without", None), ("with feedforward", made))
    }


def _draw(run: Path, made: Feedforward, errors: dict[str, Any], plant: FRF) -> str:
    from loopshape.toolbox.learning.picture import feedforward_page
    from loopshape.verbs.pictures import save

    return str(save(feedforward_page(made, errors, plant), figures_of(run) / f"feedforward_{made.loop or 'loop'}.png"))
