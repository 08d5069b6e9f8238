"""Block diagram -> the plant that its tuned block meets, once every inner loop is certified stable.

Inner loops are closed one after the other, the tuned block open: det(I - G M) is the product of their 1 + L, so that
with none of them unstable nothing is left unstable but what plants outside of them bring (Maciejowski, Multivariable
Feedback Design, 1989, on closing loops in sequence). Any order that is certified throughout is proof.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations, permutations

from loopshape.core.errors import WrongUseError
from loopshape.data.algebra.propagation import pick
from loopshape.data.control.controller import Controller
from loopshape.data.control.shorthand import controller, gain
from loopshape.data.requirement.requirements import Requirements
from loopshape.data.response.frf import FRF
from loopshape.data.result.equivalent import Equivalent, hidden
from loopshape.data.result.verdict import Verdict
from loopshape.loop.loops import loops_of
from loopshape.loop.verdict import check_loops
from loopshape.toolbox.diagrams.diagram import Diagram, Part
from loopshape.toolbox.diagrams.transfer import transfer

#: controllers in inner loops that are tried in every order of closing
MOST = 4


def equivalent(D: Diagram) -> Equivalent:
    """The plant that the tuned block of a diagram meets, with the covariance of all that was measured.

    It goes from the tuned block's output to minus its input, all other loops closed. Loops that stay closed with the
    tuned block open have to be certified stable by `check`, else the diagram is refused: plants tell their
    unstable poles by `Part.unstable_poles`, by having been recorded in open loop, or by the count of the loop under
    which they were recorded. An integrator that the tuned block cannot see is refused too. Misleads where controllers
    limit their outputs.

    >>> import numpy as np, loopshape as ls
    >>> f_hz = np.geomspace(1.0, 400.0, 80)
    >>> P1, P2 = (
    ...     ls.FRF.from_arrays(f_hz, 1.0 / (1.0 + 1j * f_hz / f), relative_std=0.01, rate_hz=1000.0, open_loop=True)
    ...     for f in (5.0, 90.0)
    ... )
    >>> ls.diagrams.equivalent(ls.diagrams.dual_stage(P1, P2, ls.controller(ls.gain(0.5), rate_hz=1000.0)))
    Equivalent: 1 operating point, unstable poles 0, inner loop C2 passed
    """
    tuned = D.part(D.tuned)
    closings, why = _certified(D)
    if closings is None:
        raise WrongUseError(
            "an inner loop must be certified stable with the tuned block open", why,
            "tune it first, or declare integrators and unstable_poles of its plant",
        )  # fmt: skip
    left = _poles(D, closings.calmed)
    word = "; ".join(f"the inner loop {name} is closed, and certified stable" for name in closings.verdicts)
    plants = []
    for point in range(D.points):
        made = _equivalent(D, tuned, point, (D.tuned,))
        notes = (*made.notes, word) if word else made.notes
        plants.append(replace(made, open_loop=left == 0, notes=notes))
    integrators = _integrators_left(D, plants, closings)
    return Equivalent(tuple(plants), closings.verdicts, left, integrators)


@dataclass(frozen=True)
class _Closings:
    """Inner loops in the order of closing; plants whose unstable poles they hold, and the integrators they took."""

    verdicts: Mapping[str, Verdict]
    calmed: frozenset[str] = frozenset()
    integrators: int = 0


def _equivalent(D: Diagram, part: Part, point: int, opened: Sequence[str]) -> FRF:
    """The plant that a block of one input and one output meets: from its output to minus its input."""
    made = transfer(D, part.outputs[0], part.inputs[0], opened=opened, point=point)
    sensed = [name for _, name in D.terms(part.inputs[0]) if name not in D.external]
    names = tuple(sensed) if len(sensed) == 1 else tuple(part.inputs)
    return replace(made, response=-made.response, loop=part.name, outputs=names)


def _certified(D: Diagram) -> tuple[_Closings | None, str]:
    """The first order of closing that is certified throughout, else what the first one found."""
    reason = ""
    for order in _orders(D):
        found, why = _closed_in(D, order)
        if found is not None:
            return found, ""
        reason = reason or why
    return None, reason


def _orders(D: Diagram) -> Iterator[tuple[str, ...]]:
    """Sets of controllers that open all circles but the tuned block's, the smallest first, in every order."""
    inner = [one.name for one in D.parts if isinstance(one.what, Controller) and one.name != D.tuned]
    inner = [name for name in inner if D.in_circle(name, (D.tuned,))]
    fewest = None
    for size in range(min(len(inner), MOST) + 1):
        for chosen in combinations(inner, size):
            if any(D.in_circle(name, (D.tuned, *chosen)) for name in D.followers((D.tuned, *chosen))):
                continue
            fewest = size
            yield from permutations(chosen)
        if fewest is not None:
            return


