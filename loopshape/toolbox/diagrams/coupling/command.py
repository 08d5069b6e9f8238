"""`loopshape interaction`: coupling between the loops of a run, by band."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

import loopshape as ls
from loopshape.cli.output import AsJson, Output, Quiet, RunFolder
from loopshape.verbs.pictures import figures_of, save

if TYPE_CHECKING:
    from loopshape.toolbox.diagrams.coupling.nouns import BandVerdict, Interaction

_COLUMNS = ["recordings", "loops", "from [Hz]", "to [Hz]", "lines", "k_I [dB]", "95 % from", "to", "at [Hz]", "verdict"]


def interaction(
    run: RunFolder,
    loops: Annotated[str | None, typer.Option(help="Loops, as x,y; default: all of the matrix.")] = None,
    outputs: Annotated[
        str | None, typer.Option(help="Their outputs in order, where names do not identify them.")
    ] = None,
    limit_db: Annotated[float, typer.Option(help="Limit of decoupling; default -20 dB (van den Brink 2007).")] = -20.0,
    bands: Annotated[str | None, typer.Option(help="Bands in Hz, as 0.5-1,1-4; default: octaves.")] = None,
    controller: Annotated[Path | None, typer.Option(help="Controllers that close the others; default: run's.")] = None,
    require_decoupled: Annotated[bool, typer.Option(help="Exit code 1 unless every band is decoupled.")] = False,
    figures: Annotated[bool, typer.Option(help="Draw the matrix and its interaction.")] = True,
    as_json: AsJson = False,
    quiet: Quiet = False,
) -> None:
    """Assess the coupling between loops, with bounds.

    From the matrix FRFs of a run; needs `frf RUN --matrix` before.
    """
    output = Output(as_json, quiet)
    found = _of_run(run, _names(loops), controller, outputs=_names(outputs), limit_db=limit_db, bands=_bands(bands))
    drawn = _draw(figures_of(run), found, output) if figures else []
    _report(run, found, drawn, output)
    if require_decoupled and not all(one.decoupled for one in found):
        raise typer.Exit(1)


def _of_run(run: Path, loops: Sequence[str] | None, controllers: Path | None, **options: Any) -> list[Interaction]:
    """That of each matrix of a run, the others closed by a file's controllers, else by those recorded under."""
    from loopshape.io.run.run_folder import recorded_under
    from loopshape.io.write.controllers import read_controllers
    from loopshape.io.write.frfs import read_all_loops

    closing = recorded_under(run) if controllers is None else read_controllers(controllers)
    found = []
    for one in read_all_loops(run):
        mine = {c.loop: c for c in closing if c.loop in (loops or one.loop.split("+"))}
        found.append(ls.interaction(one, loops, mine, **options))
    return found


def _draw(folder: Path, found: Sequence[Interaction], output: Output) -> list[str]:
    """The page of each interaction, and of its matrix, named by recordings and loops."""
    from loopshape.view.plots.matrix import matrix_page

    drawn = []
    with output.progress("draw", len(found)) as step:
        for k, one in enumerate(found):
            name = f"{one.frf.recording or 'all'}.{'+'.join(one.loops)}"
            name = name if len(name) < 120 else f"{k + 1}"
            drawn.append(str(save(matrix_page(one.frf), folder / f"matrix_{name}.png")))
            drawn.append(str(save(one.figure(), folder / f"interaction_{name}.png")))
            step(one.frf.recording)
    return drawn


def _names(text: str | None) -> tuple[str, ...] | None:
    return tuple(name.strip() for name in text.split(",")) if text else None


def _bands(text: str | None) -> tuple[tuple[float, float], ...] | None:
    """Bands of a text such as 0.5-1,1-4; refuses what are no two numbers."""
    made = []
    for part in text.split(",") if text else ():
        low, _, high = part.partition("-")
        try:
            made.append((float(low), float(high)))
        except ValueError:
            raise ls.LoopshapeError("a band is two frequencies in Hz", repr(part), "write bands as 0.5-1,1-4") from None
    return tuple(made) or None


def _report(run: Path, found: Sequence[Interaction], drawn: Sequence[str], output: Output) -> None:
    """Tables, sentences and JSON."""
    output.table("Interaction", _COLUMNS, [_row(one, v) for one in found for v in one.verdicts])
    for one in found:
        for sentence in one.sentences:
            output.say(sentence)
        if not one.equivalents:
            output.say("no controllers of the other loops: the plants that loops meet were not computed")
    output.warn([f"{one.frf.recording}: {note}" for one in found for note in one.frf.notes])
    if drawn:
        output.say(f"{len(drawn)} figures in {run / 'figures'}")
    decoupled = all(one.decoupled for one in found)
    output.json({"run": str(run), "decoupled": decoupled, "interactions": found, "figures": drawn})


def _row(one: Interaction, v: BandVerdict) -> list[Any]:
    pair = f"{v.loops[0]}, {v.loops[1]}"
    return [one.frf.recording, pair, *v.band_hz, v.lines, v.estimate_db, v.low_db, v.high_db, v.at_hz, v.verdict]
