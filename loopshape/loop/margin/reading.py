"""What the kernel of margins has to know of the requirements, and its one call."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from loopshape.core.kernels.loops import margins as kernel
from loopshape.core.units import Array, ComplexArray
from loopshape.data.requirement.limits_over import Mask
from loopshape.data.requirement.requirements import Requirements
from loopshape.data.requirement.weight import Weight, over


@dataclass(frozen=True)
class Reader:
    """Reads margins off lines: |CS| counts as high from `from_hz` on, responses are compared with `masks`,
    and their norm is that of `weights`."""

    from_hz: float = np.inf
    masks: tuple[Mask, ...] = ()
    weights: tuple[Weight, ...] = ()

    @classmethod
    def of(cls, requirements: Requirements) -> Reader:
        """A reader for the requirements at one operating point."""
        return cls(requirements.control_high_frequency_from_hz or np.inf, requirements.masks, requirements.weights)

    def read(
        self, f: Array, L: ComplexArray, C: ComplexArray, above_hz: Array, C_above: ComplexArray,
        *, bounded: bool = True, least: float = 0.0,
    ) -> tuple[Array, Array]:  # fmt: skip
        """Columns (loops, columns) of the kernel for open loops L (loops, nf) under C (nf,), and where they lie in Hz.

        What |L| may do above the last line counts where `bounded`: it stays below its last value, or `least`.
        """
        f, L, C, above_hz, C_above = _seen(f, L, C, above_hz, C_above)
        over, over_above = self._over(f, above_hz)
        return kernel.read_margins(f, L, C, above_hz, C_above, self.from_hz, bounded, over, over_above, True, least)

    def read_drawn(
        self, f: Array, reference: ComplexArray, factor: ComplexArray, draws: ComplexArray, C: ComplexArray,
        above_hz: Array, C_above: ComplexArray, *, bounded: bool = True, least: float = 0.0,
    ) -> Array:  # fmt: skip
        """Columns (draws, columns) for `reference` (nf,) and `factor` (nf,) times each of `draws` (draws, nf)."""
        f, reference, factor, draws, C = _seen(f, reference, factor, draws, C)
        over, over_above = self._over(f, above_hz)
        above_hz, C_above = _seen(above_hz, C_above)
        return kernel.read_drawn(
            f, reference, factor, draws, C, above_hz, C_above, self.from_hz, bounded, over, over_above, least
        )

    def _over(self, f: Array, above_hz: Array) -> list[Array]:
        """What weighs squared magnitudes on the lines and above them; no rows where nothing does."""
        rows = None if self.masks or self.weights else 0
        return _seen(*(over(self.masks, self.weights, x)[:rows] for x in (f, above_hz)))


def _seen(*arrays: np.ndarray) -> list[np.ndarray]:
    """Arrays as the kernels are compiled for them, read-only."""
    views = [x.view() for x in arrays]
    for x in views:
        x.setflags(write=False)
    return views
