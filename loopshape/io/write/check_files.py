"""A run, a controller's file and a requirements' file -> what a check says of each loop: the command's and pytest's."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from loopshape.core.errors import WrongUseError
from loopshape.core.toolboxes import needed
from loopshape.data.control.controller import Controller
from loopshape.data.requirement.profile import Profile
from loopshape.data.requirement.requirements import Requirements
from loopshape.data.result.baseline import Baseline
from loopshape.data.result.equivalent import Diagram, Equivalent
from loopshape.data.result.verdict import Verdict
from loopshape.identify.disturbance import disturbances_in
from loopshape.io.requirements import read_required
from loopshape.io.run.run_folder import read_run, recorded_under
from loopshape.io.write.controllers import read_controllers
from loopshape.io.write.fits import fits_of
from loopshape.io.write.frfs import read_all_loops, read_frfs
from loopshape.loop.loops import closed_loops
from loopshape.loop.verdict import LoopCheck, check_loops


@dataclass(frozen=True, eq=False)
class Checks:
    """What was checked: each loop by itself, or several at once; verdicts on what a diagram closes come first."""

    loops: tuple[LoopCheck, ...]
    inner: tuple[Verdict, ...] = ()
    diagram: Diagram | None = None

    @property
    def kept(self) -> tuple[Verdict, ...]:
        """The verdicts on the controllers that were checked."""
        return tuple(one.verdict for one in self.loops)

    @property
    def verdicts(self) -> tuple[Verdict, ...]:
        """The verdict on each loop, and then on all together."""
        return (*self.inner, *(part for one in self.kept for part in one.parts))


def read_diagram(path: Path, run: Path) -> Diagram:
    """The block diagram of a file, with a run's FRFs in the place of its plants; refuses where no toolbox reads one."""
    made: Diagram = needed("formats", "loopshape-diagram/1", "reads a block diagram", str(path))(path, run)
    return made


def check_all(
    run: Path,
    controller: Path,
    require: Path | None,
    profile: Profile | None = None,
    *,
    matrix: bool = False,
    closed: Sequence[str] | None = None,
    disturbance: Path | None = None,
    diagram: Path | None = None,
) -> Checks:
    """Check each loop of a requirements file on a run's FRFs; without one, each loop that has a controller and an FRF.

    Several loops are checked at once, on the run's matrices, where `matrix` or the table [several] of the requirements
    asks for it; `closed` are then those that are closed, all by default. With a `profile` its limits hold too.
    `disturbance` is the folder of a run that shows what disturbs the loops; a `diagram` is checked at its tuned
    block.

    Refuses files that cannot be read, a loop without a controller, one without FRFs, and for several loops a run that
    has FRFs of single loops only.
    """
    requirements, together = (None, None) if require is None else read_required(require)
    controllers = read_controllers(controller)
    if not matrix and together is None:
        drawn = None if diagram is None else read_diagram(diagram, run)
        equivalent = None if drawn is None else drawn.equivalent()
        loops = _single_loops(run, controllers, requirements, profile, disturbance, equivalent)
        return Checks(loops, () if equivalent is None else tuple(equivalent.inner.values()), drawn)
    if diagram is not None:
        raise WrongUseError(
            "a diagram closes its other loops itself, and is checked at its one open block", "several loops at once",
            "leave --matrix out",
        )  # fmt: skip
    asked = requirements or ()
    frfs, under = read_all_loops(run), recorded_under(run)
    chosen = closed_loops(frfs, controllers, closed)
    known = () if disturbance is None else disturbances_in(read_run(disturbance), *chosen.names)
    if profile is not None:
        given = {one.loop: one for one in asked}
        asked = tuple(profile.joined(given.get(name, Requirements(name))) for name in chosen.names)
    checked = check_loops(
        frfs, controllers, asked, together=together, closed=chosen.names, recorded_under=under, disturbances=known
    )
    return Checks((checked,))


def _single_loops(
    run: Path,
    controllers: Sequence[Controller],
    requirements: tuple[Requirements, ...] | None,
    profile: Profile | None,
    disturbance: Path | None,
    equivalent: Equivalent | None = None,
) -> tuple[LoopCheck, ...]:
    frfs, fits = (read_frfs(run), fits_of(run)) if equivalent is None else (equivalent.plants, ())
    measured = {one.loop for one in frfs}
    if requirements is None:
        requirements = tuple(Requirements(c.loop) for c in controllers if c.loop in measured)
    if not requirements:
        raise WrongUseError(
            "no loop has both a controller and an FRF",
            f"controllers of {', '.join(c.loop for c in controllers)}; FRFs of {', '.join(sorted(measured))}",
            "give a controller file of this run's loops",
        )
    asked = requirements if profile is None else tuple(map(profile.joined, requirements))
    asked = asked if equivalent is None else tuple(map(equivalent.asked, asked))
    still = None if disturbance is None else read_run(disturbance)
    checked = []
    for required in asked:
        mine = tuple(one for one in frfs if one.loop == required.loop)
        own = controller_of(controllers, required.loop)
        known = () if still is None else disturbances_in(still, required.loop)
        checked.append(check_loops(mine, own, required, fits, disturbances=known))
    return tuple(checked)


def against(baseline: Path, loops: Sequence[LoopCheck]) -> Baseline:
    """Compare with a stored verdict; refuses where no toolbox compares."""
    made: Baseline = needed("comparisons", "verdict", "compares with a baseline", str(baseline))(baseline, loops)
    return made


def controller_of(controllers: Sequence[Controller], loop: str) -> Controller:
    """The controller of a loop; refuses a file without it."""
    for one in controllers:
        if one.loop == loop:
            return one
    raise WrongUseError(f"the controller file has no loop {loop!r}", f"loops {', '.join(c.loop for c in controllers)}")
