"""Excitations and setpoints: the signals that a study asks for, made from numbers and a seed.

Every excitation gives a signal at a rate, in the unit of the place where it is injected; amplitudes are
peak values there, of noise the standard deviation. Ramps at both ends keep a start or a stop from being a step.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from loopshape.errors import WrongUseError
from loopshape.units import TWO_PI, Array


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


def samples(duration_s: float, rate_hz: float) -> int:
    """Number of samples of a duration; refuses a duration that is not a whole number of samples."""
    n = duration_s * rate_hz
    if not (np.isfinite(n) and n >= 1 and abs(n - round(n)) < 1e-6 * max(n, 1.0)):
        raise WrongUseError(
            "a duration must be a whole number of samples",
            f"{duration_s!r} s at {rate_hz:g} Hz",
            "change the duration or the rate",
        )
    if n > MOST_SAMPLES:
        raise WrongUseError("a signal is too long", f"{n:.3g} samples", f"{MOST_SAMPLES:g} at most")
    return round(n)


#: longest signal that is made, in samples
MOST_SAMPLES = 50_000_000


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


def _check_band(kind: str, f_low_hz: float, f_high_hz: float) -> None:
    if not 0.0 < f_low_hz < f_high_hz < np.inf:
        raise WrongUseError(f"a {kind}'s band must rise from above zero", f"{f_low_hz!r} to {f_high_hz!r} Hz")


def _check_below_half_rate(kind: str, f_high_hz: float, rate_hz: float) -> None:
    if f_high_hz >= 0.5 * rate_hz:
        raise WrongUseError(
            f"a {kind} must stay below half the rate ({0.5 * rate_hz:g} Hz)",
            f"{f_high_hz:g} Hz",
            "lower its band or raise the rate",
        )


def _check_positive(kind: str, **numbers: float) -> None:
    for name, value in numbers.items():
        if not (np.isfinite(value) and value > 0.0):
            raise WrongUseError(f"{name} of a {kind} must be positive", f"{value!r}")


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
        _check_band(self.kind, self.f_low_hz, self.f_high_hz)
        _check_positive(self.kind, duration_s=self.duration_s, amplitude=self.amplitude)
        if self.spacing not in ("linear", "logarithmic"):
            raise WrongUseError("a sweep's spacing is not known", f"{self.spacing!r}", "use linear or logarithmic")

    @property
    def band_hz(self) -> tuple[float, float]:
        """Lowest and highest frequency."""
        return self.f_low_hz, self.f_high_hz

    def signal(self, rate_hz: float) -> Array:
        """The sweep, (n,)."""
        _check_below_half_rate(self.kind, self.f_high_hz, rate_hz)
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
class Multisine:
    """Random-phase multisine of low crest factor: `periods` periods of chosen lines, seeded.

    `lines_hz` must be multiples of 1/period_s; None takes every line in the band, or the odd ones.
    Phases are the best of random draws and clipping iterations (van der Ouderaa 1988): the crest factor
    comes to about 1.5-1.8. Leading ramp `ramp_s` lies before the first whole period.
    """

    f_low_hz: float
    f_high_hz: float
    period_s: float
    amplitude: float
    periods: int = 4
    seed: int = 0
    odd: bool = False
    ramp_s: float = 1.0
    lines_hz: tuple[float, ...] | None = None
    crest_iterations: int = 60
    kind: str = "multisine"

    def __post_init__(self) -> None:
        _check_band(self.kind, self.f_low_hz, self.f_high_hz)
        _check_positive(self.kind, period_s=self.period_s, amplitude=self.amplitude, periods=self.periods)

    @property
    def band_hz(self) -> tuple[float, float]:
        """Lowest and highest line."""
        lines = self.lines()
        return float(lines[0]), float(lines[-1])

    @property
    def duration_s(self) -> float:
        """Both ramps and the whole periods."""
        return 2.0 * self.ramp_s + self.periods * self.period_s

    def lines(self) -> Array:
        """Excited frequencies in Hz."""
        if self.lines_hz is None:
            k = np.arange(
                np.ceil(self.f_low_hz * self.period_s - 1e-9),
                np.floor(self.f_high_hz * self.period_s + 1e-9) + 1,
            )
            k = k[k % 2 == 1] if self.odd else k
        else:
            k = np.asarray(self.lines_hz, dtype=float) * self.period_s
        if not k.size or np.any(np.abs(k - np.round(k)) > 1e-6) or k.min() < 1:
            raise WrongUseError(
                f"a multisine's lines are whole multiples of {1.0 / self.period_s:g} Hz",
                f"{self.lines_hz or (self.f_low_hz, self.f_high_hz)}",
                "choose lines on that grid or another period",
            )
        return np.unique(np.round(k)) / self.period_s

    def signal(self, rate_hz: float) -> Array:
        """The multisine, (n,): ramp in, whole periods, ramp out; peak is `amplitude`."""
        lines = self.lines()
        _check_below_half_rate(self.kind, float(lines[-1]), rate_hz)
        n = samples(self.period_s, rate_hz)
        one = _low_crest(np.round(lines * self.period_s).astype(int), n, self.seed, self.crest_iterations)
        return self.amplitude * _repeated(one, self.periods, self.ramp_s, rate_hz)


def _repeated(one: Array, periods: int, ramp_s: float, rate_hz: float) -> Array:
    """Whole periods of `one` (n,), with a ramp before the first and after the last."""
    ramp_n = samples(ramp_s, rate_hz) if ramp_s else 0
    index = np.arange(-ramp_n, periods * one.size + ramp_n) % one.size
    return one[index] * ramp(index.size, ramp_n)


def _low_crest(bins: NDArray[np.int64], n: int, seed: int, iterations: int) -> Array:
    """One period (n,) with equal amplitudes in `bins` and peak 1, phases iterated towards a low crest."""
    rng = np.random.default_rng(seed)
    spectrum = np.zeros(n // 2 + 1, dtype=complex)
    spectrum[bins] = np.exp(1j * TWO_PI * rng.random(bins.size))
    best = np.fft.irfft(spectrum, n)
    best_peak = np.abs(best).max()
    x = best
    for k in range(iterations):
        level = np.abs(x).max() * (0.75 + 0.2 * k / max(iterations, 1))
        clipped = np.fft.rfft(np.clip(x, -level, level))
        spectrum[bins] = np.exp(1j * np.angle(clipped[bins]))
        x = np.fft.irfft(spectrum, n)
        peak = np.abs(x).max()
        if peak < best_peak:
            best, best_peak = x, peak
    return np.asarray(best / best_peak)


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
        _check_positive(self.kind, clock_s=self.clock_s, amplitude=self.amplitude, periods=self.periods)
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
        bits = np.asarray(max_len_seq(self.order)[0], dtype=float)
        start = int(np.random.default_rng(self.seed).integers(bits.size))
        one = np.repeat(2.0 * np.roll(bits, -start) - 1.0, hold)
        return self.amplitude * _repeated(one, self.periods, self.ramp_s, rate_hz)


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
        _check_band(self.kind, self.f_low_hz, self.f_high_hz)
        _check_positive(self.kind, duration_s=self.duration_s, amplitude=self.amplitude)

    @property
    def band_hz(self) -> tuple[float, float]:
        """The band."""
        return self.f_low_hz, self.f_high_hz

    def signal(self, rate_hz: float) -> Array:
        """The noise, (n,)."""
        _check_below_half_rate(self.kind, self.f_high_hz, rate_hz)
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
        _check_positive(self.kind, velocity=self.velocity, acceleration=self.acceleration, jerk=self.jerk)

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
