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
from functools import cached_property
from typing import TypeVar

import numpy as np

from loopshape.core.units import TWO_PI, Array, ComplexArray
from loopshape.data.control.controller import Controller
from loopshape.data.response.frf import FRF
from loopshape.data.response.model import TransferFunction
from loopshape.data.response.smoothed import Scatter

#: lines above the band known to this share of their size, at the end of their circle, tell what |L| is there
KNOWN_ABOVE = 0.2
Values = TypeVar("Values", bound=np.ndarray)


def above_hz(last_hz: float, rate_hz: float, count: int = 80) -> Array:
    """Logarithmic grid above a last line, up to 0.45 times the rate; none where the line lies beyond."""
    return np.geomspace(last_hz, 0.45 * rate_hz, count)[1:] if last_hz < 0.45 * rate_hz else np.zeros(0)


def known_above(beyond: FRF) -> np.ndarray:
    """Which lines above those used (n,) are known well enough to tell what |L| is there.

    Not those of the valid band, which only requirements that narrow it leave out, and a note says so.
    """
    known = np.sqrt(beyond.variance[:, 0, 0]) < KNOWN_ABOVE * np.abs(beyond.siso)
    return np.asarray(known & ~beyond.trusted)


def reach_above(beyond: FRF) -> Array:
    """Radius (n,) of the 95 % circles of lines above those used; their responses lie at the circles' far ends."""
    return np.asarray(np.sqrt(-np.log(0.05) * beyond.variance[:, 0, 0]))


def _kept(values: Values) -> Values:
    values.setflags(write=False)
    return values


@dataclass(frozen=True, eq=False)
class Loop:
    """One plant FRF (1 x 1) under one controller; responses (nf,) on the FRF's lines.

    `integrators` is the number of poles of the plant at s = 0, `unstable_poles` in the right half plane (None: not
    known); the data alone do not show them, they come from the recorded loop, a fit or the user. `model`, where there
    is a fit, says how the plant goes on below the lowest line; only the count of encirclements uses it. `beyond` holds
    lines above those that are used, less sure: they may still show that |L| comes up again. Where `plant` was
    smoothed over its lines, `raw` are these as they were measured, and `scatter` draws what noise does to `plant`.
    """

    plant: FRF
    controller: Controller
    integrators: int | None = 0
    unstable_poles: int | None = None
    model: TransferFunction | None = None
    beyond: FRF | None = None
    raw: FRF | None = None
    scatter: Scatter | None = None

    @property
    def frequency_hz(self) -> Array:
        """The FRF's lines in Hz."""
        return self.plant.frequency_hz

    @cached_property
    def C(self) -> ComplexArray:
        """Controller as it runs, discretised."""
        return _kept(self.controller.response(self.frequency_hz))

    @cached_property
    def L(self) -> ComplexArray:
        """Open loop C P."""
        return _kept(self.C * self.plant.siso)

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

    @cached_property
    def above_hz(self) -> Array:
        """Frequencies from the last line to nine tenths of half the rate, where no line was measured."""
        return _kept(above_hz(float(self.frequency_hz[-1]), self.controller.rate_hz))

    @cached_property
    def C_above(self) -> ComplexArray:
        """Controller on `above_hz`."""
        return _kept(self.controller.response(self.above_hz))

    @cached_property
    def largest_above(self) -> float:
        """How far towards -1 lines above those used may reach that are known to `KNOWN_ABOVE`; 0 where none does.

        1 less the smallest distance of their 95 % circles to -1: where L passes the negative real axis there, its size.
        """
        if self.beyond is None:
            return 0.0
        f, P, reach = self.beyond.frequency_hz, self.beyond.siso, reach_above(self.beyond)
        rows = (reach < np.abs(P)) & known_above(self.beyond) & (f < 0.5 * self.controller.rate_hz)
        C = self.controller.response(f[rows])
        middle = C * P[rows] * (1.0 - reach[rows] / np.abs(P[rows]))
        return float(np.max(1.0 - np.abs(1.0 + middle) + np.abs(C) * reach[rows], initial=0.0))

    @property
    def below_hz(self) -> Array:
        """Three decades of frequencies below the lowest line, where only a model tells; none without one.

        Dense about each of the model's poles and zeros there: a sharp resonance must not be stepped over.
        """
        if self.model is None:
            return np.zeros(0)
        lowest = float(self.frequency_hz[0])
        grid = [np.geomspace(1e-3 * lowest, lowest, 60, endpoint=False)]
        for root in np.concatenate([self.model.poles(), np.roots(self.model.num)]):
            centre, width = abs(root.imag) / TWO_PI, max(abs(root.real) / TWO_PI, 1e-9)
            if centre > 0.0:
                grid.append(centre + width * np.sinh(np.linspace(-6.0, 6.0, 61)) / 20.0)
        every = np.unique(np.concatenate(grid))
        return every[(every >= 1e-3 * lowest) & (every < lowest)]

    @property
    def P_below(self) -> ComplexArray:
        """The model's response on `below_hz`."""
        return np.zeros(0, dtype=complex) if self.model is None else self.model.response(self.below_hz)
