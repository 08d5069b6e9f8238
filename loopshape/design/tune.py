"""FRFs + Requirements -> Controller: the largest objective over all operating points, within all requirements."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from loopshape.core.errors import WrongUseError
from loopshape.core.units import Array, db
from loopshape.data.controller import Block, Controller
from loopshape.data.frf import FRF
from loopshape.data.loop import Loop
from loopshape.data.model import Fit
from loopshape.data.requirements import Requirements, Verdict
from loopshape.design.contained import raced, settled
from loopshape.design.problem import Problem, bounds_reached, problem
from loopshape.design.relax import Shortfall, shortfall
from loopshape.design.search import LARGEST, Found, begin, search
from loopshape.design.settle import Judge, Settled, settle
from loopshape.design.shifts import Copy, closer, copies_for, judged, shifted_loops
from loopshape.design.starts import random_starts
from loopshape.design.warm import warm_start
from loopshape.loop.verdict import check, loops_of

#: rounds of adding the worst shift between those that were tuned for, and steps of the search in each
SHIFTED, MORE = 8, 100


@dataclass(frozen=True)
class Binding:
    """What holds the tuning back: a requirement (or the objective itself) at an operating point and frequency."""

    quantity: str
    recording: str
    at_hz: float


@dataclass(frozen=True, eq=False)
class Tuning:
    """A tuned controller with its verdict, what binds, and how the search went.

    `outcome` is the verdict's: "passed", "undecided" where the requirements hold by the estimates but not by their
    95 % intervals, "failed". Where no start came to meet every requirement `feasible` is False, the controller is the
    one that misses least, and `shortfall` says what keeps it so and what to relax. `converged` is False where the
    search ran out of steps. `objective` is what was made large; `rejection_db` the mean of 1/|S| in dB on the
    objective's low lines at the worst operating point, None where it was not asked. `moved` says what a warm start
    had to leave.
    """

    controller: Controller
    verdict: Verdict
    bandwidth_hz: float
    binding: tuple[Binding, ...]
    feasible: bool
    starts: int
    steps: int
    converged: bool
    bounds_reached: tuple[str, ...]
    objective: float = float("nan")
    rejection_db: float | None = None
    shortfall: Shortfall | None = None
    moved: tuple[str, ...] = ()

    def __repr__(self) -> str:
        """One line: the controller, its lowest bandwidth and what the check says of it."""
        return f"Tuning: {self.outcome}, lowest bandwidth {self.bandwidth_hz:.4g} Hz, {self.controller!r}"

    @property
    def outcome(self) -> str:
        """ "passed", "undecided" or "failed", as `check` judges the controller."""
        return self.verdict.outcome


def tune(
    frfs: Sequence[FRF],
    requirements: Requirements,
    fits: Sequence[Fit] = (),
    *,
    start: Controller | None = None,
    seed: int = 0,
    starts: int = 16,
    draws: int = 60,
    explain: bool = True,
) -> Tuning:
    """Tune a structure to several measured plants at once; same input and seed, same controller.

    Maximises the requirements' objective (the lowest bandwidth, unless they say otherwise) over all FRFs subject to
    every requirement at every one, on the trusted lines. Of `draws` random starts within the bounds the best `starts`
    are followed a few steps, the best third of them further, and the best leaps from there. Structures that this one
    contains, where a lead_lag or a notch does nothing, are searched first, and their optima are starts too. What comes
    out is checked
    by `check` itself; limits are tightened by what its finer reading and its 95 % intervals ask for, and the search
    goes on. The requirements are then met as far as these data are sure.

    With `start` the search begins at that controller, run as it runs (prewarping, delay, hold, precision), and besides
    at starts - 1 others: `starts=1` is a local improvement alone. A `start` that meets the requirements is never made
    worse. Where the requirements cannot be met `explain` finds out what to relax, which takes longer than the tuning.

    A `detuning_percent` is met by tuning to each plant as it is and with its frequencies shifted both ways to that
    end, and where the check finds a worse shift between to that as well.

    Local searches: a better optimum elsewhere is possible.
    """
    if not frfs:
        raise WrongUseError(f"there is no FRF of loop {requirements.loop!r} to tune for", "", "measure or import one")
    unit = _unit(frfs, requirements, start)
    loops, _ = loops_of(frfs, unit, requirements, fits)
    copies = copies_for(requirements, len(loops))
    p, judge_of = _problem(loops, requirements, unit, copies, start)
    judge = judge_of(requirements)
    candidates, moved = _candidates(p, start, np.random.default_rng(seed), draws, starts)
    run = raced(p, candidates, seed, draws, starts)
    best, steps = settled(run, judge)
    why = None
    if not best.verdict.passed and explain:
        best, why = shortfall(p, best, run.ends, judge_of)
    if start is not None:
        best = _no_worse(p, best, candidates[0].x, judge)
    verdict, asked = check(frfs, p.controller(best.found.x), requirements, fits), requirements
    for _ in range(SHIFTED):
        if not best.verdict.passed or verdict.passed or requirements.detuning_percent is None:
            break
        copies, asked = closer(copies, asked, loops, p.controller(best.found.x), requirements, verdict)
        p, judge_of = _problem(loops, asked, unit, copies, start)
        again = settle(p, search(p, begin(p, best.found.x, LARGEST, 0.1), LARGEST, MORE), judge_of(asked))
        steps, best = steps + again.found.steps, again
        verdict = check(frfs, p.controller(best.found.x), requirements, fits)
    return _tuning(p, best, verdict, why, len(candidates), steps, moved)


def _problem(
    loops: Sequence[Loop],
    requirements: Requirements,
    unit: Controller,
    copies: Sequence[Copy],
    start: Controller | None,
) -> tuple[Problem, Callable[[Requirements], Judge]]:
    """The tuning problem on copies of the plants, shifted as a detuning margin asks, and its controllers' judge."""
    shifted = shifted_loops(loops, copies)
    precision = "double" if start is None else start.precision
    p = problem(list(shifted.values()), requirements, unit.rate_hz, precision)

    def judge_of(asked: Requirements) -> Judge:
        return lambda controller: judged(shifted, controller, asked)

    return p, judge_of


