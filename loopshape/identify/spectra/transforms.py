"""Transforms of a recording's signals: by whole periods where the excitation repeats, else by Welch's segments.

Long records are transformed by parts that are interleaved in time (Cooley and Tukey, Math. Comp. 19, 1965): a whole
transform needs several times the record's memory. Every R-th sample from the r-th on is transformed for itself, and
X(k) = sum_r exp(-2 pi j r k / n) X_r(k mod n / R) is summed over the lines that are wanted: beside these and the record
only a part is held.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.fft import next_fast_len

from loopshape.core.errors import BadSignalError, WrongUseError
from loopshape.core.kernels.spectra import hann, independent_share, line_overlap, period_spectra, segment_spectra
from loopshape.core.units import TWO_PI, Array, ComplexArray
from loopshape.data.signal.recording import Recording
from loopshape.identify.settings import Settings

#: lines whose excitation lies this far below the strongest are not the excitation's (leakage, rounding)
FLOOR = 1e-5


@dataclass(frozen=True, eq=False)
class Transforms:
    """Transforms (signals, k, nf) and of the instrument (k, nf) over k segments or periods.

    `independent` averages a segment; `stationary` where each segment carries the same excitation;
    `density` turns |.|² into power per Hz (segments) or into the power of a line (periods), as `power_per`
    says; `line_overlap` is the FRF's; `excited` (nf,) marks the lines that the instrument feeds.
    """

    frequency_hz: Array
    signals: ComplexArray
    instrument: ComplexArray
    independent: float
    stationary: bool
    density: float
    power_per: str
    line_overlap: float
    excited: np.ndarray
    method: str
    notes: tuple[str, ...] = ()


def transform(recording: Recording, signals: Sequence[Array], instrument: Array, settings: Settings) -> Transforms:
    """Transforms of signals (n,) and their instrument (n,) of one recording; refuses one that is too short."""
    if recording.info.period_s is not None:
        if settings.resolution_hz is not None:
            raise WrongUseError(
                "a resolution is for records without a period",
                f"{settings.resolution_hz:g} Hz for {recording.info.file} with period {recording.info.period_s:g} s",
                "leave it out, or take period_s out of run.toml",
            )
        return _by_periods(recording, signals, instrument)
    return _by_segments(recording, signals, instrument, settings)


def fast_length(n: int) -> int:
    """Longest length up to n that transforms fast; at most a few per mille are cut off."""
    for length in range(n, max(n - n // 20, 1), -1):
        if next_fast_len(length, real=True) == length:
            return length
    return n


def _by_periods(recording: Recording, signals: Sequence[Array], instrument: Array) -> Transforms:
    rate = recording.rate_hz
    length, start, periods, notes = _periods(recording, instrument)
    part = slice(start, start + periods * length)
    N = period_spectra(instrument[part], length)
    X = np.stack([period_spectra(x[part], length) for x in signals])
    _check_period(recording, N)
    dropped = periods > 2 and any(_first_differs(x) for x in X)
    if dropped:
        X, N = X[:, 1:], N[1:]
    note = ", the first left out (not settled)" if dropped else ""
    return Transforms(
        frequency_hz=np.arange(length // 2 + 1, dtype=np.float64) * (rate / length),
        signals=X,
        instrument=N,
        independent=1.0,
        stationary=True,
        density=2.0,
        power_per="line",
        line_overlap=1.0,
        excited=_periodic_lines(N),
        method=f"{N.shape[0]} periods of {length / rate:g} s{note}",
        notes=notes,
    )


def _periods(recording: Recording, instrument: Array) -> tuple[int, int, int, tuple[str, ...]]:
    """Samples of a period as the excitation shows it, first sample, number of whole periods, and what was found.

    Refuses fewer than two periods.
    """
    info, rate, n = recording.info, recording.rate_hz, instrument.size
    samples = (info.period_s or 0.0) * rate
    if abs(samples - round(samples)) > 1e-6 * samples or samples < 2:
        raise BadSignalError(
            f"the period of recording {info.file} is no whole number of samples", f"{info.period_s} s at {rate:g} Hz"
        )
    stated, start = round(samples), round((info.periodic_from_s or 0.0) * rate)
    length = measured_period(instrument[start:], stated)
    periods = max(0, (n - start) // length)
    if periods < 2:
        raise BadSignalError(
            f"recording {info.file} holds {periods} whole period{'s' * (periods != 1)} of {info.period_s:g} s",
            f"{n / rate:g} s, periodic from {start / rate:g} s",
            "at least two are needed to separate noise from response",
        )
    note = (
        f"the excitation repeats every {length} samples ({length / rate:.9g} s), not every {stated} as stated: the"
        " measured period was used; correct period_s"
    )
    return length, start, periods, (note,) * (length != stated)


def measured_period(instrument: Array, stated: int, within: int = 5) -> int:
    """Samples after which an excitation (n,) repeats, looked for within `within` samples of the stated number.

    Another length counts where it leaves less than half of what the stated one leaves unrepeated, and that was more
    than noise: an excitation that repeats nowhere keeps the stated length, and is refused for it.
    """
    if instrument.size < 2 * stated + within or stated <= 2 * within:
        return stated
    lengths = range(stated - within, stated + within + 1)
    kept = min(instrument.size - stated - within, 8 * stated)
    first = instrument[:kept]
    left = [float(np.mean((instrument[k : k + kept] - first) ** 2)) for k in lengths]
    best = int(np.argmin(left))
    return lengths[best] if left[best] < 0.5 * left[within] else stated


def _check_period(recording: Recording, N: ComplexArray) -> None:
    """Refuse a period with which the excitation does not repeat."""
    later = N[1:] if N.shape[0] > 2 else N
    power = float((np.abs(later[:, 1:]) ** 2).mean(0).sum())
    scatter = float((np.abs(later[:, 1:] - later[:, 1:].mean(0)) ** 2).mean(0).sum())
    exact = recording.info.injection != "control"  # what was injected is known; a measured input has noise
    if scatter > (1e-3 if exact else 0.05) * power:
        raise BadSignalError(
            f"the excitation of recording {recording.info.file} does not repeat every {recording.info.period_s:g} s",
            f"{100.0 * scatter / power:.0f} % of its power differs between periods",
            "correct period_s or periodic_from_s, or leave them out",
        )


def _periodic_lines(N: ComplexArray) -> np.ndarray:
    """Lines that the instrument's mean period feeds, clear of its own scatter between periods."""
    mean = N.mean(0)
    power = np.abs(mean) ** 2
    scatter = (np.abs(N - mean) ** 2).sum(0) / max(N.shape[0] - 1, 1) / N.shape[0]
    excited = (power > FLOOR * power[1:].max()) & (power > 10.0 * scatter)
    excited[0] = excited[-1] = False
    return np.asarray(excited)


