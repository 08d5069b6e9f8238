"""How a later measurement compares with a prediction: of S, of steps, of a setpoint that moves."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from loopshape.core.json_ready import Plain, keys
from loopshape.core.outcomes import Graded
from loopshape.core.units import Array
from loopshape.data.result.step import Indicators, Step


class Agreement(Graded):
    """What a measurement says of a prediction."""

    CONFIRMED = "confirmed"
    CANNOT_TELL = "cannot tell"
    REFUTED = "refuted"


@dataclass(frozen=True, eq=False)
class Tracking:
    """Error r - y while a setpoint moves: largest and rms, in the loop's unit, and the predicted ones or nan."""

    largest_error: float
    rms_error: float
    predicted_largest_error: float = float("nan")
    predicted_rms_error: float = float("nan")


@dataclass(frozen=True)
class Band:
    """A band of a comparison: its p-value, and by how much S and T came out larger than predicted, in dB.

    The decibels are of the mean ratio over the lines, weighted by what they are known to; `std_db` is the standard
    deviation of that of S. Of two plants `sensitivity_db` is that of |P|.
    """

    low_hz: float
    high_hz: float
    lines: int
    p_value: float
    sensitivity_db: float
    complementary_db: float
    std_db: float


@dataclass(frozen=True)
class Comparison:
    """A prediction against a measurement under its controller, or a plant's FRF against another, over common lines.

    `outcome` is "confirmed", "refuted" (p-value below `level`) or "cannot tell" (the data are too few or too noisy
    to contradict: they would not notice a change of the plant's gain by `noticed_db` four times in five, or less).
    `worst` is the band that differs most. Peaks of |S|, of two plants of |P|, are over the common lines, at face value.
    """

    loop: str
    predicted_from: str
    measured_from: str
    operating_point: Mapping[str, float]
    outcome: Agreement
    p_value: float
    level: float
    lines: int
    bands: tuple[Band, ...]
    noticed_db: float
    tolerance_db: float = 0.0
    predicted_peak_db: float = float("nan")
    measured_peak_db: float = float("nan")
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        object.__setattr__(self, "outcome", Agreement(self.outcome))

    @property
    def worst(self) -> Band | None:
        """The band of the smallest p-value; None where there is no line."""
        return min(self.bands, key=lambda band: band.p_value, default=None)


@dataclass(frozen=True, eq=False)
class StepComparison(Plain):
    """One measured step against the predicted one, both as of a unit step.

    `outside` is the share of samples outside the predicted band, widened by what the sensor's noise leaves;
    `largest_miss` the largest distance from the predicted response itself, of a unit step, `miss_at_s` when.
    """

    IN_JSON = keys(
        "recording", "at_s", "size", "measured", predicted="predicted.indicators", largest_miss="largest_miss",
        miss_at_s="miss_at_s", outside="outside", notes="notes",
    )  # fmt: skip

    recording: str
    loop: str
    operating_point: Mapping[str, float]
    at_s: float
    size: float
    measured: Indicators
    time_s: Array
    response: Array
    predicted: Step | None = None
    outside: float = float("nan")
    largest_miss: float = float("nan")
    miss_at_s: float = float("nan")
    notes: tuple[str, ...] = ()
