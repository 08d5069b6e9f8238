"""Pictures of a run to files: of its FRFs with their fits, of matrices and loops."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from loopshape.verbs.watch import Unwatched, Watch

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from loopshape.data.requirement.requirements import Requirements
    from loopshape.data.response.frf import FRF
    from loopshape.data.response.model import Fit
    from loopshape.data.result.verdict import Verdict
    from loopshape.io.write.check_files import Checks
    from loopshape.loop.loop import Loop


FIGURES = "figures"  # the folder of a run's pictures


def figures_of(run: Path) -> Path:
    """The folder of a run's figures; refuses a link that leads out of the run."""
    from loopshape.io.files import inside

    return inside(run, FIGURES, "the folder of a run's figures")


def save(figure: Figure, path: Path) -> Path:
    """Write a figure as PNG, whole or not at all; gives the path."""
    from loopshape.io.files import write_bytes_whole
    from loopshape.view.style import png

    write_bytes_whole(path, png(figure))
    return path


def _saved(folder: Path, figures: Iterable[tuple[str, Figure]]) -> list[str]:
    """Write figures by their names, each as soon as it is drawn."""
    return [str(save(figure, folder / f"{name}.png")) for name, figure in figures]


def _tails(count: int) -> list[str]:
    """Endings of names that tell several apart."""
    return [f"_{k + 1:02d}" if count > 1 else "" for k in range(count)]


def draw_run(
    run: Path,
    folder: Path | None = None,
    *,
    controllers: Path | None = None,
    requirements: Path | None = None,
    watch: Watch | None = None,
) -> list[str]:
    """The figures of a run: FRFs with fits, parameter maps, and the loops of a controller file under requirements."""
    from loopshape.data.requirement.requirements import Requirements
    from loopshape.io.requirements import read_requirements
    from loopshape.io.write.controllers import read_controllers
    from loopshape.io.write.fits import fits_of
    from loopshape.io.write.frfs import read_frfs
    from loopshape.loop.verdict import check_loops

    folder = folder or figures_of(run)
    frfs, fits = read_frfs(run), fits_of(run)
    drawn = draw_frfs(folder, frfs, fits, watch)
    required = {} if requirements is None else {one.loop: one for one in read_requirements(requirements)}
    for own in () if controllers is None else read_controllers(controllers):
        if mine := [one for one in frfs if one.loop == own.loop]:
            asked = required.get(own.loop, Requirements(own.loop))
            found = check_loops(mine, own, asked, fits)
            drawn += draw_loops(folder, own.loop, found.loops, asked, found.verdict)
    return drawn


def draw_frfs(
    folder: Path,
    frfs: Sequence[FRF],
    fits: Sequence[Fit] = (),
    watch: Watch | None = None,
    pages: set[str] | None = None,
) -> list[str]:
    """Overview, pages (of the recordings named, or all) and parameter maps of each loop."""
    from loopshape.view.plots.fits import parameter_map
    from loopshape.view.plots.frequency import frf_overview, frf_page
    from loopshape.view.style import figure_of

    drawn = []
    with (watch or Unwatched()).progress("draw", len(frfs)) as step:
        for loop in dict.fromkeys(one.loop for one in frfs):
            mine = [one for one in frfs if one.loop == loop]
            own = [f for one in mine for f in fits if (f.loop, f.recording) == (loop, one.recording)]
            overlaid = own if len(own) == len(mine) else None
            drawn += _saved(folder, [(f"frf_{loop}", frf_overview(mine, overlaid))])
            for one in (one for one in mine if pages is None or one.recording in pages):
                fit = next((f for f in own if f.recording == one.recording), None)
                drawn += _saved(folder, [(f"frf_{loop}_{one.recording}", frf_page(one, fit))])
                step(one.recording)
            if len(own) > 1 and len({f.structure for f in own}) == 1:
                names = (p.name for p in own[0].parameters)
                drawn += _saved(folder, ((f"fit_{loop}_{x}", figure_of(parameter_map(own, x))) for x in names))
    return drawn


def draw_matrices(folder: Path, frfs: Sequence[FRF]) -> list[str]:
    """A page for each matrix."""
    from loopshape.view.plots.matrix import matrix_page

    named = zip(frfs, _tails(len(frfs)), strict=True)
    return _saved(folder, ((f"matrix_{one.loop}{tail}", matrix_page(one)) for one, tail in named))


def draw_checks(folder: Path, found: Checks) -> list[str]:
    """Pictures of what was checked: of each loop, of a diagram, of all loops at once."""
    from loopshape.data.requirement.requirements import Requirements

    drawn = [] if found.diagram is None else _saved(folder, [("diagram", found.diagram.figure())])
    for one in found.loops:
        if one.verdict.each:
            drawn += draw_together(folder, one.loops, one.verdict, one.together)
        else:
            name, required = one.verdict.controllers[0].loop, one.required or Requirements(one.verdict.loop)
            drawn += draw_loops(folder, name, one.loops, required, one.verdict)
    return drawn


def draw_loops(
    folder: Path, name: str, loops: Sequence[Loop], requirements: Requirements, verdict: Verdict | None
) -> list[str]:
    """Pictures of one loop at all operating points; with several a Bode page of the worst one too."""
    from loopshape.core.toolboxes import found, function_at
    from loopshape.loop.points import worst_of
    from loopshape.view.plots.bode import bode_page
    from loopshape.view.plots.loops import loop_page, sensitivities
    from loopshape.view.plots.nichols import nichols
    from loopshape.view.style import figure_of
    from loopshape.view.verdict.verdicts import margins_map

    page = bode_page(loops[0], requirements, verdict=verdict) if len(loops) == 1 else None
    made = {
        f"nichols_{name}": figure_of(nichols(loops, requirements, verdict=verdict)),
        f"loop_{name}": page or loop_page(loops, requirements, verdict=verdict),
        f"sensitivities_{name}": sensitivities(loops, requirements, verdict=verdict),
    }
    if len(loops) > 1:
        drawn = {key: function_at(place) for key, place in found().all("pictures").items()}
        made |= {f"{key}_{name}": draw(loops, requirements, verdict=verdict) for key, draw in drawn.items()}
        worst = loops[worst_of(loops, verdict).index]
        made[f"bode_{name}_{worst.plant.recording}"] = bode_page(worst, requirements, verdict=verdict)
    if verdict is not None and verdict.lines and len(loops) > 1:  # of one point the table says it all
        made[f"margins_{name}"] = margins_map(verdict)
    return _saved(folder, made.items())


def draw_together(
    folder: Path, loops: Sequence[Loop], verdict: Verdict, required: Requirements | None = None
) -> list[str]:
    """A page of all loops at once for each operating point."""
    from loopshape.view.verdict.together import together_page

    drawn = []
    for loop, tail in zip(loops, _tails(len(loops)), strict=True):
        recording = loop.plant.recording
        each = {one.loop: one.margins[recording] for one in verdict.each}
        page = together_page(loop, verdict.together[recording], each, required)
        drawn += _saved(folder, [(f"loop_{'+'.join(loop.names)}{tail}", page)])
    return drawn
