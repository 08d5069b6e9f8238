"""The loops of one plant, tuned one after the other with the others closed, until nothing moves."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import count
from typing import Any, NamedTuple

import numpy as np

from loopshape.core.errors import WrongUseError
from loopshape.core.json_ready import Plain, keys
from loopshape.core.units import Array
from loopshape.data.algebra.propagation import pick
from loopshape.data.control.controller import Controller
from loopshape.data.control.shorthand import bounded
from loopshape.data.requirement.requirements import Requirements
from loopshape.data.response.frf import FRF
from loopshape.data.response.model import Fit
from loopshape.data.result.verdict import Verdict
from loopshape.data.signal.disturbance import Disturbance
from loopshape.design.tune import SEARCH, Search, Tuning, tune
from loopshape.identify.matrix.equivalent_plant import equivalent_plant, square_part
from loopshape.loop.loops import Closed, loops_of, matrix_loops
from loopshape.loop.matrix.determinant import encirclement_count
from loopshape.loop.matrix.disturbed_loops import of_each
from loopshape.loop.stability.stability import unstable_count
from loopshape.loop.verdict import check

#: controllers stand still where ln of no response moved by more than this in a round
STILL = 3e-3


@dataclass(frozen=True, eq=False)
class Turn(Plain):
    """One loop's tuning in a round, with `others` closed; `moved`: largest |d ln C| on the lines, nan at first."""

    IN_JSON = keys("round", "loop", bandwidth_hz="tuning.bandwidth_hz", outcome="tuning.outcome")

    round: int
    loop: str
    others: tuple[str, ...]
    tuning: Tuning
    moved: float


@dataclass(frozen=True, eq=False)
class TunedLoops(Plain):
    """Controllers of all loops, how they came to be, and the verdict on all of them at once.

    `converged` tells that in the last round no controller moved; where it is False the loops pull at each other, and
    the last round's controllers stand. `notes` say what had to be assumed.
    """

    IN_JSON = keys("converged", "notes", rounds="turns", each="verdict.each", together="together")

    controllers: tuple[Controller, ...]
    turns: tuple[Turn, ...]
    verdict: Verdict
    converged: bool
    notes: tuple[str, ...]

    @property
    def feasible(self) -> bool:
        """Whether every loop, and all together, surely meet what is required."""
        return self.verdict.passed

    @property
    def together(self) -> dict[str, Any]:
        """The verdict on all loops at once for JSON, without its margins."""
        return {key: value for key, value in self.verdict.parts[-1].to_dict().items() if key != "margins"}

    @property
    def tunings(self) -> Mapping[str, Tuning]:
        """Each loop's last tuning."""
        return {turn.loop: turn.tuning for turn in self.turns}


class Known(NamedTuple):
    """What is known of a plant besides its FRFs: fits, controllers that it was recorded under, what disturbs it."""

    fits: Sequence[Fit] = ()
    recorded_under: Sequence[Controller] = ()
    disturbances: Sequence[Disturbance] = ()


def tune_loops(
    frfs: Sequence[FRF],
    requirements: Sequence[Requirements],
    controllers: Sequence[Controller] = (),
    together: Requirements | None = None,
    search: Search = SEARCH,
    known: Known | None = None,
    *,
    step: Callable[[str], None] = lambda word: None,
) -> TunedLoops:
    """Tune the loops of a plant's matrices (one an operating point) in turn; same input and search, same controllers.

    Loops are tuned in the order of `requirements`, each to the plants that it meets while the others are closed with
    their latest controllers; loops that have none yet are open. `controllers` are where loops start, and those of loops
    without requirements stay as they are. From the second round on each search begins at the loop's own controller. A
    round in which no controller moves by more than 0.3 % ends it. `together` serves the last check, as `check` has it.
    Each loop's structure grows in the first round, as in `tune`. `step` is called with a word after each tuning. With
    disturbances `known`, of all loops at the same time, the search begins at `controllers` of all loops.

    With the others closed the plant of a loop may be unstable where they need it to be stable: the unstable poles of
    each such plant are counted from the matrix. What comes out is a point that no loop improves on alone, not the best
    for all; the order of the loops matters. Refuses what `tune` and `square_part` refuse.
    """
    fits, recorded_under, disturbances = known or Known()
    given = {one.loop: one for one in controllers}
    wishes = {one.loop: one for one in requirements}
    names = (*wishes, *(name for name in given if name not in wishes))
    squares = [square_part(frf, names, least=1)[0] for frf in frfs]
    if disturbances and (missing := [name for name in names if name not in given]):
        raise WrongUseError(
            "what disturbs several loops is carried over from controllers of all of them",
            f"no start for {', '.join(missing)}", "give --start a file with all loops",
        )  # fmt: skip
    state = _State(squares, names, wishes, dict(given), disturbances)
    turns: list[Turn] = []
    for number in range(1, search.rounds + 1):
        mine = []
        for loop in wishes:
            mine.append(state.turn(number, loop, search if number == 1 else replace(search, grow=0)))
            step(f"round {number}: {loop} {mine[-1].tuning.bandwidth_hz:.3g} Hz")
        turns += mine
        if all(turn.moved < STILL for turn in mine):
            break
    found = tuple(state.controllers[name] for name in names)
    verdict = check(
        frfs, found, requirements, fits, together=together, closed=names, recorded_under=recorded_under,
        disturbances=disturbances,
    )  # fmt: skip
    still = all(turn.moved < STILL for turn in turns[-len(wishes) :])
    return TunedLoops(found, tuple(turns), verdict, still, tuple(dict.fromkeys(state.notes)))


