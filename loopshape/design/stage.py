"""Where a tuning stands, and what it is for: the problem, the best so far, and the verdict on it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from loopshape.data.control.controller import Controller
from loopshape.data.requirement.requirements import Requirements
from loopshape.data.response.frf import FRF
from loopshape.data.response.model import Fit
from loopshape.data.result.verdict import Verdict
from loopshape.data.signal.disturbance import Disturbance
from loopshape.design.problem.disturbed import opened
from loopshape.design.problem.problem import Problem, problem
from loopshape.design.problem.shifts import Copy, closer, shifted_loops, shifted_verdict
from loopshape.design.search import Goal, initial_point, search
from loopshape.design.tighten import TightenedSolution, Verifier, tighten_limits
from loopshape.loop.loop import Loop
from loopshape.loop.loops import points_of
from loopshape.loop.margin.disturbed import disturbance_warnings, made_of, of_points
from loopshape.loop.order import with_orders
from loopshape.loop.verdict import check, verdict_from, with_warnings

#: rounds of adding the worst shift between those that were tuned for, and steps of the search in each
SHIFTED, MORE = 8, 100


@dataclass(frozen=True, eq=False)
class Task:
    """What a tuning is for: FRFs with their fits, requirements, loops and what was assumed of them, and how it runs."""

    frfs: tuple[FRF, ...]
    fits: tuple[Fit, ...]
    requirements: Requirements
    loops: tuple[Loop, ...]
    notes: tuple[str, ...]
    unit: Controller
    precision: str
    disturbances: tuple[Disturbance, ...] = ()

    def problem(
        self, copies: Sequence[Copy], asked: Requirements
    ) -> tuple[Problem, Callable[[Requirements], Verifier]]:
        """The problem on copies of the plants, shifted as a detuning margin asks, and its controllers' judge."""
        shifted = shifted_loops(self.loops, copies)
        disturbed = of_points(shifted, self.disturbances)
        known = [opened(loop, disturbed.get(name), asked) for name, loop in shifted.items()] if disturbed else []
        p = problem(list(shifted.values()), asked, self.unit.rate_hz, self.precision, known)

        def check_of(limits: Requirements) -> Verifier:
            return lambda controller, points=None: shifted_verdict(shifted, controller, limits, points, disturbed)

        return p, check_of

    def check(self, p: Problem, best: TightenedSolution) -> Verdict:
        """What `check` says of it at the plants as they are; margins that its judge read there are not read again."""
        C = p.controller(best.result.x)
        if self.requirements.detuning_percent is not None:
            return check(self.frfs, C, self.requirements, self.fits, disturbances=self.disturbances)
        loops = [replace(loop, controllers=(C,)) for loop in self.loops]
        named = dict(zip(points_of(self.frfs), loops, strict=True))
        found = verdict_from(best.verdict.margins, named, self.requirements)
        made = made_of(named, found.margins, self.requirements, of_points(named, self.disturbances))
        notes = disturbance_warnings(named, made, self.requirements)
        found = with_warnings(found, loops, self.requirements, (*self.notes, *notes))
        return with_orders(found, loops, self.frfs, self.requirements)


@dataclass(frozen=True, eq=False)
class Stage:
    """Where a tuning stands: copies of the plants and limits tuned for, the problem, the best, its verdict, steps."""

    copies: tuple[Copy, ...]
    asked: Requirements
    p: Problem
    best: TightenedSolution
    verdict: Verdict
    steps: int
    added: str = ""

    @property
    def rank(self) -> tuple[bool, int, float, float]:
        """What makes one better than another, smallest first: passed, then the objective, or as settled.

        What the check passes needs no word of its shifted plants: they lie a little farther out than is required.
        """
        if self.verdict.passed:
            return False, 0, 0.0, -self.best.objective
        return True, *self.best.rank


@dataclass(frozen=True)
class Grown:
    """What a controller reaches with the block `added` ("" before the first): the worst over the operating points.

    `control_peak_db` is the peak of |CS|, `order` the controller's number of poles.
    """

    added: str
    bandwidth_hz: float
    control_peak_db: float
    detuning_percent: float
    order: int
    outcome: str


def lowest_bandwidth(stage: Stage) -> float:
    """Lowest first 0 dB crossing in Hz, the lesser of what the check and the tuner read.

    Where |L| runs along 1 the one may read a crossing far above the other's.
    """
    read = float(min(m.bandwidth_hz for m in stage.verdict.margins.values()))
    mine = float(np.exp(stage.best.result.measures.ln_bandwidth.min()))
    same = 0.05  # crossings that the tuner reads lower than the check by less than this are those of the check
    return mine if read > (1.0 + same) * mine else read


def step_of(stage: Stage) -> Grown:
    """A stage as a row of the table of a growth."""
    every = stage.verdict.margins.values()
    return Grown(
        added=stage.added,
        bandwidth_hz=lowest_bandwidth(stage),
        control_peak_db=max(m.control_peak_db for m in every),
        detuning_percent=min(m.detuning_percent for m in every),
        order=stage.p.controller(stage.best.result.x).order(),
        outcome=stage.verdict.outcome.value,
    )


def closed_in(task: Task, stage: Stage) -> Stage:
    """The stage after shifts between those tuned for were added, as long as its detuning margin does not pass."""
    for _ in range(SHIFTED):
        if not stage.best.verdict.passed or stage.verdict.passed or task.requirements.detuning_percent is None:
            break
        C = stage.p.controller(stage.best.result.x)
        copies, asked = closer(stage.copies, stage.asked, task.loops, C, task.requirements, stage.verdict)
        asked = replace(asked, structure=stage.asked.structure)
        p, check_of = task.problem(copies, asked)
        moved = search(p, initial_point(p, stage.best.result.x, Goal(), 0.1), Goal(), MORE)
        again = tighten_limits(p, moved, check_of(asked))
        steps = stage.steps + again.result.steps
        stage = Stage(copies, asked, p, again, task.check(p, again), steps, stage.added)
    return stage
