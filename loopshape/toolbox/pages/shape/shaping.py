"""A run's FRFs, controllers and requirements -> the page on which its loops are shaped by hand."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from loopshape import __version__
from loopshape.core.errors import WrongUseError
from loopshape.data.control.block import Block
from loopshape.data.control.controller import Controller
from loopshape.data.requirement.requirements import Requirements
from loopshape.data.response.frf import FRF
from loopshape.data.response.model import Fit
from loopshape.data.result.verdict import Verdict
from loopshape.data.signal.disturbance import Disturbance
from loopshape.loop.loop import Loop
from loopshape.loop.loops import closed_loops, equivalent_plants, loops_of, matrix_loops
from loopshape.loop.matrix import determinant
from loopshape.loop.stability.stability import unstable_count
from loopshape.loop.verdict import check
from loopshape.toolbox.pages.shape.payload import ClosedLoops, ShapingSession, shape_page

if TYPE_CHECKING:
    from loopshape.toolbox.pages.shape.widget import ShapeWidget


def shaped(
    frfs: Sequence[FRF], controller: Controller | None, requirements: Requirements | None, fits: Sequence[Fit],
    disturbances: Sequence[Disturbance] = (),
) -> ShapingSession:  # fmt: skip
    """A loop with what a check says of where its shaping starts: the controller, or a gain of 1."""
    if not frfs:
        raise WrongUseError("there is no FRF to shape a loop on", "none", "estimate one: loopshape frf RUN")
    start = controller or _gain_of_one(frfs[0])
    required = requirements or Requirements(start.loop)
    verdict = check(frfs, start, required, fits, disturbances=disturbances)
    return ShapingSession(tuple(frfs), start, required, tuple(fits), verdict, disturbances=tuple(disturbances))


def _gain_of_one(frf: FRF) -> Controller:
    if frf.rate_hz <= 0.0:
        raise WrongUseError(
            "a controller's rate is not known", "an FRF without a rate", "give a controller, or the FRF's rate_hz"
        )
    return Controller(frf.loop, (Block("gain", {"gain": 1.0}),), frf.rate_hz)


@dataclass(frozen=True, eq=False)
class ShapedLoops:
    """FRFs of a plant, and what is required of each loop and of all; `recorded_under` these controllers."""

    frfs: tuple[FRF, ...]
    requirements: tuple[Requirements, ...] = ()
    together: Requirements | None = None
    recorded_under: tuple[Controller, ...] = ()
    fits: tuple[Fit, ...] = ()
    disturbances: tuple[Disturbance, ...] = ()

    def sessions(self, controllers: Sequence[Controller]) -> list[ShapingSession]:
        """Each loop on the plant that it meets while the others are closed by these controllers."""
        if len(controllers) < 2:
            required = (*self.requirements, None)[0]
            if self.together is not None:
                required = (required or Requirements()).with_all(self.together)
            return [shaped(self.frfs, (*controllers, None)[0], required, self.fits, self.disturbances)]
        names = [one.loop for one in controllers]
        _refuse_disturbed(self.disturbances)
        closed = closed_loops(self.frfs, controllers, names, self.recorded_under)
        loops, _ = matrix_loops(closed, (self.together or Requirements()).of_all())
        return [self._one(own, controllers, loops) for own in controllers]

    def _one(self, own: Controller, controllers: Sequence[Controller], loops: Sequence[Loop]) -> ShapingSession:
        required = next((one for one in self.requirements if one.loop == own.loop), Requirements(own.loop))
        plants = equivalent_plants(own.loop, loops)
        rest = tuple(one for one in controllers if one is not own)
        others = ClosedLoops(rest, _unstable_poles_met(own.loop, loops, required))
        return ShapingSession(plants, own, required, (), check(plants, own, others.of_plant(required)), others)

    def check(self, controllers: Sequence[Controller], requirements: Sequence[Requirements]) -> Verdict:
        """What `check` says of these controllers under these requirements, all loops closed."""
        closed = [one.loop for one in controllers] if len(controllers) > 1 else None
        return check(
            self.frfs, controllers, requirements, self.fits, together=self.together, closed=closed,
            recorded_under=self.recorded_under, disturbances=self.disturbances,
        )  # fmt: skip


def _unstable_poles_met(name: str, loops: Sequence[Loop], required: Requirements) -> int | None:
    """Unstable poles of the plants that a loop meets with all others closed, None where they are not known.

    Those of all loops closed, by det(I + L), and as many more as L of this loop alone encircles -1. None too where
    operating points differ.
    """
    asked, counts = replace(required, integrators=None, unstable_poles=0), set()
    for plant, m in zip(equivalent_plants(name, loops), loops, strict=True):
        (own,) = (one for one in m.controllers if one.loop == name)
        (loop,), _ = loops_of([plant], own, asked, counted=False)
        together = determinant.closed_loops_stability(m).unstable_poles
        alone = None if loop.integrators is None else unstable_count(loop)
        if together is None or not isinstance(alone, int):
            return None
        counts.add(together - alone)
    found = counts.pop()
    return found if not counts and found >= 0 else None


def _refuse_disturbed(given: object) -> None:
    if given:
        what = "the page tells what becomes of a disturbance under one loop's controller"
        raise WrongUseError(what, "several loops and a disturbance", "take one loop alone, or check all of them")


def page_of(loops: Sequence[ShapingSession], title: str, saved: str | None = None) -> bytes:
    """The page as bytes; with `saved`, the mark of what its Save may replace, it has the buttons that ask a server."""
    return shape_page(loops, title, __version__, saved=saved).encode("utf-8")


def notebook_widget(loops: ShapedLoops, controllers: Sequence[Controller], title: str) -> ShapeWidget:
    """The page of loops for a notebook's cell."""
    try:
        from loopshape.toolbox.pages.shape.widget import ShapeWidget
    except ModuleNotFoundError as error:
        raise WrongUseError(
            "a widget needs the package anywidget", "it is not installed", "pip install 'loopshape[notebook]'"
        ) from error
    return ShapeWidget(loops.sessions(controllers), title, __version__, loops.check)


