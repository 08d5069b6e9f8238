"""Recording -> rms and tones of its channels: what a machine does by itself, beside what the excitation makes it do.

**Detection.** A line of the Hann-windowed periodogram is compared with the larger of the means on both of its sides, so
that neither a slope nor a broad resonance of coloured noise counts as a tone. For Gaussian noise that is white over
those lines its chance is exact; over all lines and parts it is bounded by their sum (Bonferroni). The whole record is
looked at, its halves, quarters, eighths and sixteenths: a tone that begins late is clearest in the part that holds it.

**The excitation** is no tone of the machine: of a periodic recording the mean over periods is taken off, and a line
that the injected signal or the setpoint shows as well is passed over.

Misleads: a resonance of less than four lines (4/duration) in half width that noise excites is not told from a tone. A
tone does not show closer than three lines to a clearer one, or with less than twenty periods in the record.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import pairwise

import numpy as np
from scipy.ndimage import maximum_filter1d
from scipy.special import gammainc, stdtrit

from loopshape.core.errors import BadSignalError
from loopshape.core.stretches import Signal
from loopshape.core.units import Array
from loopshape.loop.margin.disturbed import rms_interval
from loopshape.toolbox.planning.tone.nouns import LEAST_GROWTH_DB, Growth, Interval, Tone, Tones
from loopshape.toolbox.planning.tone.tone_fit import ToneFit, fit_tone

#: lines on each side that tell the noise, and lines next to a tone that tell nothing
SIDE, GAP = 16, 2
#: parts of the record that are looked at, samples of the shortest, and samples at once
PARTS, SHORTEST, LONGEST = (1, 2, 4, 8, 16), 512, 1 << 20
CHANCE, MOST = 0.01, 20


@dataclass(frozen=True)
class Period:
    """Samples of a period, and where whole ones begin."""

    samples: int
    first: int = 0


@dataclass(frozen=True, eq=False)
class Excitation:
    """What moved the machine: signals (n,), the period of a periodic one, and whether they sweep."""

    signals: Sequence[Signal] = ()
    period: Period | None = None
    swept: bool = False


@dataclass(frozen=True)
class _Candidate:
    """A line of one part of the record that noise does not explain."""

    start: int
    stop: int
    frequency_hz: float
    width_hz: float
    chance: float

    def same_as(self, other: _Candidate) -> bool:
        """Whether both may be one tone."""
        return abs(self.frequency_hz - other.frequency_hz) <= (GAP + 1) * max(self.width_hz, other.width_hz)


def tones_of(
    signal: Signal,
    rate_hz: float,
    *,
    excitation: Excitation = Excitation(),
    chance: float = CHANCE,
    recording: str = "recording",
    channel: str = "signal",
    unit: str = "",
    closed_loop: bool | None = None,
) -> Tones:
    """Rms and tones of a signal (n,), n at least 512.

    A line that a swept excitation has power at in the same part is the excitation's too: what a resonance makes of a
    sweep that passes grows and decays. `chance` is that of any tone at all being reported where there is noise alone.
    Signals above a million samples are looked at a million at a time. Raises BadSignalError for one that is shorter.
    """
    size = signal.size
    if size < SHORTEST:
        raise BadSignalError(
            f"{channel} of {recording} is too short for its tones", f"{size} samples", f"record {SHORTEST} at least"
        )
    count = -(-size // LONGEST)
    edges = np.linspace(0, size, count + 1).astype(int)
    wholes = list(pairwise(edges))
    tests = sum(_lines_used(stop - start, part) for start, stop in wholes for part in PARTS)
    found, sums = [], []
    for start, stop in wholes:
        values = np.asarray(signal[start:stop], dtype=float)
        here = replace(excitation, signals=[np.asarray(one[start:stop], dtype=float) for one in excitation.signals])
        tones, rest = _tones(values, here, start, rate_hz, chance, max(tests, 1))
        found += [
            replace(t, from_s=float(t.from_s + start / rate_hz), to_s=float(t.to_s + start / rate_hz)) for t in tones
        ]
        sums.append((values.size, float(values.mean()), float(values.var()), _variance_of_power(values, rest)))
    mean = sum(n * m for n, m, _, _ in sums) / size
    power = sum(n * (v + (m - mean) ** 2) for n, m, v, _ in sums) / size
    lines = SIDE + GAP + 1
    return Tones(
        recording, channel, unit, float(np.sqrt(power)),
        rms_interval(power, sum(n * n * v for n, _, _, v in sums) / size**2), mean, size / rate_hz, chance,
        lines * rate_hz / min(size, LONGEST), 0.5 * rate_hz * (1.0 - 2.0 * lines / min(size, LONGEST)),
        tuple(sorted(found, key=lambda tone: tone.chance)[:MOST]), closed_loop,
    )  # fmt: skip


def without_periods(values: Array, period: Period | None) -> Array:
    """A signal (n,) without the mean over its whole periods; as it is where it has none."""
    return _without_periods(values, period, 0)[0]


def _without_periods(values: Array, period: Period | None, offset: int) -> tuple[Array, float]:
    """What is left without the mean over whole periods, and by how much noise lines without a harmonic stand out."""
    if period is None:
        return values, 1.0
    first = (period.first - offset) % period.samples if offset else period.first
    count = (values.size - first) // period.samples
    if count < 2:
        return values, 1.0
    rows = values[first : first + count * period.samples].reshape(count, period.samples)
    mean = np.roll(np.tile(rows.mean(axis=0), values.size // period.samples + 2), first % period.samples)
    return values - mean[: values.size], count / (count - 1.0)


def _tones(
    values: Array, excitation: Excitation, offset: int, rate_hz: float, chance: float, tests: int
) -> tuple[list[Tone], Array]:
    """Tones of a signal that begins at sample `offset`, and what is left without them and without its periodic part.

    A mean over few periods holds some of a tone, and the tone is fitted to what it leaves: both in turn.
    """
    period = excitation.period
    alone, free = _without_periods(values, period, offset)
    accepted: list[_Candidate] = []
    rounding = (1e-12 * float(np.abs(values).max())) ** 2
    candidates = _candidates(alone, excitation, free, rate_hz, chance, tests, rounding)
    for one in sorted(candidates, key=lambda c: c.chance):
        if len(accepted) < MOST and not any(one.same_as(other) for other in accepted):
            accepted.append(one)
    fits, signals = list[ToneFit](), list[Array]()
    rest = without_line(alone)
    for _ in range(4 if period is not None else 2 if len(accepted) > 1 else 1):
        for k, one in enumerate(accepted):
            part = rest[one.start : one.stop]
            if len(fits) > k:
                part += signals[k]
            fits[k : k + 1] = [fit_tone(part, rate_hz, one.frequency_hz)]
            signals[k : k + 1] = [fits[k].signal()]
            part -= signals[k]
        rest = without_line(_without_periods(_less(values, signals, accepted), period, offset)[0])
    return [_tone(fit, one, chance) for fit, one in zip(fits, accepted, strict=True)], rest


def _less(values: Array, signals: Sequence[Array], where: Sequence[_Candidate]) -> Array:
    """A signal (n,) without these tones."""
    rest = values.copy()
    for tone, one in zip(signals, where, strict=True):
        rest[one.start : one.stop] -= tone
    return rest


def _tone(fit: ToneFit, one: _Candidate, chance: float) -> Tone:
    wide = float(stdtrit(fit.freedom, 0.975))
    sure = float(stdtrit(fit.freedom, 1.0 - 0.5 * chance)) * fit.growth_std_per_s
    sure += LEAST_GROWTH_DB * float(np.log(10.0)) / 20.0 * fit.rate_hz / (one.stop - one.start)
    g, f, a = fit.growth_per_s, fit.frequency_hz, fit.amplitude
    return Tone(
        frequency_hz=f,
        frequency_interval_hz=_around(f, wide * fit.frequency_std_hz),
        amplitude=a,
        amplitude_interval=(max(a - wide * fit.amplitude_std, 0.0), a + wide * fit.amplitude_std),
        growth_per_s=g,
        growth_interval_per_s=_around(g, wide * fit.growth_std_per_s),
        growth=Growth.GROWS if g > sure else Growth.DECAYS if g < -sure else Growth.STEADY,
        from_s=one.start / fit.rate_hz,
        to_s=one.stop / fit.rate_hz,
        chance=one.chance,
    )


def _around(value: float, half_width: float) -> Interval:
    return value - half_width, value + half_width


def _candidates(
    values: Array, excitation: Excitation, free: float, rate_hz: float, chance: float, tests: int, rounding: float
) -> Iterator[_Candidate]:
    """Lines of all parts whose chance over all `tests` is below `chance`, and that the excitation does not show.

    `rounding` is the power of a line below which there are only the digits of numbers.
    """
    known = 1e-3  # chance below which the excitation is taken to have a line of its own
    for part in PARTS:
        if not _lines_used(values.size, part):
            return
        each = values.size // part
        powers = [periodogram(values[k * each : (k + 1) * each]) + rounding for k in range(part)]
        for k, power in enumerate(powers):
            cut = slice(k * each, (k + 1) * each)
            lines = _lines(power, chance / tests, free)
            lines = [(line, max(p, _chance_elsewhere(powers, k, line))) for line, p in lines]
            moved = [periodogram(np.asarray(one[cut])) for one in excitation.signals] if lines else []
            own = [dict(_lines(one, known, 1.0)) for one in moved]
            for line, p in lines:
                shown = any(near in found for found in own for near in range(line - GAP, line + GAP + 1))
                # power of a sweep's line, relative to its strongest of the same part, from which on it may have caused
                # a tone there
                shown |= excitation.swept and any(one[line] > 1e-4 * one.max() for one in moved)
                if p * tests < chance and not shown:
                    width = rate_hz / each
                    yield _Candidate(cut.start, cut.stop, line * width, width, float(min(1.0, p * tests)))


def _chance_elsewhere(powers: Sequence[Array], part: int, line: int) -> float:
    """Chance of a line's power in one part beside that of the same frequency in the others; 0 where there are none.

    A resonance that only the whole record resolves stands out of its sides in every part alike.
    """
    if len(powers) == 1:
        return 0.0
    others = [power[line - 1 : line + 2].mean() for k, power in enumerate(powers) if k != part]
    freedom = 1.5 * len(others)
    return float((1.0 + powers[part][line] / max(np.mean(others), 1e-300) / freedom) ** -freedom)


def _lines_used(size: int, part: int) -> int:
    """How many lines are judged in all of so many parts; none where they are too short."""
    each = size // part
    return 0 if each < SHORTEST else part * max(each // 2 - 2 * (SIDE + GAP), 0)


def without_line(values: Array) -> Array:
    """A signal (n,) without its least-squares straight line."""
    n = values.size
    k = np.arange(n) - 0.5 * (n - 1)
    out = values - values.mean()
    out -= k * (float(k @ out) * 12.0 / (n * (n * n - 1.0)))
    return np.asarray(out, dtype=float)


@lru_cache(maxsize=8)
def _hann(samples: int) -> Array:
    return np.asarray(0.5 - 0.5 * np.cos(2.0 * np.pi * np.arange(samples) / samples), dtype=float)


def periodogram(values: Array) -> Array:
    """Squared amplitudes (n/2 + 1,) of a Hann-windowed signal without its straight line: a tone's amplitude squared."""
    n = values.size
    return np.asarray((4.0 / n) ** 2 * np.abs(np.fft.rfft(without_line(values) * _hann(n))) ** 2, dtype=float)


