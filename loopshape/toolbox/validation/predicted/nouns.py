"""What a new controller is predicted to do: one loop at one operating point, its sensitivity from a measured FRF."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, ClassVar

from loopshape.core.errors import WrongUseError
from loopshape.core.json_ready import Plain, keys
from loopshape.core.outcomes import ClosedLoop
from loopshape.core.units import db
from loopshape.data.control.controller import Controller
from loopshape.data.response.frf import FRF
from loopshape.data.result.step import INDICATORS, Indicators, Step

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True, eq=False)
class Prediction(Plain):
    """What one controller will make of one loop at one operating point.

    `sensitivity` is S as a 1 x 1 FRF on the plant's valid lines, with the plant's covariance carried through
    (|dS| = |C S²| |dP|, to first order) and `recorded_under` the controller. `stability` is the count's word on
    the same lines: where it is not "stable" the rest says little. `step` is None without a usable fit.
    """

    ENDING: ClassVar = ".npz"
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

    def figure(self) -> Figure:
        """|S|, |T| and the step, with their bands."""
        return self.figure_of([self])

    @staticmethod
    def figure_of(predictions: Sequence[Prediction]) -> Figure:
        """The same of one loop at all operating points."""
        from loopshape.toolbox.validation.predicted.picture import prediction_page

        return prediction_page(predictions)

    @property
    def loop(self) -> str:
        """Name of the loop."""
        return self.sensitivity.loop

    @property
    def recording(self) -> str:
        """The recording that it was predicted from."""
        return self.sensitivity.recording


def indicator_texts(read: Indicators) -> list[str]:
    """What was read off a step with its 95 % intervals, shares as percent, in the order of `INDICATORS`."""
    return [_indicator(read, name, 100.0 if unit == "1" else 1.0) for name, unit in INDICATORS.items()]


def _indicator(read: Indicators, name: str, scale: float) -> str:
    value, interval = scale * getattr(read, name), read.intervals.get(name)
    text = f"{value:.3g}" if abs(value) >= 5e-4 else "0"
    if interval is None or scale * (interval[1] - interval[0]) < 5e-4:
        return text
    return f"{text} ({scale * interval[0]:.3g} .. {scale * interval[1]:.3g})"
