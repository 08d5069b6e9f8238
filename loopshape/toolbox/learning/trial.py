"""A trial of a repeated move: what its recordings show of the error, and the feedforward that the next one is given."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

from loopshape.core.json_ready import Plain, keys
from loopshape.core.units import Array


@dataclass(frozen=True, eq=False)
class NextTrial(Plain):
    """What learning makes of a recorded trial: `feedforward` (n,) at the plant's input, in `unit`, for the next one.

    `error_rms` is that of the recorded error. Of several repetitions `repeated_rms` is that of what they have in common
    and `scatter_rms` (None of one repetition) that of the rest, which nothing can learn. `expected_rms` is the next
    trial's: each frequency of the error times the learning's `factor`, what lies above the band as it is, and the
    scatter. That holds for a linear loop whose FRF is right, until what is left lies at the band's end alone.
    """

    IN_JSON: ClassVar[Mapping[str, str]] = keys(
        "loop", "unit", "rate_hz", "repetitions", "error_rms", "repeated_rms", "scatter_rms", "expected_rms"
    )

    feedforward: Array
    unit: str
    rate_hz: float
    loop: str
    repetitions: int
    error_rms: float
    repeated_rms: float
    scatter_rms: float | None
    expected_rms: float

    def __repr__(self) -> str:
        """One line: the error of this trial and of the next."""
        apart = "" if self.scatter_rms is None else f", {self.scatter_rms:.3g} of it not repeated"
        return f"NextTrial: error rms {self.error_rms:.4g}{apart}; next {self.expected_rms:.4g} expected"
