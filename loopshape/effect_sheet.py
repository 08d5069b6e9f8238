"""An effect sheet: what one effect does to a plant's FRFs and time responses, beside the plant without it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from loopshape.effect import EffectForm
from loopshape.units import Array, ComplexArray, db, deg


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
    def gain_db(self) -> Array:
        """With over without, dB, (nf,)."""
        return np.asarray(db(self.changed / self.without))

    @property
    def phase_deg(self) -> Array:
        """Phase of with over without, deg, (nf,), within a turn."""
        return np.asarray(deg(np.angle(self.changed / self.without)))

    def between(self, low_hz: float, high_hz: float) -> FrfChange:
        """The same from one frequency to another."""
        rows = (self.frequency_hz >= low_hz) & (self.frequency_hz <= high_hz)
        return FrfChange(self.frequency_hz[rows], self.without[rows], self.changed[rows], self.noise[rows])

    def over(self, other: FrfChange) -> FrfChange:
        """The path from the other's end to this one's, where both begin alike, on common lines."""
        keys = [np.round(x.frequency_hz * 1e7).astype(np.int64) for x in (self, other)]
        a, b = np.isin(keys[0], keys[1]), np.isin(keys[1], keys[0])
        return FrfChange(
            self.frequency_hz[a],
            self.without[a] / other.without[b],
            self.changed[a] / other.changed[b],
            np.hypot(self.noise[a], other.noise[b]),
        )


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

    `odd` and `even` are distortions by recording, dB re the linear response in their band, without and with the
    effect. `ended` says which recordings ended early, and why.
    """

    form: EffectForm
    magnitude: float
    frfs: Mapping[tuple[str, str], FrfChange]
    times: Mapping[tuple[str, str], TimeChange]
    odd: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    even: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    ended: tuple[str, ...] = ()