def _first_differs(X: ComplexArray) -> bool:
    """Whether the first period lies clearly outside the scatter of the others."""
    rest = X[1:, 1:]
    scatter = (np.abs(rest - rest.mean(0)) ** 2).sum() / (rest.shape[0] - 1)
    distance = (np.abs(X[0, 1:] - rest.mean(0)) ** 2).sum()
    return bool(distance > 2.0 * scatter * (1.0 + 1.0 / rest.shape[0]))


def _by_segments(recording: Recording, signals: Sequence[Array], instrument: Array, settings: Settings) -> Transforms:
    rate, n = recording.rate_hz, instrument.size
    length, step, segments = segments_of(recording, n, settings)
    window = hann(length)
    share = independent_share(segments, length, step, window)
    N = segment_spectra(instrument, length, step, window)
    excited = excited_lines((np.abs(N) ** 2).mean(0))
    text = f"Welch, Hann window, {length / rate:g} s segments, {100 * settings.overlap:.0f} % overlap"
    return Transforms(
        frequency_hz=np.arange(length // 2 + 1, dtype=np.float64) * (rate / length),
        signals=np.stack([segment_spectra(x, length, step, window) for x in signals]),
        instrument=N,
        independent=share,
        stationary=recording.info.kind != "sweep",
        density=2.0 / (rate * float(window @ window)),
        power_per="Hz",
        line_overlap=line_overlap(window),
        excited=excited,
        method=f"{text}, {segments * share:.1f} averages, {rate / length:.3g} Hz resolution",
    )


def excited_lines(power: Array) -> np.ndarray:
    """Lines (nf,) that an instrument of this power feeds by more than a window's leakage."""
    fed = power > FLOOR * power[2:].max()
    fed[:2] = fed[-1] = False  # the window smears the mean into the first line
    return clear_of_edges(fed, power)


def clear_of_edges(fed: np.ndarray, power: Array, steep: float = 0.3) -> np.ndarray:
    """Fed lines without the ends of each stretch where the power falls steeply outwards.

    Such lines are fed by the window's side lobes from one side, and what they show belongs to that side.
    """
    excited = fed.copy()
    edges = np.flatnonzero(np.diff(np.concatenate([[0], fed.astype(int), [0]])))
    for start, end in zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True):
        low, high = start, end - 1
        while low < high and power[low - 1] < steep * power[low]:
            low += 1
        while high > low and power[min(high + 1, power.size - 1)] < steep * power[high]:
            high -= 1
        excited[start:low] = excited[high + 1 : end] = False
    return np.asarray(excited)


