"""An effect sheet: what one effect does to a plant's FRFs and time responses, beside the plant without it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from loopshape.core.units import Array, ComplexArray, db, deg
from loopshape.toolbox.gap.nouns.effect import EffectForm


@dataclass(frozen=True, eq=False)
class FrfChange:
    """One path's FRF (nf,) without and with the effect, on lines that both recordings know; `noise` is relative.

    Both come from recordings through one estimator; `noise` (nf,) is the standard deviation of their quotient.
    """

    frequency_hz: Array
    without: ComplexArray
    changed: ComplexArray
    noise: Array

    @property
    def ratio(self) -> ComplexArray:
        """With over without, (nf,)."""
        return np.asarray(self.changed / self.without)

    @property
    def gain_db(self) -> Array:
        """With over without, dB, (nf,)."""
        return np.asarray(db(self.ratio))

    @property
    def phase_deg(self) -> Array:
        """Phase of with over without, deg, (nf,), within a turn."""
        return np.asarray(deg(np.angle(self.ratio)))

    def between(self, low_hz: float, high_hz: float) -> FrfChange:
        """The same from one frequency to another."""
        rows = (self.frequency_hz >= low_hz) & (self.frequency_hz <= high_hz)
        return FrfChange(self.frequency_hz[rows], self.without[rows], self.changed[rows], self.noise[rows])

    @property
    def size(self) -> float:
        """Rms of |with/without - 1| over the lines, what noise gives taken off; nan without lines."""
        if not self.frequency_hz.size:
            return float("nan")
        power = np.mean(np.abs(self.ratio - 1.0) ** 2 - self.noise**2)
        return float(np.sqrt(max(float(power), 0.0)))


@dataclass(frozen=True, eq=False)
class TimeChange:
    """A signal (n,) over `x` (n,), time in s or a setpoint, without and with the effect."""

    x: Array
    without: Array
    changed: Array

    @property
    def largest(self) -> float:
        """Largest difference; nan where nothing was recorded."""
        return float(np.abs(self.changed - self.without).max()) if self.x.size else float("nan")


@dataclass(frozen=True, eq=False)
class EffectSheet:
    """One effect at one magnitude. `frfs` by recording and path, `times` by recording and signal.

    `distortion` by recording, path and kind ("odd", "even") is in dB re the linear response at low frequency, without
    and with the effect. `ended` says which recordings ended early, and why.
    """

    form: EffectForm
    magnitude: float
    frfs: Mapping[tuple[str, str], FrfChange]
    times: Mapping[tuple[str, str], TimeChange]
    distortion: Mapping[tuple[str, str, str], tuple[float, float]] = field(default_factory=dict)
    ended: tuple[str, ...] = ()