def _closed_in(D: Diagram, order: Sequence[str]) -> tuple[_Closings | None, str]:
    """Close inner loops in this order and check each; None and why where one is not certified."""
    verdicts: dict[str, Verdict] = {}
    calmed: frozenset[str] = frozenset()
    integrators = 0
    for k, name in enumerate(order):
        opened, part = (D.tuned, *order[k:]), D.part(name)
        C = part.what
        assert isinstance(C, Controller)
        here = frozenset(D.in_circle(name, (D.tuned, *order[k + 1 :])))
        poles = _poles(D, calmed, here)
        plants = [replace(_equivalent(D, part, point, opened), open_loop=poles == 0) for point in range(D.points)]
        asked = part.requirements or Requirements(name)
        asked = asked if asked.unstable_poles is not None else replace(asked, unstable_poles=poles)
        checked = check_loops(plants, C, asked)
        verdict = checked.verdict
        if verdict.unstable:
            at = verdict.unstable[0]
            inner = verdict.margins[at]
            return None, f"inner loop {name} is {inner.stable} at {at}: {inner.stability_reason}"
        verdicts[name], calmed = verdict, calmed | here
        integrators += max(0, min((one.integrators or 0) for one in checked.loops) + C.integrators())
    return _Closings(verdicts, calmed, integrators), ""


def _poles(D: Diagram, calmed: frozenset[str], among: frozenset[str] | None = None) -> int | None:
    """Unstable poles of the plants (`among` some), but those that closed loops hold; None where they are not known."""
    mine = [p for p in D.parts if p.plants and p.name not in calmed and (among is None or p.name in among)]
    counts = [_own_poles(one) for one in mine]
    return None if None in counts else sum(count for count in counts if count is not None)


def _own_poles(part: Part) -> int | None:
    """Unstable poles of a plant: declared, none in open loop, or counted of the recorded loop; None where unknown."""
    if part.unstable_poles is not None:
        return part.unstable_poles
    counts: set[int | None] = set()
    for frf in part.plants:
        if frf.open_loop:
            counts.add(0)
        elif frf.recorded_under is not None and frf.response.shape[1:] == (1, 1):
            asked = Requirements(frf.loop, integrators=part.integrators)
            counts.add(loops_of([frf], frf.recorded_under, asked)[0][0].unstable_poles)
        else:
            counts.add(None)
    return counts.pop() if len(counts) == 1 else None


def _integrators_left(D: Diagram, plants: Sequence[FRF], closings: _Closings) -> int:
    """Integrators that the tuned block has to see at least; refuses plants that show fewer."""
    own = sum(max(0, p.what.integrators()) for p in D.parts if isinstance(p.what, Controller) and p.name != D.tuned)
    left = []
    for point, plant in enumerate(plants):
        total = own + sum(_integrators(p, point) for p in D.parts if p.plants)
        left.append(max(0, total - closings.integrators))
        seen = _seen(plant)
        if seen is not None and seen < left[-1]:
            raise hidden(left[-1], seen, D.tuned)
    return max(left)


def _seen(frf: FRF) -> int | None:
    """Integrators that the lowest lines of an FRF show, None where they do not tell."""
    unity = controller(gain(1.0), rate_hz=frf.rate_hz or 10.0 * float(frf.frequency_hz[-1]))
    return loops_of([frf], unity, Requirements(frf.loop), counted=False)[0][0].integrators


def _integrators(part: Part, point: int) -> int:
    """A plant's integrators: declared, else the most that one of its elements shows."""
    if part.integrators is not None:
        return part.integrators
    frf = part.plants[min(point, len(part.plants) - 1)]
    ny, nu = frf.response.shape[1:]
    read = [_seen(pick(frf, [i], [k])) for i in range(ny) for k in range(nu)]
    return max(0, *[0 if one is None else one for one in read])
