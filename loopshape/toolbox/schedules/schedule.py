"""One robust controller against one of the same structure for each operating point: what robustness costs in Hz."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

from loopshape.core.errors import WrongUseError
from loopshape.core.json_ready import Plain, keys
from loopshape.data.control.controller import Controller
from loopshape.data.requirement.requirements import LIMIT_OF, Requirements
from loopshape.data.response.frf import FRF
from loopshape.data.response.model import Fit
from loopshape.data.result.verdict import RequirementResult, Verdict
from loopshape.design.tune import Search, tune
from loopshape.loop.loops import loops_of
from loopshape.loop.verdict import check
from loopshape.toolbox.limits.bound import excluded

#: how often a search that ends just outside the requirements is repeated
AGAIN = 2


@dataclass(frozen=True, eq=False)
class PointCost(Plain):
    """Bandwidths at one operating point: with its own controller, with the robust one, and what none exceeds.

    `own` is the better of the two there, so robustness never costs less than nothing; `tuned` tells whether the
    search for it found the better one, `feasible` whether its own surely meets all requirements. `bound_hz` is nan
    where it was not asked.
    """

    IN_JSON = keys(
        "recording", "operating_point", "own_hz", "robust_hz", "cost_hz", "ratio", "bound_hz", "tuned", "feasible",
        blocks="own.blocks",
    )  # fmt: skip

    recording: str
    operating_point: Mapping[str, float]
    own: Controller
    own_hz: float
    robust_hz: float
    bound_hz: float
    tuned: bool
    feasible: bool

    @property
    def cost_hz(self) -> float:
        """What the robust controller gives away here."""
        return self.own_hz - self.robust_hz

    @property
    def ratio(self) -> float:
        """Robust over own bandwidth; 1 where both have none."""
        return self.robust_hz / self.own_hz if self.own_hz > 0.0 else 1.0


@dataclass(frozen=True, eq=False)
class Schedule(Plain):
    """Every operating point's cost, for one loop and one robust controller."""

    IN_JSON = keys("loop", "robust_hz", "own_hz", "points")

    loop: str
    robust: Controller
    points: tuple[PointCost, ...]

    @property
    def robust_hz(self) -> float:
        """Lowest bandwidth of the robust controller."""
        return min(point.robust_hz for point in self.points)

    @property
    def own_hz(self) -> float:
        """Lowest bandwidth of the scheduled ones."""
        return min(point.own_hz for point in self.points)

    def parameters(self) -> dict[str, list[float]]:
        """Parameters that differ over the points, by "block number kind name", each (points,)."""
        tables: dict[str, list[float]] = {}
        for point in self.points:
            for k, block in enumerate(point.own.blocks, start=1):
                for name, value in block.parameters.items():
                    tables.setdefault(f"{k} {block.kind} {name}", []).append(value)
        return {name: values for name, values in tables.items() if max(values) > min(values)}


def schedule(
    frfs: Sequence[FRF],
    requirements: Requirements,
    robust: Controller,
    fits: Sequence[Fit] = (),
    *,
    seed: int = 0,
    starts: int = 16,
    bounds: bool = True,
    step: Callable[[str], None] = lambda word: None,
) -> Schedule:
    """Tune the requirements' structure at each operating point alone and compare with a robust controller.

    Each own controller is tuned to its FRF under the same requirements; where the search ends below the robust
    one, or outside the requirements, that one is its own too. `step` is called with a word after each operating
    point. Same input and seed, same answer.

    Misleads: a controller switched between the points is not a loop that was checked; the comparison is of
    frozen operating points.
    """
    if not frfs:
        raise WrongUseError(f"there is no FRF of loop {requirements.loop!r} to schedule for", "", "measure one")
    kinds = [block.kind for block in robust.blocks]
    if kinds != [block.kind for block in requirements.structure]:
        raise WrongUseError(
            f"the robust controller of loop {requirements.loop!r} is not of the structure to be tuned",
            ", ".join(kinds),
            f"the requirements name {', '.join(block.kind for block in requirements.structure) or 'none'}",
        )
    held = check(frfs, robust, requirements, fits).margins
    points = []
    for frf, (name, margins) in zip(frfs, held.items(), strict=True):
        points.append(
            _point(replace(frf, recording=name), requirements, robust, margins.bandwidth_hz, fits, seed, starts, bounds)
        )
        step(name)
    return Schedule(requirements.loop, robust, tuple(points))


def _point(
    frf: FRF, requirements: Requirements, robust: Controller, robust_hz: float, fits: Sequence[Fit],
    seed: int, starts: int, bounds: bool,
) -> PointCost:  # fmt: skip
    controller, verdict = _tuned(frf, requirements, fits, seed, starts)
    own_hz = verdict.margins[frf.recording].bandwidth_hz
    better = verdict.outcome != "failed" and own_hz >= robust_hz
    own = controller if better else robust
    bound_hz = float("nan")
    if bounds:
        (loop,), _ = loops_of([frf], robust, requirements, fits)
        bound_hz = excluded(loop, [loop], requirements.of(frf.operating_point)).bound_hz
    return PointCost(
        recording=frf.recording,
        operating_point=frf.operating_point,
        own=own,
        own_hz=own_hz if better else robust_hz,
        robust_hz=robust_hz,
        bound_hz=bound_hz,
        tuned=better,
        feasible=verdict.passed if better else check([frf], robust, requirements, fits).passed,
    )


def _tuned(
    frf: FRF, requirements: Requirements, fits: Sequence[Fit], seed: int, starts: int
) -> tuple[Controller, Verdict]:
    """A tuned controller and its check; a search that ends a hair outside is repeated with these limits closer."""
    asked = requirements
    for _ in range(1 + AGAIN):
        controller = tune([frf], asked, fits, search=Search(seed=seed, starts=starts)).controller
        verdict = check([frf], controller, requirements, fits)
        missed = [line for line in verdict.lines if line.outcome == "failed"]
        if not missed or verdict.unstable:
            break
        asked = asked.moved({line.quantity: _closer(line) for line in missed})
    return controller, verdict


def _closer(line: RequirementResult) -> float:
    return (-1.5 if LIMIT_OF[line.quantity].sense == "at_least" else 1.5) * line.slack
