"""A measured plant between its lines and beyond them, as a linear function of what was measured."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from loopshape.core.units import Array, ComplexArray
from loopshape.data.frf import FRF

#: slope with which a plant is taken to fall above its highest frequency
ABOVE = 2.0


@dataclass(frozen=True)
class Continued:
    """A plant (nf,) on other frequencies: ln P straight over ln f between the lines of its FRF.

    Below the lowest line it goes on along its integrators, above the highest it falls as 1/f². `line` (nf,) is the line
    below each frequency, `share` (nf,) that line's part of ln P there; the next line has the rest.
    """

    response: ComplexArray
    line: np.ndarray
    share: Array

    def spread(self, relative: ComplexArray) -> ComplexArray:
        """Relative errors (..., lines) of the FRF on these frequencies (..., nf)."""
        return np.asarray(self.share * relative[..., self.line] + (1.0 - self.share) * relative[..., self.line + 1])

    def gathered(self, pull: ComplexArray, lines: int) -> ComplexArray:
        """How each line's relative error (lines,) pulls a sum over these frequencies: the adjoint of `spread`."""
        each = np.zeros(lines, dtype=complex)
        np.add.at(each, self.line, self.share * pull)
        np.add.at(each, self.line + 1, (1.0 - self.share) * pull)
        return each

    def bias(self, variance: Array) -> Array:
        """Relative variance (nf,) here of lines whose relative errors have this variance (lines,), by themselves."""
        return np.asarray(self.share**2 * variance[self.line] + (1.0 - self.share) ** 2 * variance[self.line + 1])


def continued(plant: FRF, f: Array, integrators: int) -> Continued:
    """The plant (1 x 1, two lines at least) on rising frequencies (nf,) above 0."""
    x, ends = np.log(f), np.log(plant.frequency_hz)
    k = np.clip(np.searchsorted(ends, x, side="right") - 1, 0, ends.size - 2)
    share = np.clip((ends[k + 1] - x) / (ends[k + 1] - ends[k]), 0.0, 1.0)
    logs = np.log(np.abs(plant.siso)) + 1j * np.unwrap(np.angle(plant.siso))
    slope = np.where(x < ends[0], float(integrators), np.where(x > ends[-1], ABOVE, 0.0))
    edge = np.where(x < ends[0], ends[0], ends[-1])
    inside = share * logs[k] + (1.0 - share) * logs[k + 1]
    return Continued(np.asarray(np.exp(inside + slope * (edge - x))), k, share)
