"""What excitations share: lengths in whole samples, ramps, repetition, the checks of their numbers; and which signal
is a sweep."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from loopshape.core.errors import WrongUseError
from loopshape.core.stretches import AT_ONCE, Signal, extent
from loopshape.core.units import TWO_PI, Array

#: longest signal that is made, in samples
MOST_SAMPLES = 50_000_000
#: shares of the largest value nearby and anywhere that a signal must reach to have crossed zero
NEARBY, ANYWHERE = 0.1, 0.02
#: zero crossings that a sweep has at least, and over how many of them, or more of thousands, its frequency is taken
CROSSINGS, SPAN = 40, 8
#: spread of a sweep's ln f between its quartiles, absolute and over the whole range
SPREAD = 0.1
#: mean |x| squared over mean square, cycle by cycle: 8 / pi^2 of a sine, 1 of a square wave, 2 / pi of Gaussian noise
SINE = (0.77, 0.85)
#: share of a signal's rms by which its periods may differ: of one that was measured, and of one that is known
REPEATED, KNOWN_REPEATED = 0.1, 0.03


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


def zero_crossings(x: Signal) -> Array:
    """Where a signal (n,) crosses its mean, in samples; it must move clearly to the other side, so noise is none."""
    whole = extent(x)
    mean, least = whole.mean, ANYWHERE * max(whole.most - whole.mean, whole.mean - whole.least)
    found, last = [], (0, 0.0)  # row and value of the last sample that lies clearly on a side
    for start, part in _parts(x, mean):
        size = np.abs(part)
        blocks = np.arange(0, part.size, max(part.size // 20, 3))
        near = np.repeat(np.maximum.reduceat(size, blocks), np.diff([*blocks, part.size]))
        rows = np.flatnonzero(size > np.maximum(NEARBY * near, least))
        k, values = np.concatenate([[last[0]], rows + start]), np.concatenate([[last[1]], part[rows]])
        flips = np.flatnonzero(values[1:] * values[:-1] < 0.0)
        a, b = values[flips], values[flips + 1]
        found.append(k[flips] + (k[flips + 1] - k[flips]) * a / (a - b))
        last = int(k[-1]), float(values[-1])
    return np.concatenate(found)


def is_sweep(x: Signal) -> bool:
    """Whether a signal (n,) is a sine whose frequency only rises, only falls, or does one after the other.

    By its zero crossings, 20 cycles at least: the frequency moves monotonically, all along and not at one end alone,
    and each stretch of four cycles has the mean size of a sine. A single period of a multisine with Schroeder's phases
    is a sweep in this sense; several periods, noise, PRBS and steps are none. An amplitude that falls to a tenth or
    less while the sweep passes may hide it.
    """
    at = zero_crossings(x)
    if at.size < CROSSINGS:
        return False
    span = max(SPAN, at.size // 200)
    log_f = -np.log(at[span:] - at[:-span])
    low, high = np.quantile(log_f, [0.25, 0.75])
    if high - low < max(SPREAD, SPREAD * float(np.ptp(log_f))):
        return False
    # share of the variance of a sweep's ln f that a frequency which only rises, then only falls explains
    monotone = 0.997
    if max(_monotone(log_f), _monotone(-log_f)) < monotone:
        return False
    return bool(SINE[0] < _form(x, at) < SINE[1])


def _monotone(y: Array) -> float:
    """Share of the variance of y (n,) that a curve which rises up to its largest value, and falls on, explains."""
    top = int(np.argmax(y))
    left = float(sum(np.sum(_unsteady(part) ** 2) for part in (y[: top + 1], y[top:][::-1])))
    return 1.0 - left / (y.size * float(np.var(y)))


def _unsteady(y: Array) -> Array:
    """What a rising curve, the mean of the largest so far and of the least from there on, leaves of y (n,)."""
    return np.asarray(y - 0.5 * (np.maximum.accumulate(y) + np.minimum.accumulate(y[::-1])[::-1]))


def _form(x: Signal, at: Array) -> float:
    """Mean of |x| squared over mean square, each over `SPAN` zero crossings `at`, weighted by power."""
    cells = at.size // SPAN
    sums = np.zeros((3, cells + 1))
    for start, part in _parts(x, extent(x).mean):
        cell = np.searchsorted(at, np.arange(start, start + part.size)) // SPAN
        for row, weights in zip(sums, (np.ones(part.size), np.abs(part), part**2), strict=True):
            row += np.bincount(cell, weights, minlength=cells + 1)[: cells + 1]
    count, size, power = sums[:, 1:cells]  # cells at the ends hold what lies outside the crossings
    return float(np.sum(size**2 / np.maximum(count, 1.0)) / np.sum(power))


def _parts(x: Signal, mean: float) -> Iterator[tuple[int, Array]]:
    """First row and values of stretches of x (n,) less its mean."""
    for start in range(0, x.size, AT_ONCE):
        yield start, np.asarray(x[start : start + AT_ONCE] - mean)


def rows_of_a_period(x: Array, differ: float = REPEATED) -> tuple[int, int]:
    """Rows after which a signal (n,) repeats itself, and from which row on; (0, 0) for one that does not.

    Its periods may `differ` by a share of its rms.
    """
    found = _repeating(x, x.size // 3, differ)
    return found if found[0] else _repeating(x, 0, differ)


def _repeating(x: Array, start: int, differ: float) -> tuple[int, int]:
    """A period and where it begins, looked for from a row: at least half of the rows repeat, not a few at the end."""
    n = x.size
    late = x[start:] - x[start:].mean()
    if late.size < 8 or not late.any():
        return 0, 0
    power = np.fft.irfft(np.abs(np.fft.rfft(late, 2 * late.size)) ** 2, 2 * late.size)[: late.size]
    lags = np.arange(late.size // 2 + 1)
    alike = power[: lags.size] / power[0] * late.size / (late.size - lags)
    fallen = np.flatnonzero(alike < 0.5)
    if not fallen.size:
        return 0, 0
    rest = alike[fallen[0] :]
    first = int(np.argmax(rest >= rest.max() - 0.02))  # multiples of a period are as good
    period = int(fallen[0] + first + np.argmax(rest[first : first + max(3, (fallen[0] + first) // 20)]))
    apart = np.abs(x[period:] - x[:-period])
    noise = 1.5 * float(np.median(apart[-period:]))  # a median: single rows may be wrong
    if noise > differ * late.std():
        return 0, 0
    begins = _last_dense(apart > max(1e-3 * late.std(), 6.0 * noise), max(8, period // 20))
    if begins > n // 2 or begins + 2 * period > n or x[begins:].std() < 0.3 * late.std():  # what rests repeats too
        return 0, 0
    whole = x[begins : begins + (n - begins) // period * period].reshape(-1, period)
    scatter = np.mean((whole - whole.mean(axis=0)) ** 2)  # it drifts with a period of no whole number of rows
    return (0, 0) if scatter > differ**2 * whole.mean(axis=0).var() else (period, begins)


def _last_dense(marked: np.ndarray, width: int) -> int:
    """The row behind the last stretch of `width` rows of which over a quarter are marked; 0 without one."""
    count = np.concatenate([[0], np.cumsum(marked)])
    dense = np.flatnonzero(count[width:] - count[:-width] > width // 4)
    return int(dense[-1] + np.flatnonzero(marked[dense[-1] : dense[-1] + width])[-1]) + 1 if dense.size else 0
