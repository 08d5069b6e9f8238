"""What a new controller is predicted to do: one loop at one operating point, its sensitivity from a measured FRF."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from loopshape.core.errors import WrongUseError
from loopshape.core.json_ready import Plain, keys
from loopshape.core.outcomes import ClosedLoop, Settling
from loopshape.core.units import Array, db
from loopshape.data.control.controller import Controller
from loopshape.data.response.frf import FRF


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


@dataclass(frozen=True, eq=False)
class Prediction(Plain):
    """What one controller will make of one loop at one operating point.

    `sensitivity` is S as a 1 x 1 FRF on the plant's valid lines, with the plant's covariance carried through
    (|dS| = |C S²| |dP|, to first order) and `recorded_under` the controller. `stability` is the count's word on
    the same lines: where it is not "stable" the rest says little. `step` is None without a usable fit.
    """

    IN_JSON = keys(
        "loop", "recording", operating_point="sensitivity.operating_point", parameters="sensitivity.parameters",
        stability="stability", step="step", notes="notes",
    )  # fmt: skip

    sensitivity: FRF
    stability: ClosedLoop
    step: Step | None = None
    notes: tuple[str, ...] = ()

    @property
    def controller(self) -> Controller:
        """The controller that is predicted."""
        if self.sensitivity.recorded_under is None:
            raise WrongUseError("a prediction names its controller", "none")
        return self.sensitivity.recorded_under

    @property
    def complementary(self) -> FRF:
        """T = 1 - S, of the same covariance."""
        return replace(self.sensitivity, response=1.0 - self.sensitivity.response)

    @property
    def peaks_db(self) -> tuple[float, float]:
        """Largest |S| and |T| over the valid lines, in dB."""
        return float(db(self.sensitivity.response).max()), float(db(self.complementary.response).max())

    @property
    def loop(self) -> str:
        """Name of the loop."""
        return self.sensitivity.loop

    @property
    def recording(self) -> str:
        """The recording that it was predicted from."""
        return self.sensitivity.recording