@dataclass(eq=False)
class _State:
    """Matrices, wishes, and the controllers as they stand."""

    frfs: Sequence[FRF]
    names: tuple[str, ...]
    wishes: dict[str, Requirements]
    controllers: dict[str, Controller]
    disturbances: Sequence[Disturbance] = ()
    notes: list[str] = field(default_factory=list)

    def turn(self, number: int, loop: str, search: Search) -> Turn:
        """Tune one loop with the others as they stand, and let its controller stand."""
        others = tuple(name for name in self.names if name in self.controllers and name != loop)
        plants = [self._equivalent(frf, loop, others, k) for frf, k in zip(self.frfs, count(1))]
        self.wishes[loop] = replace(self.wishes[loop], structure=bounded(self.wishes[loop].structure, plants))
        wish = self._wish(loop, others, plants)
        before, known = self.controllers.get(loop), self._disturbed(loop)
        first = search if number == 1 else replace(search, starts=1)
        found = tune(plants, wish, search=first, start=before, explain=False, disturbances=known)
        if number > 1 and not found.feasible:
            found = tune(plants, wish, search=search, start=before, explain=False, disturbances=known)
        self.controllers[loop] = found.controller
        self.wishes[loop] = replace(self.wishes[loop], structure=found.structure)
        return Turn(number, loop, others, found, _moved(before, found.controller, self.frfs[0].frequency_hz))

    def _disturbed(self, loop: str) -> list[Disturbance]:
        """What disturbs one loop under the controllers as they stand, its own with them."""
        if not self.disturbances:
            return []
        own = tuple(self.controllers[name] for name in self.names)
        loops, _ = matrix_loops(Closed(tuple(self.frfs), own, ()), Requirements(unstable_poles=0))
        return [replace(one, carried=None) for one in of_each(loops, self.disturbances)[loop]]

    def _part(self, frf: FRF, names: Sequence[str]) -> FRF:
        k = [self.names.index(name) for name in names]
        return replace(pick(frf, k, k), loop="+".join(names))

    def _equivalent(self, frf: FRF, loop: str, others: tuple[str, ...], k: int) -> FRF:
        """The plant that a loop meets while others are closed, and the rest is open."""
        closed = (loop, *others)
        part = self._part(frf, closed)
        equivalent = equivalent_plant(part, closed, loop, self.controllers) if others else part
        return replace(equivalent, loop=loop, recording=frf.recording or f"frf {k}", recorded_under=None)

    def _wish(self, loop: str, others: tuple[str, ...], plants: Sequence[FRF]) -> Requirements:
        """A loop's wishes with the unstable poles that its plant has while others are closed."""
        wish = self.wishes[loop]
        if not others:
            return replace(wish, unstable_poles=wish.unstable_poles or 0)
        counts = [self._unstable(frf, others) for frf in self.frfs]
        if len(set(counts)) > 1:
            counted = ", ".join(f"{n} at {plant.recording}" for n, plant in zip(counts, plants, strict=True))
            raise WrongUseError(
                f"with {loop} open the other loops have different numbers of unstable poles", counted,
                "start from controllers that hold the other loops by themselves, or tune the points apart",
            )  # fmt: skip
        return replace(wish, unstable_poles=counts[0])

    def _unstable(self, frf: FRF, closed: tuple[str, ...]) -> int:
        """Unstable poles of the plant while these loops alone are closed; taken as none where that is unclear."""
        part = self._part(frf, closed)
        if len(closed) == 1:
            wish = self.wishes.get(closed[0], Requirements(closed[0]))
            wish = replace(wish, unstable_poles=wish.unstable_poles or 0)
            (loop,), _ = loops_of([replace(part, recorded_under=None)], self.controllers[closed[0]], wish)
            found = None if loop.integrators is None else unstable_count(loop)
        else:
            own = [self.controllers[name] for name in closed]
            loops, _ = matrix_loops(Closed((part,), tuple(own), ()), Requirements(unstable_poles=0))
            found = encirclement_count(loops[0])
        if isinstance(found, int):
            return max(found, 0)
        self.notes.append(f"{', '.join(closed)} closed alone are taken to be stable at {frf.recording}")
        return 0


def _moved(before: Controller | None, after: Controller, f: Array) -> float:
    """Largest |ln| of the ratio of two controllers' responses on some lines in Hz, nan without a first one."""
    if before is None:
        return float("nan")
    return float(np.abs(np.log(after.response(f) / before.response(f))).max())
