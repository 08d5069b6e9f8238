"""`loopshape figures`: all pictures that a run can give."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from loopshape.cli.output import AsJson, Output, Quiet, RunFolder

if TYPE_CHECKING:
    from loopshape.controller import Controller
    from loopshape.frf import FRF
    from loopshape.model import Fit
    from loopshape.requirements import Requirements, Verdict


def figures(
    run: RunFolder,
    out: Annotated[Path | None, typer.Option(help="Where to; default: figures in the run.")] = None,
    controller: Annotated[Path | None, typer.Option(help="A controller file: draws its loops too.")] = None,
    require: Annotated[Path | None, typer.Option(help="Requirements: draws their limits too.")] = None,
    as_json: AsJson = False,
    quiet: Quiet = False,
) -> None:
    """Draw FRFs with their fits, parameter maps, and with a controller its loops."""
    from loopshape.cli.verdicts import fits_of
    from loopshape.store.controllers import read_controllers
    from loopshape.store.frfs import read_frfs
    from loopshape.store.requirements import read_requirements

    output = Output(as_json, quiet)
    folder = out or run / "figures"
    frfs, fits = read_frfs(run), fits_of(run)
    drawn = draw_estimates(folder, frfs, fits, output)
    wishes = read_requirements(require) if require is not None else ()
    for own in read_controllers(controller) if controller is not None else ():
        mine = [one for one in frfs if one.loop == own.loop]
        if mine:
            drawn += draw_loops(folder, mine, own, _wish(wishes, own.loop), fits, None)
    output.say("\n".join(drawn))
    output.json({"figures": drawn})


def _wish(wishes: Sequence[Requirements], loop: str) -> Requirements:
    from loopshape.requirements import Requirements

    return next((w for w in wishes if w.loop == loop), Requirements(loop))


def controller_of(controllers: Sequence[Controller], loop: str) -> Controller:
    """The controller of a loop; refuses a file without it."""
    from loopshape.errors import WrongUseError

    for one in controllers:
        if one.loop == loop:
            return one
    raise WrongUseError(f"the controller file has no loop {loop!r}", f"loops {', '.join(c.loop for c in controllers)}")


def draw_estimates(
    folder: Path, frfs: Sequence[FRF], fits: Sequence[Fit], output: Output, pages: set[str] | None = None
) -> list[str]:
    """Overview, pages (of the recordings named, or all) and parameter maps of each loop."""
    from loopshape.cli.pictures import save
    from loopshape.draw.fits import parameter_map
    from loopshape.draw.frequency import frf_overview, frf_page
    from loopshape.draw.style import figure_of

    drawn = []
    with output.progress("draw", len(frfs)) as step:
        for loop in dict.fromkeys(one.loop for one in frfs):
            mine = [one for one in frfs if one.loop == loop]
            own = [f for one in mine for f in fits if (f.loop, f.recording) == (loop, one.recording)]
            overlaid = own if len(own) == len(mine) else None
            drawn.append(save(frf_overview(mine, overlaid), folder / f"frf_{loop}.png"))
            for one in (one for one in mine if pages is None or one.recording in pages):
                fit = next((f for f in own if f.recording == one.recording), None)
                drawn.append(save(frf_page(one, fit), folder / f"frf_{loop}_{one.recording}.png"))
                step(one.recording)
            if len(own) > 1 and len({f.structure for f in own}) == 1:
                for name in (p.name for p in own[0].parameters):
                    drawn.append(save(figure_of(parameter_map(own, name)), folder / f"fit_{loop}_{name}.png"))
    return [str(path) for path in drawn]


def draw_loops(
    folder: Path,
    frfs: Sequence[FRF],
    controller: Controller,
    requirements: Requirements,
    fits: Sequence[Fit],
    verdict: Verdict | None,
) -> list[str]:
    """Nichols, loop and sensitivity pictures of one loop at all operating points."""
    from loopshape.check.verdict import loops_of
    from loopshape.cli.pictures import save
    from loopshape.draw.loops import loop_page, nichols, sensitivities
    from loopshape.draw.style import figure_of
    from loopshape.draw.verdicts import margins_map

    loops, _ = loops_of(frfs, controller, requirements, fits)
    made = {
        "nichols": figure_of(nichols(loops, requirements)),
        "loop": loop_page(loops, requirements, verdict=verdict),
        "sensitivities": sensitivities(loops, requirements),
    }
    if verdict is not None and verdict.lines:
        made["margins"] = margins_map(verdict)
    return [str(save(figure, folder / f"{name}_{controller.loop}.png")) for name, figure in made.items()]