def write_page(path: Path, loops: Sequence[ShapingSession], title: str) -> int:
    """Write the page; gives its size in bytes."""
    from loopshape.io.files import write_bytes_whole

    data = page_of(loops, title)
    write_bytes_whole(path, data)
    return len(data)


def matrix_run(
    run: Path, require: Path | None, controller: Path | None, disturbance: Path | None = None
) -> tuple[ShapedLoops, list[ShapingSession]]:
    """Loops of a controller file, one at a time with the others closed, on a run's matrices."""
    from loopshape.io.requirements import read_required
    from loopshape.io.write.check_files import recorded_under
    from loopshape.io.write.controllers import read_controllers
    from loopshape.io.write.frfs import read_all_loops

    _refuse_disturbed(disturbance)
    if controller is None:
        what = "loops are closed by their controllers"
        raise WrongUseError(what, "--matrix alone", "give them by --controller FILE")
    required, together = read_required(require) if require else ((), None)
    made = ShapedLoops(read_all_loops(run), required, together, recorded_under(run))
    return made, made.sessions(read_controllers(controller))


def shape_run(
    run: Path, require: Path | None, controller: Path | None, disturbance: Path | None = None
) -> list[ShapingSession]:
    """Loops of a requirements file, else those of a controller file, else all that have an FRF."""
    from loopshape.identify.disturbance import disturbances_in
    from loopshape.io.requirements import read_requirements
    from loopshape.io.run.run_folder import read_run
    from loopshape.io.write.controllers import read_controllers
    from loopshape.io.write.fits import fits_of
    from loopshape.io.write.frfs import read_frfs

    frfs, fits = read_frfs(run), fits_of(run)
    required = {} if require is None else {one.loop: one for one in read_requirements(require)}
    controllers = {} if controller is None else {one.loop: one for one in read_controllers(controller)}
    measured = list(dict.fromkeys(frf.loop for frf in frfs))
    asked = list(required or controllers) or measured
    names = [name for name in asked if name in measured]
    if not names:
        raise WrongUseError(
            "no loop has an FRF",
            f"loops {', '.join(asked)}; FRFs of {', '.join(measured) or 'none'}",
            "give files of this run's loops",
        )
    mine = {name: [frf for frf in frfs if frf.loop == name] for name in names}
    known = {name: disturbances_in(read_run(disturbance), name) if disturbance else () for name in names}
    return [shaped(mine[name], controllers.get(name), required.get(name), fits, known[name]) for name in names]
