"""What noise does to a smoothed response: draws of its error, the same for every controller."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from loopshape.units import ComplexArray


@dataclass(frozen=True, eq=False)
class Scatter:
    """Draws of the error of a response on its lines, about a reference.

    What a nonlinear reading (a margin, a peak) suffers from noise is seen by reading `reference` + each of the
    `deviations` (draws, nf) against reading `reference` (nf,): its bias and its spread.
    """

    reference: ComplexArray
    deviations: ComplexArray

    def __post_init__(self) -> None:
        for name in ("reference", "deviations"):
            copy = np.array(getattr(self, name))
            copy.setflags(write=False)
            object.__setattr__(self, name, copy)
