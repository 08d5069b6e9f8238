"""Iterative learning: what the error of one trial adds to the plant's input of the next, and whether that converges."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike

from loopshape.core.json_ready import Plain
from loopshape.core.outcomes import Outcome
from loopshape.core.units import TWO_PI, Array
from loopshape.toolbox.learning.taps import Feedforward


@dataclass(frozen=True, eq=False)
class Learning(Plain):
    """u_next = Q (u + F e + z): F inverts the plant, z is the controller's output, Q lets the band through.

    From trial to trial what is still to be learned shrinks by `factor` (nf,) = |Q S (1 - P F)|;
    `factor_low` and `factor_high` end its 95 % interval by the FRF's variance. Trials converge where it is below 1 at
    every frequency (Norrlof and Gunnarsson, Int. J. Control 75(14), 2002).
    """

    ALSO: ClassVar[Mapping[str, str]] = {"converges": "converges"}

    filter: Feedforward
    smoothing: Array
    frequency_hz: Array
    factor: Array
    factor_low: Array
    factor_high: Array

    @property
    def converges(self) -> Outcome:
        """Passed where the whole interval lies below 1 at every frequency, failed where it lies above at one."""
        if (self.factor_high < 1.0).all():
            return Outcome.PASSED
        return Outcome.FAILED if (self.factor_low >= 1.0).any() else Outcome.UNDECIDED

    def __repr__(self) -> str:
        """One line: whether it converges, and the largest factor."""
        k = int(np.argmax(self.factor_high))
        return (
            f"Learning: convergence {self.converges}, at most {self.factor[k]:.3g} ({self.factor_high[k]:.3g}) is"
            f" left, at {self.frequency_hz[k]:.4g} Hz"
        )

    def next(self, u: ArrayLike, error: ArrayLike, control: ArrayLike) -> Array:
        """The plant's added input (n,) of the next trial from this trial's, its error and what the controller gave out.

        From rest to rest: at both ends signals are faded into their means there, over the length of Q, and learned no
        further. The move must lie between.
        """
        many = self.smoothing.size
        given = np.asarray(u, dtype=float) + np.asarray(control, dtype=float)
        # the inverse comes after Q, for it makes much of noise at the ends
        return self.smoothed(_ending(given, many)) + self.filter.signal(self.smoothed(_ending(error, many)))

    def smoothed(self, values: Array) -> Array:
        """A signal (n,) through Q, which goes on at both ends as it is there."""
        return np.convolve(np.pad(values, self.smoothing.size // 2, mode="edge"), self.smoothing, mode="valid")


def _ending(values: ArrayLike, many: int) -> Array:
    """A signal (n,) that fades into its mean over `many` samples at each end, and stays there."""
    x = np.asarray(values, dtype=float)
    many = min(many, x.size // 4)
    fade = np.clip(np.arange(x.size) / many - 1.0, 0.0, 1.0)
    first, last = (0.5 - 0.5 * np.cos(np.pi * ramp) for ramp in (fade, fade[::-1]))
    tapered = x[: 2 * many].mean() + (x - x[: 2 * many].mean()) * first
    return np.asarray(x[-2 * many :].mean() + (tapered - x[-2 * many :].mean()) * last)


def zero_phase(smoothing: Array, frequency_hz: Array, rate_hz: float) -> Array:
    """Response (nf,) of symmetric taps about their middle: real."""
    k = np.arange(smoothing.size) - smoothing.size // 2
    return np.asarray(np.cos(TWO_PI * np.outer(frequency_hz, k) / rate_hz) @ smoothing)
