"""`loopshape figures`: all pictures that a run can give."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from loopshape.cli.output import AsJson, Output, Quiet, RunFolder
from loopshape.cli.pictures import figures_of

if TYPE_CHECKING:
    from loopshape.data.control.loop import Loop
    from loopshape.data.requirement.requirements import Requirements
    from loopshape.data.response.frf import FRF
    from loopshape.data.response.model import Fit
    from loopshape.data.result.verdict import Verdict
    from loopshape.io.write.check_files import MatrixCheck


def figures(
    run: RunFolder,
    out: Annotated[Path | None, typer.Option(help="Where to; default: figures in the run.")] = None,
    controller: Annotated[Path | None, typer.Option(help="A controller file: draws its loops too.")] = None,
    require: Annotated[Path | None, typer.Option(help="Requirements: draws their limits too.")] = None,
    as_json: AsJson = False,
    quiet: Quiet = False,
) -> None:
    """Draw the figures of a run. FRFs with their fits, parameter maps, and with a controller its loops."""
    from loopshape.cli.verify.verdicts import fits_of
    from loopshape.io.write.controllers import read_controllers
    from loopshape.io.write.frfs import read_frfs
    from loopshape.io.write.requirements import read_requirements
    from loopshape.loop.verdict import check_loops

    output = Output(as_json, quiet)
    folder = out or figures_of(run)
    frfs, fits = read_frfs(run), fits_of(run)
    drawn = draw_estimates(folder, frfs, fits, output)
    requirements = read_requirements(require) if require is not None else ()
    for own in read_controllers(controller) if controller is not None else ():
        mine = [one for one in frfs if one.loop == own.loop]
        if mine:
            required = _required_of(requirements, own.loop)
            verdict, loops = check_loops(mine, own, required, fits)
            drawn += draw_loops(folder, own.loop, loops, required, verdict)
    output.say("\n".join(drawn))
    output.json({"figures": drawn})


def _required_of(requirements: Sequence[Requirements], loop: str) -> Requirements:
    from loopshape.data.requirement.requirements import Requirements

    return next((w for w in requirements if w.loop == loop), Requirements(loop))


def draw_estimates(
    folder: Path, frfs: Sequence[FRF], fits: Sequence[Fit], output: Output, pages: set[str] | None = None
) -> list[str]:
    """Overview, pages (of the recordings named, or all) and parameter maps of each loop."""
    from loopshape.cli.pictures import save
    from loopshape.view.plots.fits import parameter_map
    from loopshape.view.plots.frequency import frf_overview, frf_page
    from loopshape.view.style import figure_of

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
    folder: Path, name: str, loops: Sequence[Loop], requirements: Requirements, verdict: Verdict | None
) -> list[str]:
    """Pictures of one loop at all operating points; with several a Bode page of the worst one too."""
    from loopshape.cli.pictures import save
    from loopshape.loop.points import worst_of
    from loopshape.view.plots.bode import bode_page
    from loopshape.view.plots.loops import loop_page, sensitivities
    from loopshape.view.plots.nichols import nichols
    from loopshape.view.style import figure_of
    from loopshape.view.verdict.atlas import sensitivity_atlas
    from loopshape.view.verdict.verdicts import margins_map

    page = bode_page(loops[0], requirements, verdict=verdict) if len(loops) == 1 else None
    made = {
        f"nichols_{name}": figure_of(nichols(loops, requirements, verdict=verdict)),
        f"loop_{name}": page or loop_page(loops, requirements, verdict=verdict),
        f"sensitivities_{name}": sensitivities(loops, requirements, verdict=verdict),
        f"atlas_{name}": sensitivity_atlas(loops, requirements, verdict=verdict),
    }
    if len(loops) > 1:
        worst = loops[worst_of(loops, verdict).index]
        made[f"bode_{name}_{worst.plant.recording}"] = bode_page(worst, requirements, verdict=verdict)
    if verdict is not None and verdict.lines:
        made[f"margins_{name}"] = margins_map(verdict)
    return [str(save(figure, folder / f"{stem}.png")) for stem, figure in made.items()]


def draw_several(folder: Path, found: MatrixCheck) -> list[str]:
    """A page of all loops at once for each operating point."""
    from loopshape.cli.pictures import save
    from loopshape.view.verdict.several import several_page

    drawn, verdict = [], found.verdict
    for k, (recording, matrix) in enumerate(found.matrices.items()):
        each = {one.loop: one.margins[recording] for one in verdict.each}
        page = several_page(matrix, verdict.together[recording], each, found.several)
        tail = f"_{k + 1:02d}" if len(found.matrices) > 1 else ""
        drawn.append(str(save(page, folder / f"several_{'+'.join(matrix.names)}{tail}.png")))
    return drawn
