"""`loopshape schedule`: one robust controller against one for each operating point."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from loopshape.cli.design.tune import RequireFile
from loopshape.cli.output import AsJson, Output, Quiet, RunFolder, point
from loopshape.verbs.pictures import figures_of

if TYPE_CHECKING:
    from loopshape.toolbox.schedules.schedule import Schedule


def schedule(
    run: RunFolder,
    require: RequireFile,
    controller: Annotated[Path, typer.Option(help="The robust controller (TOML), as `tune` writes it.")],
    seed: Annotated[int, typer.Option(min=0, help="Seed of the random starts.")] = 0,
    starts: Annotated[int, typer.Option(min=1, help="Number of random starts searched to the end.")] = 16,
    figures: Annotated[bool, typer.Option(help="Draw the cost and the parameters over the operating points.")] = True,
    as_json: AsJson = False,
    quiet: Quiet = False,
) -> None:
    """The bandwidth that one robust controller costs. Each operating point is tuned alone for comparison."""
    schedule_run(run, require, controller, Output(as_json, quiet), seed=seed, starts=starts, figures=figures)


def schedule_run(
    run: Path, require: Path, controller: Path, output: Output, *, seed: int = 0, starts: int = 16, figures: bool = True
) -> list[Schedule]:
    """Compare each loop of a requirements file that names a structure, draw and report."""
    from loopshape.io.requirements import read_requirements
    from loopshape.io.write.check_files import controller_of
    from loopshape.io.write.controllers import read_controllers
    from loopshape.io.write.fits import fits_of
    from loopshape.io.write.frfs import read_frfs
    from loopshape.toolbox.schedules.schedule import schedule as schedule_loop

    controllers, frfs, fits = read_controllers(controller), read_frfs(run), fits_of(run)
    found, drawn = [], []
    for required in read_requirements(require):
        mine = [one for one in frfs if one.loop == required.loop]
        robust = controller_of(controllers, required.loop)
        with output.progress(f"tune {required.loop}", len(mine)) as step:
            found.append(schedule_loop(mine, required, robust, fits, seed=seed, starts=starts, step=step))
        _report(found[-1], output)
        drawn += _draw(figures_of(run), found[-1]) if figures else []
    output.say("\n".join(["figures:", *drawn]) if drawn else "no figures drawn")
    output.json({"loops": found, "figures": drawn})
    return found


def _draw(folder: Path, one: Schedule) -> list[str]:
    from loopshape.toolbox.schedules.picture import schedule_page
    from loopshape.verbs.pictures import save

    return [str(save(schedule_page(one), folder / f"schedule_{one.loop}.png"))]


def _report(one: Schedule, output: Output) -> None:
    rows = [
        [p.recording, point(p.operating_point), p.own_hz, p.robust_hz, p.cost_hz, p.ratio, p.bound_hz]
        for p in one.points
    ]
    columns = ["recording", "operating point", "own [Hz]", "robust [Hz]", "cost [Hz]", "ratio", "none exceeds [Hz]"]
    output.table(f"Loop {one.loop}: bandwidth with its own controller and with the robust one", columns, rows)
    output.say(
        f"lowest bandwidth: scheduled {one.own_hz:.3g} Hz, robust {one.robust_hz:.3g} Hz; robustness costs"
        f" {one.own_hz - one.robust_hz:.3g} Hz there, and"
        f" {sum(p.cost_hz for p in one.points) / len(one.points):.3g} Hz on the average"
    )
    missed = [p.recording for p in one.points if not p.feasible]
    if missed:
        output.warn([f"not surely within all requirements, even alone: {', '.join(missed)}"])
    kept = [p.recording for p in one.points if not p.tuned]
    if kept:
        output.say(f"the search alone found nothing better than the robust controller at {', '.join(kept)}")
