"""A loop: a measured plant and a controller, and everything that follows from L = C P.

The picture that every docstring refers to, with its signs:

        n (controller_input)         n (plant_input)
              v                            v
 r --->(+)-->(+)--> C ----------> z ----->(+)--> [decoupling, PWM, plant] --+--> y
        ^ -                                                                 |
        +-------------------------------------------------------------------+

e = r - y (+ n) enters C; z is what C answers; P goes from what enters the plant to y. With L = C P:
S = 1/(1 + L), T = L/(1 + L), CS = C/(1 + L), PS = P/(1 + L).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from loopshape.controller import Controller
from loopshape.frf import FRF
from loopshape.units import Array, ComplexArray


@dataclass(frozen=True, eq=False)
class Loop:
    """One plant FRF (1 x 1) under one controller; responses (nf,) on the FRF's lines.

    `integrators` is the number of poles of the plant at s = 0, `unstable_poles` in the right half plane;
    the data alone do not show them, they come from the fit or from the user.
    """

    plant: FRF
    controller: Controller
    integrators: int = 0
    unstable_poles: int = 0

    @property
    def frequency_hz(self) -> Array:
        """The FRF's lines in Hz."""
        return self.plant.frequency_hz

    @property
    def C(self) -> ComplexArray:
        """Controller as it runs, discretised."""
        return self.controller.response(self.frequency_hz)

    @property
    def L(self) -> ComplexArray:
        """Open loop C P."""
        return self.C * self.plant.siso

    @property
    def S(self) -> ComplexArray:
        """Sensitivity."""
        return np.asarray(1.0 / (1.0 + self.L))

    @property
    def T(self) -> ComplexArray:
        """Complementary sensitivity."""
        return self.L * self.S

    @property
    def CS(self) -> ComplexArray:
        """Control sensitivity."""
        return self.C * self.S

    @property
    def PS(self) -> ComplexArray:
        """Process sensitivity."""
        return self.plant.siso * self.S
