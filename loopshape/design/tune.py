"""FRFs + Requirements -> Controller: the largest objective over all operating points, within all requirements."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from loopshape.core.errors import WrongUseError
from loopshape.core.json_ready import Plain, keys
from loopshape.core.toolboxes import needed
from loopshape.core.units import Array, db
from loopshape.data.control.block import BlockTemplate, Free
from loopshape.data.control.controller import Block, Controller
from loopshape.data.requirement.requirements import Requirements
from loopshape.data.response.frf import FRF
from loopshape.data.response.model import Fit
from loopshape.data.result.verdict import Verdict
from loopshape.data.signal.disturbance import Disturbance
from loopshape.design.problem.measures import Measures
from loopshape.design.problem.peaks import NORM
from loopshape.design.problem.problem import Problem, bounds_reached
from loopshape.design.problem.shifts import copies_for
from loopshape.design.relax import Shortfall, shortfall
from loopshape.design.search import SearchResult, initial_point
from loopshape.design.stage import Grown, Stage, Task, closed_in, lowest_bandwidth, step_of
from loopshape.design.starts import random_starts, settled, tournament
from loopshape.design.tighten import TightenedSolution, Verifier, norm
from loopshape.loop.loop import Loop
from loopshape.loop.loops import loops_of
from loopshape.loop.stability.low_end import sign_at_0
from loopshape.loop.verdict import refuse_too_high

TURNED = BlockTemplate("gain", {"gain": -1.0})


@dataclass(frozen=True)
class Search:
    """How a tuning searches: with the same numbers it ends at the same controller.

    Of `draws` random starts from `seed` the best `starts` are followed. Up to `grow` blocks are added to the structure,
    each the one that pays most, until one gains less than `least_gain` of the bandwidth. Several loops are tuned in
    turn for `rounds` rounds at most.
    """

    seed: int = 0
    starts: int = 16
    draws: int = 60
    grow: int = 0
    least_gain: float = 0.01
    rounds: int = 10


SEARCH = Search()


@dataclass(frozen=True)
class Binding:
    """What holds the tuning back: a requirement (or the objective itself) at an operating point and frequency."""

    quantity: str
    recording: str
    at_hz: float


@dataclass(frozen=True, eq=False)
class Tuning(Plain):
    """A tuned controller with its verdict, active constraints, and how the search went.

    `outcome` is the verdict's: "passed", "undecided" where the requirements hold by the estimates but not by their
    95 % intervals, "failed". Where no start came to meet every requirement `feasible` is False, the controller is the
    one that misses least, and `shortfall` says what keeps it so and what to relax. `converged` is False where the
    search ran out of steps. `objective` is what was made large; `rejection_db` the mean of 1/|S| in dB on the
    objective's low lines at the worst operating point, None where it was not asked. `weighted_norm` is the norm of the
    weighted loop that `check` reads, at the worst operating point, and `weighted_norm_interval` its 95 % interval; None
    without weights. `moved` says what a warm start
    had to leave. `growth` holds what was reached before and after each block that was added, `structure` the blocks
    that were tuned, with those.
    """

    IN_JSON = keys(
        "feasible", "outcome", "converged", "bandwidth_hz", "rejection_db", "weighted_norm", "weighted_norm_interval",
        "bounds_reached", "moved",
        loop="controller.loop", blocks="controller.blocks", binding="binding", growth="growth", shortfall="shortfall",
        verdict="verdict",
    )  # fmt: skip

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
    weighted_norm: float | None = None
    weighted_norm_interval: tuple[float, float] | None = None
    shortfall: Shortfall | None = None
    moved: tuple[str, ...] = ()
    growth: tuple[Grown, ...] = ()
    structure: tuple[BlockTemplate, ...] = ()

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
    search: Search = SEARCH,
    *,
    start: Controller | None = None,
    explain: bool = True,
    disturbances: Sequence[Disturbance] = (),
) -> Tuning:
    """Tune a structure to several measured plants at once; same input and search, same controller.

    Maximises the requirements' objective (the lowest bandwidth, unless they say otherwise) over all FRFs subject to
    every requirement at every one, on the valid lines. Of random starts within the bounds the best
    are followed a few steps, the best third of them further, and the best leaps from there; lines between which the
    plant runs straight are left out until what came out best is searched on, on all of them. Structures that this one
    contains, where a lead_lag or a notch does nothing, are searched first, and their optima are starts too. What comes
    out is checked
    by `check` itself; limits are tightened by what its finer reading and its 95 % intervals ask for, and the search
    goes on. The requirements are then met as far as these data are sure.

    With `start` the search begins at that controller, run as it runs (prewarping, delay, hold, precision), and besides
    at `search.starts` - 1 others: one start is a local improvement alone. A `start` that meets the requirements is
    never made worse. Where they cannot be met `explain` finds out what to relax, which takes longer than the tuning.

    `disturbances` tell what a limit of `error_rms` is about, at their operating points; one alone serves all. Shifted
    plants keep to it too.

    A `detuning_percent` is met by tuning to each plant as it is and with its frequencies shifted both ways to that
    end, and where the check finds a worse shift between to that as well.

    Blocks that are added come one after the other; `growth` holds each step. Up to three biquads at once are tried
    too, under a floor on |L| that reaches beyond its dips; what ends better is taken (the toolbox limits does it).

    To plants whose lowest lines show a reversed sign (-k/s^n) a structure without a gain of -1 gets one: the verdict's
    warnings say so.

    Local searches: a better optimum elsewhere is possible.
    """
    if not frfs:
        raise WrongUseError(f"there is no FRF of loop {requirements.loop!r} to tune for", "", "measure or import one")
    unit = _unit(frfs, requirements, start)
    refuse_too_high(requirements, unit)
    loops, notes = loops_of(frfs, unit, requirements, fits)
    if _is_turned(loops, requirements.structure, start):
        requirements = replace(requirements, structure=(*requirements.structure, TURNED))
        notes += (
            f"the plant of loop {requirements.loop} has a reversed sign: a gain of -1 was added to the structure",
        )
    precision = "double" if start is None else start.precision
    task = Task(tuple(frfs), tuple(fits), requirements, tuple(loops), notes, unit, precision, tuple(disturbances))
    copies = copies_for(requirements, len(loops))
    p, check_of = task.problem(copies, requirements)
    verifier = check_of(requirements)
    candidates, moved = _candidates(p, start, search)
    run = tournament(p, candidates, search.seed, search.draws, search.starts)
    best, steps = settled(run, verifier)
    why = None
    if not best.verdict.passed and explain and not search.grow:
        best, why = shortfall(p, best, run.ends, check_of)
    if start is not None:
        best = _no_worse(p, best, candidates[0].x, verifier)
    first = closed_in(task, Stage(copies, requirements, p, best, task.check(p, best), steps))
    stages = [first]
    if search.grow:
        grow = needed("searches", "grow", "lets a structure grow", f"grow = {search.grow}")
        stages = grow(task, first, search.grow, search.least_gain, search.seed, search.starts)
    last = stages[-1]
    if search.grow and explain and not last.verdict.passed:
        p, check_of = task.problem(last.copies, last.asked)
        best, why = shortfall(p, last.best, [last.best.result], check_of)
        last = replace(last, best=best, verdict=task.check(p, best))
    steps = sum(stage.steps for stage in stages)
    growth = tuple(step_of(stage) for stage in stages) if search.grow else ()
    return _tuning(last, why, len(candidates), steps, moved, growth)


def _is_turned(loops: Sequence[Loop], structure: Sequence[BlockTemplate], start: Controller | None) -> bool:
    """Whether a structure of positive gains lacks the sign that the plants need, or that the start has."""
    own = [template.parameters.get("gain") for template in structure if template.kind == "gain"]
    if not structure or any(isinstance(x, int | float) and x < 0.0 for x in own):
        return False
    if start is None:
        return all(loop.unstable_poles == 0 and sign_at_0(loop) < 0 for loop in loops)
    more = Counter(block.kind for block in start.blocks) - Counter(template.kind for template in structure)
    return more == Counter(["gain"]) and any(block == Block("gain", {"gain": -1.0}) for block in start.blocks)


def _unit(frfs: Sequence[FRF], requirements: Requirements, start: Controller | None) -> Controller:
    """A gain of one that runs as the controller to come."""
    rates = {frf.rate_hz for frf in frfs}
    if 0.0 in rates:
        raise WrongUseError("the rate of the FRFs to tune for is not known", "rate_hz 0", "give them rate_hz=...")
    if len(rates) != 1:
        raise WrongUseError("the FRFs of one loop must come from one rate", f"{sorted(rates)} Hz")
    one = (Block("gain", {"gain": 1.0}),)
    if start is None:
        return Controller(requirements.loop, one, rates.pop())
    return replace(start, loop=requirements.loop, blocks=one, precision="double")


def _candidates(p: Problem, start: Controller | None, search: Search) -> tuple[list[SearchResult], tuple[str, ...]]:
    """Where searches begin, the warm start first, and what it had to leave."""
    rng, starts = np.random.default_rng(search.seed), search.starts
    if start is None:
        return random_starts(p.coarse, rng, search.draws, starts), ()
    x, moved = warm_start(p, start)
    others = random_starts(p.coarse, rng, search.draws, starts - 1) if starts > 1 else []
    return [initial_point(p.coarse, x), *others], moved


def _no_worse(p: Problem, best: TightenedSolution, x: Array, verifier: Verifier) -> TightenedSolution:
    """What was found, or the start where that passes and is better."""
    initial = initial_point(p, x, steps=best.result.steps)
    start = TightenedSolution(initial, verifier(p.controller(x)), {})
    return start if start.verdict.passed and start.rank < best.rank else best


def _tuning(
    stage: Stage, why: Shortfall | None, starts: int, steps: int, moved: tuple[str, ...], growth: tuple[Grown, ...]
) -> Tuning:
    p, best, verdict = stage.p, stage.best, stage.verdict
    m, aim = best.result.measures, p.requirements.objective
    reached, interval = norm(verdict) if p.requirements.weights else (None, None)
    return Tuning(
        controller=p.controller(best.result.x),
        verdict=verdict,
        bandwidth_hz=lowest_bandwidth(stage),
        binding=_binding(p, best.result),
        feasible=verdict.passed,
        starts=starts,
        steps=steps,
        converged=best.result.converged,
        bounds_reached=bounds_reached(p, best.result.x),
        objective=best.objective,
        rejection_db=float(db(np.exp(m.rejection.min()))) if aim.disturbance else None,
        weighted_norm=reached,
        weighted_norm_interval=interval,
        shortfall=why,
        moved=moved,
        growth=growth,
        structure=stage.asked.structure,
    )


def _largest(p: Problem, m: Measures, tolerance: float) -> list[tuple[str, float]]:
    """Operating points whose norm is the largest, each with the frequency where it is."""
    found: dict[int, tuple[float, int]] = {}
    for row in m.norms:
        for value, at, point in zip(row.value.tolist(), row.at.tolist(), row.point.tolist(), strict=True):
            found[point] = min(found.get(point, (np.inf, 0)), (value, at))
    least = min((value for value, _ in found.values()), default=0.0)
    return [p.place(at, point) for point, (value, at) in found.items() if value <= least + tolerance]


def _binding(p: Problem, found: SearchResult, tolerance: float = 2e-3) -> tuple[Binding, ...]:
    """Operating points where the objective's terms are lowest and requirements without room, tightest first."""
    m, aim = found.measures, p.requirements.objective
    out = []
    if aim.bandwidth:
        lowest = np.flatnonzero(m.ln_bandwidth <= m.ln_bandwidth.min() + tolerance)
        out += [Binding("bandwidth_hz", p.names[i], float(np.exp(m.ln_bandwidth[i]))) for i in lowest]
    if aim.disturbance_below_hz is not None:
        lowest = np.flatnonzero(m.rejection <= m.rejection.min() + tolerance)
        out += [Binding("disturbance", p.names[i], aim.disturbance_below_hz) for i in lowest]
    out += [Binding(NORM, *place) for place in _largest(p, m, tolerance)]
    seen = {(b.quantity, b.recording) for b in out}
    for k in np.argsort(m.room):
        if m.room[k] > min(m.worst, 0.0) + tolerance:
            break
        owner, at_hz = p.place(int(m.at[k]), int(m.point[k]))
        if (m.what[k], owner) not in seen:
            seen.add((m.what[k], owner))
            out.append(Binding(m.what[k], owner, at_hz))
    return tuple(out)


