"""What excitations share: lengths in whole samples, ramps, repetition, and the checks of their numbers."""

from __future__ import annotations

import numpy as np

from loopshape.core.errors import WrongUseError
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