def _lines(power: Array, chance: float, free: float) -> list[tuple[int, float]]:
    """Lines (and their chance) at which a periodogram stands out of both sides; each tone once.

    What stands out is taken out of the sides, and the rest looked at again: a tone hides weaker ones beside it.
    """
    usable = np.ones(power.size, dtype=bool)
    found: list[tuple[int, float]] = []
    least = -0.8 * np.log(chance) * free  # below what any count of lines allows
    while len(found) < MOST:
        left, right, counts = sides(power, usable)
        with np.errstate(divide="ignore", invalid="ignore"):
            ratio = np.where(usable, power / np.maximum(left, right), 0.0)
        ratio[~np.isfinite(ratio)] = 0.0
        high = np.flatnonzero(ratio >= least)
        peaks = high[ratio[high] == maximum_filter1d(ratio, 2 * GAP + 1)[high]] if high.size else high
        chances = [(int(k), _chance_of(float(ratio[k]) / free, int(counts[k]))) for k in peaks]
        clear = [(k, p) for k, p in chances if p < chance]
        if not clear:
            break
        found += clear
        for k, _ in clear:
            usable[max(k - GAP, 0) : k + GAP + 1] = False
    return found


def sides(power: Array, usable: np.ndarray) -> tuple[Array, Array, np.ndarray]:
    """Means of the usable lines on the left and right of each line, infinite at the ends; and the smaller count."""
    half_width = SIDE + GAP
    total = np.concatenate([[0.0], np.cumsum(np.where(usable, power, 0.0))])
    count = np.concatenate([[0], np.cumsum(usable)])
    k = np.arange(power.size)
    inner = (k > half_width) & (k < power.size - 1 - half_width)
    found = []
    for low, high in ((k - half_width, k - GAP), (k + GAP + 1, k + half_width + 1)):
        low, high = np.clip(low, 0, power.size), np.clip(high, 0, power.size)
        many = count[high] - count[low]
        with np.errstate(divide="ignore", invalid="ignore"):
            found.append((np.where(inner & (many >= SIDE // 2), (total[high] - total[low]) / many, np.inf), many))
    return found[0][0], found[1][0], np.minimum(found[0][1], found[1][1])


def _chance_of(ratio: float, count: int) -> float:
    """Chance that a line of noise exceeds `ratio` times the larger of two means of `count` lines each."""
    levels, shares = _larger_of_two(count)
    return float(shares @ np.exp(-ratio * levels))


@lru_cache(maxsize=4 * SIDE)
def _larger_of_two(count: int) -> tuple[Array, Array]:
    """Levels of the larger of two means of `count` lines of noise of mean 1, and the share of each."""
    # independent lines among neighbours of a Hann window, a line
    independent = 1.0 / (1.0 + 2.0 * (4.0 / 9.0 + 1.0 / 36.0))
    m = count * independent
    edges = np.linspace(0.0, 1.0, 400) ** 3 * (1.0 + 12.0 / np.sqrt(m))
    return 0.5 * (edges[1:] + edges[:-1]), np.diff(gammainc(m, m * edges) ** 2)


def _variance_of_power(values: Array, rest: Array) -> float:
    """Variance of the mean square of a signal (n,), whose part `rest` is noise, the other the same every time.

    Of noise each line's power scatters by itself; beside a line of fixed power it scatters by twice both.
    """
    n = values.size
    noise = 2.0 * np.abs(np.fft.rfft(rest - rest.mean())[1:]) ** 2 / n**2
    fixed = 2.0 * np.abs(np.fft.rfft(values - values.mean() - rest)[1:]) ** 2 / n**2
    around = np.convolve(noise, np.full(2 * SIDE + 1, 1.0 / (2 * SIDE + 1)), mode="same")
    return float(np.sum(0.5 * noise**2) + 2.0 * np.sum(fixed * around))
