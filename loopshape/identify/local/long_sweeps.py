"""A sweep of hours: the stretch of time in which it passes a band is estimated for itself, decimated to that band.

A sweep that passes each frequency once has nothing of a band before it comes there and after it has left: what lies
elsewhere in the record is noise alone. Signals and instrument pass the same filter before they are thinned out, so that
no quotient of their transforms changes. Beside what a part needs nothing of the record is held.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from loopshape.core.stretches import AT_ONCE, LongSignal, Signal, extent
from loopshape.core.units import Array
from loopshape.data.signal.excitation_kind import zero_crossings
from loopshape.data.signal.recording import Recording
from loopshape.identify.answers import Answers
from loopshape.identify.local.sweeps import by_sweep
from loopshape.identify.settings import Settings
from loopshape.identify.spectra.transforms import FLOOR

#: samples of a part at most, of which this share on each side is there for the windows of lines near its edges
PART, BESIDE = 1 << 21, 0.125
#: so far in frequency, as a factor, windows reach beyond their lines
WINDOW_FACTOR = 1.25
#: taps of the filter before thinning out, over its factor: flat to 1.3 times that frequency, 80 dB where images lie
TAPS, CORNER, BETA = 12, 0.45, 8.0
#: times at which the frequency is read, and samples to which parts are rounded, so that alike sweeps have alike parts
READ, STEP = 4000, 1 << 10


@dataclass(frozen=True)
class Part:
    """Samples start to stop (exclusive), thinned out by `factor`, for the lines of [low_hz, high_hz)."""

    start: int
    stop: int
    factor: int
    low_hz: float
    high_hz: float


def by_sweep_in_parts(
    recording: Recording, signals: Sequence[Signal], instrument: Signal, outputs: int, settings: Settings
) -> Answers:
    """As `by_sweep`, of a sweep one way that is too long to be held; a sweep both ways is taken whole.

    Misleads where the plant rings on for longer than a part has beside its lines, 26 s of a sweep at 10 kHz: what it
    still answers then counts as noise.
    """
    parts = parts_of(instrument, recording.rate_hz) if isinstance(instrument, LongSignal) else []
    if len(parts) < 2:
        return by_sweep(recording, signals, instrument, outputs, settings)[0]
    found, numbers = [], set[int]()
    for part in parts:
        short = replace(recording, rate_hz=recording.rate_hz / part.factor)
        answers, nonlinear = by_sweep(
            short, [thinned(x, part) for x in signals], thinned(instrument, part), outputs, settings
        )
        f = answers.frequency_hz
        own = answers.select((f >= part.low_hz) & (f < part.high_hz))
        found.append(replace(own, power=own.power * ((part.stop - part.start) / instrument.size)))
        numbers.update(nonlinear.harmonics)
    return _joined(found, instrument.size / recording.rate_hz, replace(nonlinear, harmonics=tuple(sorted(numbers))))


def parts_of(instrument: Signal, rate_hz: float) -> list[Part]:
    """The parts of a sweep (n,) one way, in rising frequency; none of another signal."""
    course = _one_way(*_course(_sign_changes(instrument))) or _one_way(*_course(zero_crossings(instrument)))
    if course is None:
        return []
    hz, when = course[0] * rate_hz, course[1]
    keep = np.concatenate([[True], np.diff(hz) > 0.0])
    hz, when = hz[keep], when[keep]
    parts, low = [], 0.0
    while low < hz[-1]:
        part = _next(low, hz, when, instrument.size, rate_hz)
        parts.append(part)
        low = part.high_hz
    return parts


def _sign_changes(x: Signal) -> Array:
    """Zero crossings of a sweep (n,) without noise, in samples; also near half the rate, where none is clear."""
    mean, found, last = extent(x).mean, [], np.zeros(0)
    for start in range(0, x.size, AT_ONCE):
        values = np.concatenate([last, x[start : start + AT_ONCE] - mean])
        k = np.flatnonzero(np.diff(np.signbit(values)))
        found.append(k + values[k] / (values[k] - values[k + 1]) + (start - last.size))
        last = values[-1:]
    return np.concatenate(found)


def _one_way(at: Array, f: Array) -> tuple[Array, Array] | None:
    """Rising frequencies and their times where these only rise or only fall; None else."""
    if at.size < 8:
        return None
    order = slice(None, None, -1 if f[-1] < f[0] else 1)
    most = np.maximum.accumulate(f[order])
    steady = 0.05  # the frequency of a sweep one way never falls this share below what it was
    if np.any(f[order] < (1.0 - steady) * most) or most[-1] < 1.5 * most[0]:
        return None
    return most, at[order]


def _course(crossings: Array) -> tuple[Array, Array]:
    """Times in samples and frequencies in cycles a sample of a sweep, at some that are spread over both."""
    at = crossings[::2]
    if at.size < 8:
        return at, at
    often = np.linspace(0, at.size - 1, min(READ, at.size)).round()
    spread = np.searchsorted(at, np.linspace(at[0], at[-1], READ)).clip(0, at.size - 1)
    k = np.unique(np.concatenate([often.astype(int), spread]))
    k = k[np.concatenate([[True], np.diff(at[k]) > 0.0])]
    return 0.5 * (at[k][1:] + at[k][:-1]), np.diff(k) / np.diff(at[k])


def _next(low_hz: float, hz: Array, when: Array, n: int, rate_hz: float) -> Part:
    """The part from `low_hz` on: up to twice that or as far as so many samples go, with what is beside it."""

    def time(f: float) -> float:
        return float(np.interp(f, hz, when))

    first = max(low_hz, hz[0])
    high = min(2.0 * first, hz[-1])
    above = 8.0  # rate of a part over the highest frequency that it passes, at least
    while True:
        factor = max(1, int(rate_hz / (above * WINDOW_FACTOR * high)))
        beside = BESIDE * PART * factor
        inner = sorted((time(first), time(high)))
        outer = sorted((time(first / WINDOW_FACTOR), time(high * WINDOW_FACTOR)))
        enough = inner[1] - inner[0] <= (1.0 - 2.0 * BESIDE) * PART * factor
        if enough or high < 1.001 * first:
            break
        high = first * (high / first) ** 0.8
    start, stop = max(outer[0], inner[0] - beside), min(outer[1], inner[1] + beside)
    # cycles of its lowest frequency that a part takes at least, where the record has them before the sweep is this
    # factor above the part's highest frequency: else its lines would be far apart
    cycles, passed = 100.0, 3.0
    more = 0.5 * max(0.0, cycles * rate_hz / first - (stop - start))
    farthest = time(passed * high)
    last = high * WINDOW_FACTOR**0.2 >= hz[-1]
    high = np.inf if last else high
    before, after = (0.0, float(n)) if last else (0.0, farthest) if when[-1] > when[0] else (farthest, float(n))
    start, stop = max(min(before, start), start - more), min(max(after, stop), stop + more)
    if low_hz == 0.0 or last:  # what lies before and after the sweep, as far as there is room
        edge = when[0] if low_hz == 0.0 else when[-1]
        start, stop = (max(0.0, edge - beside), stop) if edge == when.min() else (start, min(float(n), edge + beside))
    return Part(int(start) // STEP * STEP, min(n, -(-int(stop) // STEP) * STEP), factor, low_hz, float(high))


def thinned(x: Signal, part: Part) -> Array:
    """Samples of a part of a signal (n,), filtered and every `factor`-th of them; a record's ends are held."""
    if part.factor == 1:
        return np.array(x[part.start : part.stop])
    from scipy.signal import firwin, upfirdn

    half = TAPS * part.factor // 2
    taps = firwin(2 * half + 1, 2.0 * CORNER / part.factor, window=("kaiser", BETA))
    out = np.empty((part.stop - part.start) // part.factor)
    at_once = max(1, AT_ONCE // part.factor)
    for first in range(0, out.size, at_once):
        last = min(first + at_once, out.size)
        a = part.start + first * part.factor - half
        b = part.start + (last - 1) * part.factor + half + 1
        piece = np.pad(x[max(a, 0) : min(b, x.size)], (max(-a, 0), max(b - x.size, 0)), mode="edge")
        filtered = upfirdn(taps, piece, 1, part.factor)
        skipped = 2 * half // part.factor
        out[first:last] = filtered[skipped : skipped + last - first]
    return out


def _joined(parts: Sequence[Answers], seconds: float, nonlinear: object) -> Answers:
    """Answers of parts one after the other in frequency, as those of one sweep of so many seconds."""
    parts = [one for one in parts if one.frequency_hz.size]
    lines = np.array([one.frequency_hz.size for one in parts])

    def mean(name: str) -> float:
        return float(np.average([getattr(one, name) for one in parts], weights=lines))

    def rows(name: str) -> np.ndarray:
        return np.concatenate([getattr(one, name) for one in parts])

    share = float(np.average([one.method_numbers["rationals_percent"] for one in parts], weights=lines))
    power = rows("power")
    fed = power[:, -1, -1].real
    return replace(
        parts[0],
        frequency_hz=rows("frequency_hz"),
        response=rows("response"),
        covariance=rows("covariance"),
        power=power,
        excited=fed > FLOOR * fed.max(),
        averages=mean("averages"),
        line_overlap=mean("line_overlap"),
        freedom=mean("freedom"),
        method=f"local fits of a sweep of {seconds:.4g} s in {len(parts)} parts, {share:.0f} % of lines by rationals"
        f"{nonlinear}",
        method_numbers={"sweep_s": seconds, "rationals_percent": share},
    )
