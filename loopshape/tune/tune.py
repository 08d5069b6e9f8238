"""FRFs + Requirements -> Controller: the largest lowest bandwidth over all operating points."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from loopshape.check.verdict import check, loops_of
from loopshape.controller import Block, Controller
from loopshape.errors import WrongUseError
from loopshape.frf import FRF
from loopshape.model import Fit
from loopshape.requirements import Requirements, Verdict
from loopshape.tune.measures import measure
from loopshape.tune.problem import Problem, problem
from loopshape.tune.search import LARGEST, Found, Goal, scaled_start, search
from loopshape.units import Array


@dataclass(frozen=True)
class Binding:
    """What holds the tuning back: a requirement (or the bandwidth itself) at an operating point and frequency."""

    quantity: str
    recording: str
    at_hz: float


@dataclass(frozen=True, eq=False)
class Tuning:
    """A tuned controller with its verdict, what binds, and how the search went.

    `feasible` is False where no start came to meet every requirement; the controller is then the one that
    misses least, and `binding` names what it misses. `converged` is False where the search ran out of steps.
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


def tune(
    frfs: Sequence[FRF],
    requirements: Requirements,
    fits: Sequence[Fit] = (),
    *,
    seed: int = 0,
    starts: int = 16,
    draws: int = 60,
) -> Tuning:
    """Tune a structure to several measured plants at once; same input and seed, same controller.

    Maximises the lowest bandwidth (first 0 dB crossing of L) over all FRFs subject to every requirement at
    every one, on the trusted lines. Of `draws` random starts within the bounds the best `starts` are
    followed a few steps, the best third of them further, and the best three to their end. What comes out is
    checked by `check` itself; where interpolation between lines differs, limits are tightened by the
    difference and the search goes on.

    Local searches: a better optimum elsewhere is possible. Noise on the FRFs is taken at face value.
    """
    if not frfs:
        raise WrongUseError(f"there is no FRF of loop {requirements.loop!r} to tune for", "", "measure or import one")
    dummy = Controller(requirements.loop, (Block("gain", {"gain": 1.0}),), _rate(frfs))
    loops, _ = loops_of(frfs, dummy, requirements, fits)
    p = problem(loops, requirements, dummy.rate_hz)
    candidates = _starts(p, np.random.default_rng(seed), draws, starts)
    best, steps = _race(p, candidates)
    best, verdict, more = _polish(p, best, lambda c: check(frfs, c, requirements, fits))
    return Tuning(
        controller=p.controller(best.x),
        verdict=verdict,
        bandwidth_hz=float(min(m.bandwidth_hz for m in verdict.margins.values())),
        binding=_binding(p, best),
        feasible=verdict.passed,
        starts=len(candidates),
        steps=steps + more,
        converged=best.converged,
        bounds_reached=_bounds_reached(p, best.x),
    )


def _race(p: Problem, candidates: list[Found]) -> tuple[Found, int]:
    """The best of several searches, dropping those that lag; with the steps taken in all."""
    dropped = 0
    for keep, most in ((len(candidates), 15), (max(3, len(candidates) // 3), 40), (3, 300)):
        dropped += sum(found.steps for found in candidates[keep:])
        candidates = sorted(
            (search(p, found, LARGEST, most) for found in candidates[:keep]), key=lambda found: found.merit
        )
    return candidates[0], dropped + sum(found.steps for found in candidates)


def _polish(p: Problem, best: Found, judge: Callable[[Controller], Verdict]) -> tuple[Found, Verdict, int]:
    """Tighten the limits that `judge` finds missed by its finer reading, and search on; with the steps taken."""
    tighten: dict[str, float] = {}
    before = best.steps
    for _ in range(6):
        verdict = judge(p.controller(best.x))
        misses = {line.quantity: -line.spare for line in verdict.lines if not line.passed}
        if not misses or best.measures.worst < -1e-3:
            break
        for name, miss in misses.items():
            tighten[name] = tighten.get(name, 0.0) + 1.05 * miss + 1e-6
        anew = Found(best.x, measure(p, best.x, tighten), 1e-3, best.steps, False)
        best = search(p, anew, Goal(tighten), 60)
    return best, judge(p.controller(best.x)), best.steps - before


def _rate(frfs: Sequence[FRF]) -> float:
    rates = {frf.rate_hz for frf in frfs}
    if len(rates) != 1 or 0.0 in rates:
        raise WrongUseError("the FRFs of one loop must come from one rate", f"{sorted(rates)} Hz")
    return rates.pop()


def _starts(p: Problem, rng: np.random.Generator, draws: int, keep: int) -> list[Found]:
    """The best of random starts and the user's own, each with its gain as large as allowed."""
    middle = 0.5 * (p.low + p.high)
    own = np.array([m if v.start is None else np.log(v.start) for v, m in zip(p.variables, middle, strict=True)])
    trials = [own] + [p.low + rng.random(own.size) * (p.high - p.low) for _ in range(draws)]
    return sorted((scaled_start(p, x) for x in trials), key=lambda found: found.merit)[:keep]


def _binding(p: Problem, found: Found, tolerance: float = 2e-3) -> tuple[Binding, ...]:
    """Requirements without room and operating points of lowest bandwidth, tightest first, one of a kind each."""
    m = found.measures
    lowest = np.flatnonzero(m.ln_bandwidth <= m.ln_bandwidth.min() + tolerance)
    out = [Binding("bandwidth_hz", p.names[i], float(np.exp(m.ln_bandwidth[i]))) for i in lowest]
    seen = set()
    for k in np.argsort(m.room):
        if m.room[k] > tolerance:
            break
        owner, at_hz = p.place(int(m.at[k]), int(m.point[k]))
        if (m.what[k], owner) not in seen:
            seen.add((m.what[k], owner))
            out.append(Binding(m.what[k], owner, at_hz))
    return tuple(out)


def _bounds_reached(p: Problem, x: Array) -> tuple[str, ...]:
    names = []
    for k, v in enumerate(p.variables):
        for limit, word in ((p.low[k], "min"), (p.high[k], "max")):
            if abs(x[k] - limit) < 1e-6:
                names.append(f"{p.templates[v.block].kind} {v.name} at its {word} {np.exp(limit):g}")
    return tuple(names)
