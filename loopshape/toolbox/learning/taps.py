"""Feedforward: taps from a setpoint that is known some samples ahead to the plant's input."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from loopshape.core.json_ready import json_ready
from loopshape.core.units import TWO_PI, Array, ComplexArray


@dataclass(frozen=True, eq=False)
class Feedforward:
    """Taps (n,) from the setpoint to the plant's input; `taps[preview]` weighs the setpoint of now.

    u(k) = sum of taps[i] r(k + preview - i), added to what the controller gives out. `inverse_error` (nf,) is |1 - P F|
    on the frequencies of the band with `inverse_high`, the end of its 95 % interval by the FRF's variance.
    """

    taps: Array
    preview: int
    rate_hz: float
    band_hz: tuple[float, float]
    frequency_hz: Array
    inverse_error: Array
    inverse_high: Array
    loop: str = ""

    def __repr__(self) -> str:
        """One line: taps, preview, band and its worst error."""
        low, high = self.band_hz
        return (
            f"Feedforward: {self.taps.size} taps, {self.preview} samples ahead, {low:.4g} to {high:.4g} Hz,"
            f" |1 - P F| at most {self.inverse_error.max():.3g} ({self.inverse_high.max():.3g})"
        )

    def response(self, frequency_hz: ArrayLike) -> ComplexArray:
        """F at frequencies (nf,) in Hz."""
        turn = np.exp(-1j * TWO_PI * np.asarray(frequency_hz, dtype=float) / self.rate_hz)
        return np.asarray(np.polyval(self.taps[::-1], turn) * turn**-self.preview)

    def signal(self, setpoint: ArrayLike) -> Array:
        """What is added to the plant's input (n,) for a setpoint (n,), which rests before and after."""
        r = np.asarray(setpoint, dtype=float)
        behind = self.taps.size - 1 - self.preview
        whole = np.concatenate([np.full(behind, r[0]), r, np.full(self.preview, r[-1])])
        return np.convolve(whole, self.taps, mode="valid")

    def to_dict(self) -> dict[str, Any]:
        """Plain values for JSON."""
        made: dict[str, Any] = json_ready(vars(self), None)
        return made
