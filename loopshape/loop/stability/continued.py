"""A measured plant between its lines and beyond them, as a linear function of what was measured."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from loopshape.core.units import Array, ComplexArray
from loopshape.data.response.frf import FRF
from loopshape.loop.stability.low_end import low_order

T = TypeVar("T", Array, ComplexArray)
#: slope with which a plant is taken to fall above its highest frequency
ABOVE = 2.0


@dataclass(frozen=True)
class Continued:
    """A plant (nf,) on other frequencies: ln P straight over ln f between the lines of its FRF.

    Below the lowest line it goes on along its integrators, its phase with them; above the highest it falls as 1/f².
    `line` (nf,) is the line below each frequency, `share` (nf,) that line's part of ln P there; the next has the rest.
    """

    response: ComplexArray
    line: np.ndarray
    share: Array

    def spread(self, relative: ComplexArray) -> ComplexArray:
        """Relative errors (..., lines) of the FRF on these frequencies (..., nf)."""
        return np.asarray(self.share * relative[..., self.line] + (1.0 - self.share) * relative[..., self.line + 1])

    def collected(self, pull: ComplexArray, lines: int) -> ComplexArray:
        """How each line's relative error (lines,) pulls a sum over these frequencies: the adjoint of `spread`."""
        each = np.zeros(lines, dtype=complex)
        np.add.at(each, self.line, self.share * pull)
        np.add.at(each, self.line + 1, (1.0 - self.share) * pull)
        return each

    def bias(self, variance: T) -> T:
        """Relative covariance (nf, ...) here of lines whose relative errors have this one (lines, ...)."""
        share = self.share.reshape(-1, *(1,) * (variance.ndim - 1))
        return share**2 * variance[self.line] + (1.0 - share) ** 2 * variance[self.line + 1]


def continued(plant: FRF, f: Array, integrators: int, *, smooth: bool = False) -> Continued:
    """The plant (1 x 1, two lines at least) on rising frequencies (nf,) above 0; a `smooth` one by a spline."""
    from scipy.interpolate import CubicSpline

    x, ends = np.log(f), np.log(plant.frequency_hz)
    k, share = between(f, plant.frequency_hz)
    logs = np.log(np.abs(plant.siso)) + 1j * np.unwrap(np.angle(plant.siso))
    slope = np.where(x < ends[0], float(integrators), np.where(x > ends[-1], ABOVE, 0.0))
    edge = np.where(x < ends[0], ends[0], ends[-1])
    straight = share * logs[k] + (1.0 - share) * logs[k + 1]
    inside = CubicSpline(ends, logs)(np.clip(x, ends[0], ends[-1])) if smooth else straight
    turned = 1j * _excess(plant.siso[0], integrators) * np.minimum(np.exp(x - ends[0]) - 1.0, 0.0)
    return Continued(np.asarray(np.exp(inside + slope * (edge - x) + turned)), k, share)


def between(f: Array, lines_hz: Array) -> tuple[np.ndarray, Array]:
    """The line below each frequency (nf,), and its share of ln P there, straight over ln f; at an end that line."""
    x, ends = np.log(f), np.log(lines_hz)
    k = np.clip(np.searchsorted(ends, x, side="right") - 1, 0, ends.size - 2)
    return k, np.asarray(np.clip((ends[k + 1] - x) / (ends[k + 1] - ends[k]), 0.0, 1.0))


def _excess(lowest: complex, integrators: int) -> float:
    """Phase in rad of the lowest line beyond its integrators' (of either sign): it vanishes in proportion to f."""
    beyond = float(np.angle(lowest * 1j**integrators))
    return beyond - np.pi * round(beyond / np.pi)


def integrators_of(lines: FRF) -> int:
    """Slope of the lowest lines (a factor of 1.6 in frequency, four at least) in 20 dB a decade, to the next whole."""
    return max(0, round(low_order(lines)[1]))
