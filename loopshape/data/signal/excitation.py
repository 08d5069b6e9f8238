"""Excitations and setpoints: the signals that a study asks for, made from numbers and a seed.

Every excitation gives a signal at a rate, in the unit of the place where it is injected; amplitudes are
peak values there, of noise the standard deviation. Ramps at both ends keep a start or a stop from being a step.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from loopshape.core.errors import WrongUseError, refuse_unknown
from loopshape.core.units import TWO_PI, Array
from loopshape.data.signal.excitation_parts import (
    check_band,
    check_below_half_rate,
    check_positive,
    check_samples,
    ramp,
    repeated,
    samples,
)
from loopshape.data.signal.multisine import Multisine

__all__ = [
    "BandNoise",
    "Excitation",
    "Multisine",
    "Prbs",
    "Profile",
    "Sampled",
    "Staircase",
    "Sweep",
    "ramp",
    "samples",
]


class Excitation(Protocol):
    """A signal to inject. `period_s` is None where it does not repeat."""

    @property
    def kind(self) -> str:
        """The word for it in a study."""

    @property
    def duration_s(self) -> float:
        """Length of the signal in s."""

    @property
    def period_s(self) -> float | None:
        """Period in s, or None."""

    @property
    def band_hz(self) -> tuple[float, float]:
        """Lowest and highest frequency that it excites."""

    def signal(self, rate_hz: float) -> Array:
        """The signal, (n,)."""


@dataclass(frozen=True)
class Sweep:
    """Rising, then falling sine sweep between two frequencies, linear or logarithmic in time.

    `duration_s` is that of both halves together. The fall is the rise played backwards, so the record
    begins and ends at the lowest frequency (source: section 4.3, "a rising and a falling sweep").
    """

    f_low_hz: float
    f_high_hz: float
    duration_s: float
    amplitude: float
    ramp_s: float = 1.0
    spacing: str = "linear"
    kind: str = "sweep"
    period_s: float | None = None

    def __post_init__(self) -> None:
        check_band(self.kind, self.f_low_hz, self.f_high_hz)
        check_positive(self.kind, duration_s=self.duration_s, amplitude=self.amplitude)
        refuse_unknown("a sweep's spacing is not known", self.spacing, ("linear", "logarithmic"))

    @property
    def band_hz(self) -> tuple[float, float]:
        """Lowest and highest frequency."""
        return self.f_low_hz, self.f_high_hz

    def signal(self, rate_hz: float) -> Array:
        """The sweep, (n,)."""
        check_below_half_rate(self.kind, self.f_high_hz, rate_hz)
        n = samples(self.duration_s, rate_hz)
        half_s = 0.5 * n / rate_hz
        t = np.arange(n) / rate_hz
        rising = np.minimum(t, 2.0 * half_s - t)  # time on the rising half, mirrored
        phase = self._cycles(rising, half_s)
        falling = t > half_s
        phase[falling] = 2.0 * self._cycles(np.array([half_s]), half_s)[0] - phase[falling]
        return self.amplitude * np.sin(TWO_PI * phase) * ramp(n, round(self.ramp_s * rate_hz))

    def _cycles(self, t: Array, half_s: float) -> Array:
        lo, hi = self.f_low_hz, self.f_high_hz
        if self.spacing == "linear":
            return lo * t + 0.5 * (hi - lo) * t**2 / half_s
        growth = np.log(hi / lo) / half_s
        return lo * np.expm1(growth * t) / growth


@dataclass(frozen=True)
class Prbs:
    """Maximum-length pseudo-random binary sequence, `periods` times, one bit every `clock_s`.

    `order` n gives 2^n - 1 bits a period; the seed picks where in the sequence it starts. Ramps of `ramp_s`
    lie before and after the whole periods.
    """

    order: int
    clock_s: float
    amplitude: float
    periods: int = 4
    seed: int = 0
    ramp_s: float = 0.0
    kind: str = "prbs"

    def __post_init__(self) -> None:
        check_positive(self.kind, clock_s=self.clock_s, amplitude=self.amplitude, periods=self.periods)
        if not 3 <= self.order <= 20:
            raise WrongUseError("a PRBS has an order from 3 to 20", f"{self.order!r}")

    @property
    def period_s(self) -> float:
        """(2^order - 1) clocks."""
        return (2**self.order - 1) * self.clock_s

    @property
    def duration_s(self) -> float:
        """Both ramps and the whole periods."""
        return 2.0 * self.ramp_s + self.periods * self.period_s

    @property
    def band_hz(self) -> tuple[float, float]:
        """First line, and 0.44 of the clock's rate, where the power has fallen by 3 dB."""
        return 1.0 / self.period_s, 0.44 / self.clock_s

    def signal(self, rate_hz: float) -> Array:
        """The sequence, (n,), of values +-amplitude."""
        from scipy.signal import max_len_seq

        hold = samples(self.clock_s, rate_hz)
        check_samples(hold * 2**self.order)
        bits = np.asarray(max_len_seq(self.order)[0], dtype=float)
        start = int(np.random.default_rng(self.seed).integers(bits.size))
        one = np.repeat(2.0 * np.roll(bits, -start) - 1.0, hold)
        return self.amplitude * repeated(one, self.periods, self.ramp_s, rate_hz)


@dataclass(frozen=True)
class BandNoise:
    """Gaussian noise in a band, seeded; `amplitude` is its standard deviation and 3.5 times that its peak."""

    f_low_hz: float
    f_high_hz: float
    duration_s: float
    amplitude: float
    seed: int = 0
    ramp_s: float = 1.0
    kind: str = "noise"
    period_s: float | None = None

    def __post_init__(self) -> None:
        check_band(self.kind, self.f_low_hz, self.f_high_hz)
        check_positive(self.kind, duration_s=self.duration_s, amplitude=self.amplitude)

    @property
    def band_hz(self) -> tuple[float, float]:
        """The band."""
        return self.f_low_hz, self.f_high_hz

    def signal(self, rate_hz: float) -> Array:
        """The noise, (n,)."""
        check_below_half_rate(self.kind, self.f_high_hz, rate_hz)
        n = samples(self.duration_s, rate_hz)
        f = np.fft.rfftfreq(n, 1.0 / rate_hz)
        rng = np.random.default_rng(self.seed)
        spectrum = rng.standard_normal(f.size) + 1j * rng.standard_normal(f.size)
        inside = (f >= self.f_low_hz) & (f <= self.f_high_hz)
        if not inside.any():
            raise WrongUseError(
                f"noise of {self.duration_s:g} s has lines every {1.0 / self.duration_s:g} Hz, and none in its band",
                f"{self.f_low_hz:g} to {self.f_high_hz:g} Hz",
                "lengthen it or widen the band",
            )
        spectrum[~inside] = 0.0
        x = np.fft.irfft(spectrum, n)
        x = np.clip(x / x.std(), -3.5, 3.5)
        return self.amplitude * x * ramp(n, round(self.ramp_s * rate_hz))


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
