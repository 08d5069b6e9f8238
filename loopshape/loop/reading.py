"""What the kernel of margins has to know of the requirements, and its one call."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from loopshape.core.kernels import margins as kernel
from loopshape.core.units import Array, ComplexArray
from loopshape.data.limits_over import Mask, weights
from loopshape.data.requirements import Requirements


@dataclass(frozen=True)
class Reader:
    """Reads margins off lines: |CS| counts as high from `from_hz` on, and responses are compared with `masks`."""

    from_hz: float = np.inf
    masks: tuple[Mask, ...] = ()

    @classmethod
    def of(cls, requirements: Requirements) -> Reader:
        """A reader for the requirements at one operating point."""
        return cls(requirements.control_high_frequency_from_hz or np.inf, requirements.masks)

    def read(
        self, f: Array, L: ComplexArray, C: ComplexArray, above_hz: Array, C_above: ComplexArray,
        *, bounded: bool = True,
    ) -> tuple[Array, Array]:  # fmt: skip
        """Columns (loops, columns) of the kernel for open loops L (loops, nf) under C (nf,), and where they lie in Hz.

        What |L| may do above the last line counts where `bounded`.
        """
        over, over_above = weights(self.masks, f), weights(self.masks, above_hz)
        f, L, C, above_hz, C_above = _seen(f, L, C, above_hz, C_above)
        return kernel.read_margins(f, L, C, above_hz, C_above, self.from_hz, bounded, over, over_above)

    def read_drawn(
        self, f: Array, reference: ComplexArray, factor: ComplexArray, draws: ComplexArray, C: ComplexArray,
        above_hz: Array, C_above: ComplexArray, *, bounded: bool = True,
    ) -> Array:  # fmt: skip
        """Columns (draws, columns) for `reference` (nf,) and `factor` (nf,) times each of `draws` (draws, nf)."""
        over, over_above = weights(self.masks, f), weights(self.masks, above_hz)
        f, reference, factor, draws, C = _seen(f, reference, factor, draws, C)
        above_hz, C_above = _seen(above_hz, C_above)
        return kernel.read_drawn(
            f, reference, factor, draws, C, above_hz, C_above, self.from_hz, bounded, over, over_above
        )


def _seen(*arrays: np.ndarray) -> list[np.ndarray]:
    """Arrays as the kernels are compiled for them, read-only."""
    views = [x.view() for x in arrays]
    for x in views:
        x.setflags(write=False)
    return views
