"""A cascade: the inner loop closed by its controller, and what the outer loop then meets.

```
 r2 ->(+)-> C2 -> r1 ->(+)-> C1 -> u -> G --+--> y2
       ^-               ^-                  |
       |                +------- y1 --------+
       +-------------------- y2 ------------+
```
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from loopshape.core.errors import WrongUseError
from loopshape.data.algebra import channels
from loopshape.data.algebra.propagation import Term, result
from loopshape.data.controller import Controller
from loopshape.data.frf import FRF
from loopshape.data.requirements import Requirements
from loopshape.data.verdict import Verdict
from loopshape.loop.verdict import check


@dataclass(frozen=True, eq=False)
class Cascade:
    """The plants of the outer loop, from the inner loop's reference to the outer output, and the inner loop's verdict.

    `outer` holds one FRF for each operating point: with the inner loop certified stable they have no unstable pole, and
    are tuned and checked as any plant.
    """

    outer: tuple[FRF, ...]
    inner: Verdict

    def __repr__(self) -> str:
        """One line: how many operating points, and the inner loop's outcome."""
        points = f"{len(self.outer)} operating point{'s' * (len(self.outer) != 1)}"
        return f"Cascade: {points}, inner loop {self.inner.outcome}"


def cascade(
    G: FRF | Sequence[FRF], inner: Controller, requirements: Requirements | None = None, *, loop: str = "outer"
) -> Cascade:
    """Close an inner loop and find the plant that the outer loop's controller meets.

    `G` is measured from the one actuator to both sensors at once, outputs in the order (inner, outer), one FRF for each
    operating point. The outer plant is G2 C1/(1 + C1 G1); its covariance is that of both measurements together, to
    first order, so what they share is not counted twice. `requirements` are the inner loop's, which has to be stable
    with the outer one open. Once the outer loop is certified stable too, the whole is.

    Refuses other than two outputs and one input, and an inner loop that is not certified stable. Misleads where the
    inner controller limits its output, or runs at another rate than the outer one.

    >>> import control, numpy as np, loopshape as ls
    >>> motor, load = control.tf([50.0], [1.0, 10.0]), control.tf([50.0], [1.0, 10.0, 0.0])
    >>> G = ls.FRF.from_control(control.combine_tf([[motor], [load]]), np.geomspace(0.1, 100.0, 80), rate_hz=1e3)
    >>> C1 = ls.controller(ls.gain(2.0), ls.pi(1.0), rate_hz=1e3)
    >>> ls.cascade(G, C1, ls.Requirements(unstable_poles=0))
    Cascade: 1 operating point, inner loop passed
    """
    every = (G,) if isinstance(G, FRF) else tuple(G)
    for one in every:
        if one.response.shape[1:] != (2, 1):
            raise WrongUseError(
                "a cascade is measured from one actuator to two sensors",
                f"{one.response.shape[1]} outputs and {one.response.shape[2]} inputs",
                "pick them in the order (inner, outer)",
            )
    asked = requirements or Requirements(inner.loop)
    verdict = check([channels(one, one.outputs[:1]) for one in every], inner, asked)
    if verdict.unstable:
        name = verdict.unstable[0]
        raise WrongUseError(
            "the inner loop of a cascade must be certified stable with the outer one open",
            f"{verdict.margins[name].stable} at {name}: {verdict.margins[name].stability_reason}",
            "tune it first, or declare integrators and unstable_poles",
        )
    return Cascade(tuple(outer_plant(one, inner, loop) for one in every), verdict)


def outer_plant(G: FRF, inner: Controller, loop: str = "outer") -> FRF:
    """G2 C1/(1 + C1 G1) below half the controller's rate, with d = C1 S1 (dG2 - outer dG1)."""
    G = G.select(G.frequency_hz < 0.5 * inner.rate_hz)
    C = inner.response(G.frequency_hz)
    through = C / (1.0 + C * G.response[:, 0, 0])
    outer = through * G.response[:, 1, 0]
    left = np.stack([-outer * through, through], axis=1)[:, None, :]
    term = Term(G, left, np.ones((outer.size, 1, 1), dtype=complex))
    made = result("inner loop closed", outer[:, None, None], G.outputs[1:], (f"reference of {G.outputs[0]}",), [term])
    note = f"the inner loop {inner.loop or G.outputs[0]} is closed, and certified stable"
    return replace(made, loop=loop, rate_hz=inner.rate_hz, open_loop=True, notes=(*made.notes, note))