def warm_start(p: Problem, controller: Controller) -> tuple[Array, tuple[str, ...]]:
    """x of the structure nearest to a controller, and what had to be moved for it.

    The k-th block of a kind stands for the structure's k-th of that kind; blocks in series commute, so the order of
    kinds does not matter. Values outside bounds go to the bound, fixed and tied parameters to what the structure says.
    Refuses a controller with other kinds or numbers of blocks.
    """
    have, want = (Counter(block.kind for block in own) for own in (controller.blocks, p.templates))
    if have != want:
        raise WrongUseError(
            f"the controller to start from does not fit the structure of loop {p.requirements.loop!r}",
            f"it has {_words(have)}",
            f"the structure has {_words(want)}: bring the one or the other in line",
        )
    mine = _in_order(p.templates, controller.blocks)
    notes = [note for template, block in zip(p.templates, mine, strict=True) for note in _moved(template, block)]
    x = np.log([min(max(mine[v.block].parameters[v.name], v.low), v.high) for v in p.variables])
    return x, tuple(notes)


def _words(kinds: Counter[str]) -> str:
    return ", ".join(f"{kinds[kind]} {kind}" for kind in sorted(kinds)) or "no block"


def _in_order(templates: tuple[BlockTemplate, ...], blocks: tuple[Block, ...]) -> list[Block]:
    """Blocks in the templates' order, the k-th of a kind for the k-th."""
    left = {kind: [b for b in blocks if b.kind == kind] for kind in {t.kind for t in templates}}
    return [left[t.kind].pop(0) for t in templates]


def _moved(template: BlockTemplate, block: Block) -> Iterator[str]:
    """What a block loses in a template, a sentence each."""
    for name, value in block.parameters.items():
        wanted, tied = template.parameters.get(name), template.tie.get(name)
        where = f"{name} of the {template.kind} block is {value:.4g}"
        if tied is not None:
            if value != block.parameters[tied]:
                yield f"{where}; the structure ties it to {tied}, {block.parameters[tied]:.4g}"
        elif isinstance(wanted, Free):
            if not wanted.low <= value <= wanted.high:
                yield f"{where}, outside its bounds; started from {min(max(value, wanted.low), wanted.high):.4g}"
        elif wanted != value:
            yield f"{where}; the structure fixes it at {wanted:.4g}"
