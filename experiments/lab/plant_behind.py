"""The plant that a measured sensitivity shows: what studies and tests compare predictions with."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from loopshape.core.errors import WrongUseError
from loopshape.data.response.frf import FRF


def plant_behind(sensitivity: FRF, input_column: str) -> FRF:
    """The plant that a measured sensitivity shows, P = (1 - S)/(C S), with C the controller that held the loop.

    A check of it judges the loop that ran: L = (1 - S)/S is as sure as S is, also where the controller lets little
    through and a plant estimated from z and y is not known. Valid where S is.
    """
    held = sensitivity.recorded_under
    if held is None:
        raise WrongUseError("a plant follows from a sensitivity and its controller", "none is known", "name it")
    S, C = sensitivity.siso, held.response(sensitivity.frequency_hz)
    variance = sensitivity.variance[:, 0, 0] / np.abs(C * S * S) ** 2
    return replace(
        sensitivity, response=((1.0 - S) / (C * S))[:, None, None], inputs=(input_column,), coherence=None,
        covariance=np.asarray(variance[:, None, None], dtype=complex), method=f"plant behind {sensitivity.method}",
    )  # fmt: skip
