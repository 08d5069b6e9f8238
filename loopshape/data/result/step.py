"""Steps of a closed loop, and what is read off them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from loopshape.core.errors import WrongUseError
from loopshape.core.json_ready import Plain, keys
from loopshape.core.outcomes import Settling
from loopshape.core.units import Array


@dataclass(frozen=True)
class Indicators:
    """What is read off a step of the setpoint from r0 to r1, with y0 the output before it and y1 where it ends.

    - `rise_time_s`: from 10 % to 90 % of the way from y0 to y1, between samples by straight lines;
    - `settling_time_s`, `settling_time_5_s`: from the step until y stays within 2 % (5 %) of |y1 - y0| of y1;
    - `overshoot`: how far y goes beyond y1, over |y1 - y0|; 0 where it does not;
    - `steady_state_error`: (r1 - y1)/(r1 - r0).

    `outcome` is "settled", or "not settled" where y does not stay within 2 % for the last fifth of what was seen: then
    y1 is no final value, and the numbers describe the time seen only. A time that is not reached by then is nan.
    `intervals` are 95 % intervals by field name, empty where the spread is not known.
    """

    rise_time_s: float
    settling_time_s: float
    settling_time_5_s: float
    overshoot: float
    steady_state_error: float
    outcome: Settling = Settling.SETTLED
    intervals: Mapping[str, tuple[float, float]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        object.__setattr__(self, "outcome", Settling(self.outcome))


#: fields of `Indicators` with their units, in the order of tables
INDICATORS = {
    "rise_time_s": "s", "settling_time_s": "s", "settling_time_5_s": "s", "overshoot": "1", "steady_state_error": "1",
}  # fmt: skip


@dataclass(frozen=True, eq=False)
class Step(Plain):
    """Answer (n,) to a unit step of the setpoint at time 0, with its pointwise 95 % band (n,), and what is read off it.

    `source` says what it rests on ("fit" or "FRF"); the band is that source's spread and nothing else: it does not
    know how wrong a model's structure is. `unsettled` is the share of draws that did not settle.
    """

    IN_JSON = keys("source", "unsettled", "notes", "indicators")

    time_s: Array
    response: Array
    low: Array
    high: Array
    indicators: Indicators
    source: str
    unsettled: float = 0.0
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        for name in ("time_s", "response", "low", "high"):
            copy = np.array(getattr(self, name), dtype=float)
            copy.setflags(write=False)
            object.__setattr__(self, name, copy)
        shapes = {np.shape(getattr(self, name)) for name in ("time_s", "response", "low", "high")}
        if len(shapes) != 1 or len(next(iter(shapes))) != 1:
            raise WrongUseError("a step has a time, a value and both ends of its band at each sample", f"{shapes}")