def window_of(settings: Settings, length: int) -> Array:
    """The window (length,) that settings ask for."""
    if settings.window == "hann" and not settings.symmetric:
        return hann(length)
    from scipy.signal import get_window

    return np.asarray(get_window(settings.window, length, fftbins=not settings.symmetric), dtype=float)


#: of a record that a default resolution cuts into tenths, which need four samples each
LEAST_SAMPLES = 40


def segments_of(recording: Recording, n: int, settings: Settings) -> tuple[int, int, int]:
    """Length, step and number of segments; refuses a record with fewer than three averages."""
    rate = recording.rate_hz
    # a tenth of the record, at most 20 s or 512 samples: averages for a variance, lines for resonances
    own = min(n // 10, max(round(20.0 * rate), 512))
    required = float(settings.segment_samples or (rate / settings.resolution_hz if settings.resolution_hz else own))
    length = round(min(required, 2.0 * n + 4.0))  # longer than the record is too long, however long
    step = max(1, round(length * (1.0 - settings.overlap)))
    if settings.segment_samples is not None:
        step = max(1, length - int(length * settings.overlap + 1e-9))
    segments = (n - length) // step + 1 if n >= length else 0
    window = window_of(settings, length)
    averages = segments * independent_share(max(segments, 1), length, step, window) if length > 3 else 0.0
    if averages < 3.0:
        if settings.resolution_hz is None and settings.segment_samples is None:
            raise BadSignalError(
                f"recording {recording.info.file} is too short for an FRF", f"{n} samples in {n / rate:g} s",
                f"record {LEAST_SAMPLES} samples ({LEAST_SAMPLES / rate:.3g} s) at the least; for frequencies 1 Hz"
                " apart 5 s",
            )  # fmt: skip
        raise BadSignalError(
            f"recording {recording.info.file} is too short for a resolution of {rate / max(length, 1):.3g} Hz",
            f"{n / rate:g} s, which gives {averages:.1f} averages and three are needed",
            f"ask for {5.0 * rate / n:.2g} Hz or coarser, or record longer",
        )
    return length, step, segments


#: samples of a part: that many, or where this is more a share of the record, as each part passes over all lines
PART, SHARE = 1 << 20, 8


def low_lines(x: Array, last: int) -> ComplexArray:
    """Lines 0 to `last` (last + 1,), at most n // 2, of the transform of a signal (n,), as `numpy.fft.rfft` has them.

    n has a divisor near what is wanted if it is a fast length; of others the parts may be small and many.
    """
    n = x.size
    parts = _parts(n)
    size = n // parts
    lines = np.zeros(last + 1, dtype=complex)
    for r in range(parts):
        own = np.fft.rfft(x[r::parts])
        for start in range(0, last + 1, size):
            stop = min(start + size, last + 1)
            lines[start:stop] += _of_real(own, size, 0, stop - start) * _turns(n, r, start, stop)
    return lines


def quadrature(x: Array) -> Array:
    """The signal (n,) a quarter of a cycle later at each frequency (Hilbert's transform), without mean."""
    n = x.size
    parts = _parts(n)
    size = n // parts
    lines = low_lines(x, n // 2)
    lines *= -1j
    lines[0] = 0.0
    lines[(n + 1) // 2 :] = 0.0  # Nyquist's
    y = np.empty(n)
    for r in range(parts):
        own = np.zeros(size // 2 + 1, dtype=complex)
        for start in range(0, n, size):
            stop = start + own.size
            own += _of_real(lines, n, start, stop) * _turns(n, r, start, stop).conj()
        y[r::parts] = np.fft.irfft(own, size) / parts
    return y


def _parts(n: int) -> int:
    """Fewest parts of one size that is not above what is wanted."""
    fewest = -(-n // max(PART, -(-n // SHARE)))
    return next(parts for parts in range(fewest, n + 1) if n % parts == 0)


def _of_real(half: ComplexArray, n: int, start: int, stop: int) -> ComplexArray:
    """Lines start to stop (exclusive), up to n, of a real signal of n samples, of which `half` holds 0 to n // 2."""
    if stop <= half.size:
        return half[start:stop]
    above = half[n - stop + 1 : n - max(start, half.size) + 1]
    return np.concatenate([half[start:], above[::-1].conj()])


def _turns(n: int, r: int, start: int, stop: int) -> ComplexArray:
    """exp(-2 pi j r k / n) for k from start to stop (exclusive), from two tables whose angles are exact."""
    fine = int(np.sqrt(stop - start)) + 1
    coarse = start + fine * np.arange(-(-(stop - start) // fine))
    first, second = (np.exp(-1j * TWO_PI / n * (r * k % n)) for k in (coarse, np.arange(fine)))
    return np.asarray(np.outer(first, second).ravel()[: stop - start])
