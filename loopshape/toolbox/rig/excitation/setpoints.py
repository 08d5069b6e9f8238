"""Setpoints: staircases, profiles from point to point, and signals that are given sample by sample."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from loopshape.core.errors import WrongUseError
from loopshape.core.units import Array
from loopshape.toolbox.rig.excitation.excitation import check_positive


@dataclass(frozen=True)
class Staircase:
    """A signal that jumps to `values[i]` at `times_s[i]` and stays there; `before` until the first jump."""

    times_s: tuple[float, ...]
    values: tuple[float, ...]
    kind: str = "staircase"

    def __post_init__(self) -> None:
        if len(self.times_s) != len(self.values) or list(self.times_s) != sorted(self.times_s):
            raise WrongUseError(
                "a staircase needs a value for each time, and times that rise",
                f"{len(self.times_s)} times, {len(self.values)} values",
            )

    def sampled(self, n: int, rate_hz: float, before: float) -> Array:
        """The staircase, (n,)."""
        index = np.searchsorted(np.asarray(self.times_s), np.arange(n) / rate_hz + 1e-9, side="right")
        return np.concatenate([[before], np.asarray(self.values, dtype=float)])[index]


@dataclass(frozen=True, eq=False)
class Sampled:
    """A signal (n,) that is given sample by sample at a rate, as a feedforward that was learned; it starts at t = 0."""

    values: Array
    rate_hz: float

    def sampled(self, n: int, rate_hz: float, before: float) -> Array:
        """The signal, (n,), with `before` after its end; refuses another rate, and a signal that is longer."""
        if rate_hz != self.rate_hz or self.values.size > n:
            raise WrongUseError(
                "a signal that is given by its samples has the rate of the study and fits in the experiment",
                f"{self.values.size} samples at {self.rate_hz:g} Hz, for {n} at {rate_hz:g} Hz",
                "learn it from a recording of this experiment",
            )
        return np.concatenate([self.values, np.full(n - self.values.size, before)])


@dataclass(frozen=True)
class Profile:
    """Third-order setpoint: from point to point with limited velocity, acceleration and jerk.

    Moves to `values[i]`, starting at `times_s[i]`; a move must end before the next begins. Limits are in
    the signal's unit per s, s², s³. Source: the tracking experiment of figure 5.7.
    """

    times_s: tuple[float, ...]
    values: tuple[float, ...]
    velocity: float
    acceleration: float
    jerk: float
    kind: str = "profile"

    def __post_init__(self) -> None:
        Staircase(self.times_s, self.values)
        check_positive(self.kind, velocity=self.velocity, acceleration=self.acceleration, jerk=self.jerk)

    def sampled(self, n: int, rate_hz: float, before: float) -> Array:
        """The profile, (n,)."""
        t = np.arange(n) / rate_hz
        out = np.full(n, float(before))
        last, free_s = float(before), 0.0
        for start_s, value in zip(self.times_s, self.values, strict=True):
            if start_s < free_s - 1e-9:
                raise WrongUseError(
                    "a profile's move begins before the last one has ended",
                    f"{start_s:g} s, the last ends at {free_s:g} s",
                    "move it later or raise the limits",
                )
            distance, sign = abs(value - last), np.sign(value - last)
            times = _profile_times(distance, self.velocity, self.acceleration, self.jerk)
            out += sign * _profile_position(t - start_s, times, self.jerk)
            last, free_s = value, start_s + 4 * times[0] + 2 * times[1] + times[2]
        return out


def _profile_times(distance: float, v: float, a: float, j: float) -> tuple[float, float, float]:
    """Times of constant jerk, constant acceleration and constant velocity that cover `distance` soonest."""
    tj = min(a / j, np.sqrt(v / j), np.cbrt(distance / (2.0 * j)))
    peak_a = j * tj
    # with constant acceleration for ta: distance = peak_a (tj + ta)(2 tj + ta) without cruise
    ta_v = v / peak_a - tj if peak_a > 0 else 0.0
    ta_d = 0.5 * (-3.0 * tj + np.sqrt(tj**2 + 4.0 * distance / peak_a)) if peak_a > 0 else 0.0
    ta = max(0.0, min(ta_v, ta_d))
    peak_v = peak_a * (tj + ta)
    cruise = (distance - peak_v * (2 * tj + ta)) / peak_v if peak_v > 0 else 0.0
    return float(tj), float(ta), float(max(cruise, 0.0))


def _profile_position(t: Array, times: tuple[float, float, float], jerk: float) -> Array:
    tj, ta, tv = times
    jumps = np.cumsum([0.0, tj, ta, tj, tv, tj, ta, tj])
    heights = np.array([1, -1, -1, 1, -1, 1, 1, -1]) * jerk
    late = np.maximum(np.minimum(t, jumps[-1])[:, None] - jumps, 0.0)  # cubes cancel badly long after the end
    return np.asarray((late**3 @ heights) / 6.0)
