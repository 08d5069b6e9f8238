"""What has come of a recording: samples in order, without a gap, or a gap that is known."""

from __future__ import annotations

import numpy as np

from loopshape.core.units import Array
from loopshape.toolbox.rig.target.messages import Samples

RATE_TICKS = 10  # a rate is averaged over so many ticks: a converter's step is no alarm


class Intake:
    """A table (ticks, width) that fills from the front; `received` ticks are there, `newest` was seen."""

    def __init__(self, run: int, ticks: int, width: int) -> None:
        self.run, self.received, self.newest = run, 0, 0
        self._table = np.empty((ticks, width))

    def take(self, samples: Samples) -> Array:
        """Add samples; gives those that are new and in place (k, width). What comes after a gap is sent again later."""
        end = samples.first + len(samples.table)
        if samples.run != self.run or end > len(self._table):
            return self._table[:0]
        self.newest = max(self.newest, end)
        if not samples.first <= self.received < end:
            return self._table[:0]
        start = self.received
        self._table[start:end] = samples.table[start - samples.first :]
        self.received = end
        return self._table[start:end]

    @property
    def lacking(self) -> int:
        """Ticks that were seen to be missing."""
        return self.newest - self.received

    @property
    def table(self) -> Array:
        """What is there (received, width)."""
        return self._table[: self.received]

    def passed(
        self, new: int, places: slice, limits: Array, rate_hz: float, grain: float = 2.0**-52
    ) -> tuple[int, int, float, float] | None:
        """The first limit that the last `new` ticks pass: column of `places`, tick, value, limit; None if none is.

        `limits` (columns, 3) low, high and rate a second; a rate counts from RATE_TICKS on. `grain` is the relative
        rounding of what arrived: what the target found within its limits is within them here too. NaN passes them.
        """
        first = max(0, self.received - new)
        values = self._table[max(0, first - RATE_TICKS) : self.received, places]
        mine = values[-(self.received - first) :] if new else values[:0]
        rates = np.abs(values[RATE_TICKS:] - values[:-RATE_TICKS]) * (rate_hz / RATE_TICKS)
        slack = grain * np.abs(limits[:, :2]).max(axis=1)
        blur = slack * 2.0 * rate_hz / RATE_TICKS
        for found, low, high, back in (
            (mine, limits[:, 0] - slack, limits[:, 1] + slack, len(mine)),
            (rates, -np.inf, limits[:, 2] * (1.0 + grain) + blur, len(rates)),
        ):
            over = ~((found >= low) & (found <= high))
            if over.any():
                tick, column = (int(k) for k in np.argwhere(over)[0])
                value = float(found[tick, column])
                bound = float(limits[column, 2 if found is rates else (0 if value < limits[column, 0] else 1)])
                return column, self.received - back + tick, value, bound
        return None
