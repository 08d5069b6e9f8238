"""What is read off steps, predicted or recorded; defined in `Indicators`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from loopshape.core.outcomes import Settling
from loopshape.core.units import Array
from loopshape.data.result.step import INDICATORS, Indicators

#: share of what was seen whose mean is the final value, and share over which a settled response stays in its band
END, STAYS = 0.1, 0.2


def indicators(time_s: Array, response: Array, *, floor: float = 0.0, final: float | None = None) -> Indicators:
    """Indicators of an answer (n,) to a unit step at time 0, from rest at 0; `time_s` (n,) begins at 0.

    `final` is y1 where it is known (of a model), else the mean of the last tenth. `floor` is how far the response
    moves by itself, by noise: narrower bands cannot be seen and are widened to it, and no smaller overshoot counts.
    """
    y1 = float(np.mean(response[-max(1, round(END * response.size)) :])) if final is None else final
    if abs(y1) < 1e-9:
        nan = float("nan")
        return Indicators(nan, nan, nan, nan, 1.0, Settling.NOT_SETTLED)
    y, floor = response / y1, floor / abs(y1)
    stays = np.abs(y[-max(1, round(STAYS * y.size)) :] - 1.0) <= max(0.02, floor)
    overshoot = float(y.max()) - 1.0
    return Indicators(
        rise_time_s=_first(time_s, y, 0.9) - _first(time_s, y, 0.1),
        settling_time_s=_settled_from(time_s, y, max(0.02, floor)),
        settling_time_5_s=_settled_from(time_s, y, max(0.05, floor)),
        overshoot=overshoot if overshoot > floor else 0.0,
        steady_state_error=1.0 - y1,
        outcome=Settling.SETTLED if stays.all() else Settling.NOT_SETTLED,
    )


def _first(time_s: Array, y: Array, level: float) -> float:
    """When y first reaches a level, nan where it never does."""
    reached = np.flatnonzero(y >= level)
    if not reached.size:
        return float("nan")
    k = int(reached[0])
    return float(time_s[0]) if k == 0 else _between(time_s, y, level, k - 1)


def _between(time_s: Array, y: Array, level: float, k: int) -> float:
    share = (level - y[k]) / (y[k + 1] - y[k])
    return float(time_s[k] + share * (time_s[k + 1] - time_s[k]))


def _settled_from(time_s: Array, y: Array, band: float) -> float:
    """From when on |y - 1| stays within the band; nan where it leaves it within the last fifth of what was seen."""
    outside = np.flatnonzero(np.abs(y - 1.0) > band)
    if not outside.size:
        return float(time_s[0])
    k = int(outside[-1])
    if k >= y.size - max(1, round(STAYS * y.size)):
        return float("nan")
    return _between(time_s, np.abs(y - 1.0), band, k)


def with_intervals(nominal: Indicators, drawn: Sequence[Indicators]) -> Indicators:
    """The nominal indicators with the 2.5 and 97.5 % quantiles of draws; one that does not settle counts as never."""
    found: dict[str, tuple[float, float]] = {}
    for name in INDICATORS:
        values = np.array([getattr(one, name) for one in drawn])
        values = np.where(np.isnan(values), np.inf, values)
        low, high = np.quantile(values, [0.025, 0.975], method="closest_observation")
        found[name] = (float(low), float(high))
    return replace(nominal, intervals=found)
