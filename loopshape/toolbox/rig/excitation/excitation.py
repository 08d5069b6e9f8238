"""Excitations: the signals that a study injects, made from numbers and a seed, and what they share.

Every excitation gives a signal at a rate, in the unit of the place where it is injected; amplitudes are
peak values there, of noise the standard deviation. Ramps at both ends keep a start or a stop from being a step.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from loopshape.core.errors import WrongUseError, refuse_unknown
from loopshape.core.units import TWO_PI, Array

#: longest signal that is made, in samples
MOST_SAMPLES = 50_000_000


def samples(duration_s: float, rate_hz: float) -> int:
    """Number of samples of a duration; refuses a duration that is not a whole number of samples."""
    n = duration_s * rate_hz
    if not (np.isfinite(n) and n >= 1 and abs(n - round(n)) < 1e-6 * max(n, 1.0)):
        raise WrongUseError(
            "a duration must be a whole number of samples",
            f"{duration_s!r} s at {rate_hz:g} Hz",
            "change the duration or the rate",
        )
    check_samples(n)
    return round(n)


def check_samples(n: float) -> None:
    """Refuse a signal longer than any that is made."""
    if n > MOST_SAMPLES:
        raise WrongUseError("a signal is too long", f"{n:.3g} samples", f"{MOST_SAMPLES:g} at most")


def ramp(n: int, ramp_n: int) -> Array:
    """Window (n,) that rises from 0 to 1 over `ramp_n` samples as a half cosine, and falls the same way."""
    if not 0 <= 2 * ramp_n <= n:
        raise WrongUseError(
            "a signal must outlast both its ramps", f"ramps of {ramp_n} samples, a signal of {n}", "shorten ramp_s"
        )
    window = np.ones(n)
    if ramp_n > 0:
        edge = 0.5 - 0.5 * np.cos(0.5 * TWO_PI * (np.arange(ramp_n) + 0.5) / ramp_n)
        window[:ramp_n] *= edge
        window[n - ramp_n :] *= edge[::-1]
    return window


def check_band(kind: str, f_low_hz: float, f_high_hz: float) -> None:
    """Refuse a band that does not rise from above zero."""
    if not 0.0 < f_low_hz < f_high_hz < np.inf:
        raise WrongUseError(f"a {kind}'s band must be positive and increasing", f"{f_low_hz!r} to {f_high_hz!r} Hz")


def check_below_half_rate(kind: str, f_high_hz: float, rate_hz: float) -> None:
    """Refuse a highest frequency that the rate cannot carry."""
    if f_high_hz >= 0.5 * rate_hz:
        raise WrongUseError(
            f"a {kind} must stay below half the rate ({0.5 * rate_hz:g} Hz)",
            f"{f_high_hz:g} Hz",
            "lower its band or raise the rate",
        )


def check_positive(kind: str, **numbers: float) -> None:
    """Refuse numbers that are not finite and above zero, by name."""
    for name, value in numbers.items():
        if not (np.isfinite(value) and value > 0.0):
            raise WrongUseError(f"{name} of a {kind} must be positive", f"{value!r}")


def repeated(one: Array, periods: int, ramp_s: float, rate_hz: float) -> Array:
    """Whole periods of `one` (n,), with a ramp before the first and after the last."""
    ramp_n = samples(ramp_s, rate_hz) if ramp_s else 0
    check_samples(periods * one.size + 2 * ramp_n)
    index = np.arange(-ramp_n, periods * one.size + ramp_n) % one.size
    return one[index] * ramp(index.size, ramp_n)


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