def _unit(frfs: Sequence[FRF], requirements: Requirements, start: Controller | None) -> Controller:
    """A gain of one that runs as the controller to come."""
    rates = {frf.rate_hz for frf in frfs}
    if len(rates) != 1 or 0.0 in rates:
        raise WrongUseError("the FRFs of one loop must come from one rate", f"{sorted(rates)} Hz")
    one = (Block("gain", {"gain": 1.0}),)
    if start is None:
        return Controller(requirements.loop, one, rates.pop())
    return replace(start, loop=requirements.loop, blocks=one, precision="double")


def _candidates(
    p: Problem, start: Controller | None, rng: np.random.Generator, draws: int, starts: int
) -> tuple[list[Found], tuple[str, ...]]:
    """Where searches begin, the warm start first, and what it had to leave."""
    if start is None:
        return random_starts(p, rng, draws, starts), ()
    x, moved = warm_start(p, start)
    others = random_starts(p, rng, draws, starts - 1) if starts > 1 else []
    return [begin(p, x), *others], moved


def _no_worse(p: Problem, best: Settled, x: Array, judge: Judge) -> Settled:
    """What was found, or the start where that passes and is better."""
    began = begin(p, x, steps=best.found.steps)
    start = Settled(began, judge(p.controller(x)), {})
    return start if start.verdict.passed and start.rank < best.rank else best


def _tuning(
    p: Problem,
    best: Settled,
    verdict: Verdict,
    why: Shortfall | None,
    starts: int,
    steps: int,
    moved: tuple[str, ...],
) -> Tuning:
    m, wish = best.found.measures, p.requirements.objective
    return Tuning(
        controller=p.controller(best.found.x),
        verdict=verdict,
        bandwidth_hz=float(min(m.bandwidth_hz for m in verdict.margins.values())),
        binding=_binding(p, best.found),
        feasible=verdict.passed,
        starts=starts,
        steps=steps,
        converged=best.found.converged,
        bounds_reached=bounds_reached(p, best.found.x),
        objective=m.objective(),
        rejection_db=float(db(np.exp(m.rejection.min()))) if wish.disturbance else None,
        shortfall=why,
        moved=moved,
    )


def _binding(p: Problem, found: Found, tolerance: float = 2e-3) -> tuple[Binding, ...]:
    """Operating points where the objective's terms are lowest and requirements without room, tightest first."""
    m, wish = found.measures, p.requirements.objective
    out = []
    if wish.bandwidth:
        lowest = np.flatnonzero(m.ln_bandwidth <= m.ln_bandwidth.min() + tolerance)
        out += [Binding("bandwidth_hz", p.names[i], float(np.exp(m.ln_bandwidth[i]))) for i in lowest]
    if wish.disturbance_below_hz is not None:
        lowest = np.flatnonzero(m.rejection <= m.rejection.min() + tolerance)
        out += [Binding("disturbance", p.names[i], wish.disturbance_below_hz) for i in lowest]
    seen = {(b.quantity, b.recording) for b in out}
    for k in np.argsort(m.room):
        if m.room[k] > min(m.worst, 0.0) + tolerance:
            break
        owner, at_hz = p.place(int(m.at[k]), int(m.point[k]))
        if (m.what[k], owner) not in seen:
            seen.add((m.what[k], owner))
            out.append(Binding(m.what[k], owner, at_hz))
    return tuple(out)
