"""Odd and even distortion of a periodic multisine: what a machine answers on lines that were not excited.

A nonlinearity answers a sum of sines with sums and differences of their frequencies. Where only odd multiples of a
lowest frequency are excited, symmetric (odd) nonlinearities - friction, play, saturation - answer on odd multiples,
asymmetric (even) ones on even multiples, and noise differs from period to period (Pintelon and Schoukens, System
Identification, 2nd ed. 2012, 4.3; Schoukens, Pintelon, Dobrowiecki, IEEE TIM 51, 2002).

Under feedback, or behind an amplifier that distorts itself, the plant's input U is not clean on those lines either.
What the plant makes of it linearly, G U with G interpolated between the excited lines, is taken off the output: under
feedback U is the loop's answer to the distortion, and Y - G U is the distortion as it would be with the loop open.
This is of first order: G's error times U stays. The logged input must be what acts on the plant; where it holds
errors of its own (a current sensor's), G U adds them, and a commanded input is the better choice.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import fdtrc

from loopshape.core.errors import BadSignalError
from loopshape.core.units import Array, ComplexArray, db
from loopshape.data.response.frf import FRF
from loopshape.data.result.estimates import Remark
from loopshape.data.signal.experiment import LoopSetup
from loopshape.data.signal.recording import Recording
from loopshape.data.signal.run import Run
from loopshape.identify.settings import Settings
from loopshape.identify.signals import loop_signals
from loopshape.identify.spectra.averages import against_instrument
from loopshape.identify.spectra.transforms import Transforms, transform
from loopshape.identify.tolerances import TOL

HOW = (
    "record an odd multisine that leaves out one odd line in four or so (lines at 1, 3, 5, 9, 11, 13, ... times its"
    " lowest frequency), four periods or more"
)


@dataclass(frozen=True, eq=False)
class Lines:
    """Amplitudes (n,) of sines on `frequency_hz` (n,) in the output's unit, and their noise, one standard deviation."""

    frequency_hz: Array
    amplitude: Array
    noise: Array

    def between(self, low_hz: float, high_hz: float) -> Lines:
        """The lines from `low_hz` up to but without `high_hz`."""
        rows = (self.frequency_hz >= low_hz) & (self.frequency_hz < high_hz)
        return Lines(self.frequency_hz[rows], self.amplitude[rows], self.noise[rows])

    @property
    def rms(self) -> float | None:
        """Root mean square amplitude of the lines with the noise's share taken off; None without lines."""
        if not self.amplitude.size:
            return None
        return float(np.sqrt(max(float(np.mean(self.amplitude**2 - self.noise**2)), 0.0)))

    @property
    def noise_rms(self) -> float | None:
        """Root mean square noise of the lines; None without lines."""
        return float(np.sqrt(np.mean(self.noise**2))) if self.noise.size else None


@dataclass(frozen=True, eq=False)
class DistortionBand:
    """Rms amplitudes a line in a band, in the output's unit; None where the excitation leaves no such lines there.

    `odd_seen` and `even_seen` say whether they exceed the noise.
    """

    band_hz: tuple[float, float]
    linear: float | None
    odd: float | None
    even: float | None
    noise: float | None
    odd_seen: bool = False
    even_seen: bool = False


@dataclass(frozen=True, eq=False)
class Distortion:
    """Odd and even distortion of one recording.

    `excited` holds the linear response with what distortion adds there; `odd` and `even` the lines that only such
    nonlinearities reach, None where the excitation leaves none; `mixed` those that both reach, because odd and even
    multiples were excited. `through_input` is the size of G U that was taken off, on all those lines together.
    `bands` are octaves. `verdict` says it in a sentence, also where the recording cannot tell.
    """

    recording: str
    loop: str
    unit: str
    periods: int
    excited: Lines | None
    odd: Lines | None
    even: Lines | None
    mixed: Lines | None
    through_input: Lines | None
    bands: tuple[DistortionBand, ...]
    verdict: str

    @property
    def decidable(self) -> bool:
        """Whether the recording can tell odd or even distortion at all."""
        return self.odd is not None or self.even is not None


def distortion(recording: Recording, loop: LoopSetup) -> Distortion:
    """Odd and even distortion of a loop's output in a recording that excites it with a multisine.

    Lines between the first and the last excited one are looked at. A drift along a straight line is taken off
    first. Where the record does not repeat, holds fewer than two periods, or leaves no line unexcited, the
    answer says so and what to record. The excited lines carry odd distortion too, which this cannot show. Refuses
    what `estimate_frf` refuses otherwise.
    """
    name, unit = recording.info.name, loop.output_unit
    cannot = _cannot(recording)
    if cannot:
        return Distortion(name, loop.name, unit, 0, None, None, None, None, None, (), cannot)
    s = loop_signals(recording, loop)
    t = transform(recording, [_without_drift(s.y, recording), s.u], s.instrument, Settings())
    bins = np.flatnonzero(t.excited)
    if bins.size < 2:
        raise BadSignalError(f"recording {recording.info.file} excites fewer than two frequencies of loop {loop.name}")
    own, through = _own_and_through(t, bins)
    kinds = {word: _lines(t, own, rows) for word, rows in _kinds(bins).items()}
    excited = _lines(t, t.signals[0], bins)
    quiet = np.setdiff1d(np.arange(bins[0], bins[-1] + 1), bins)
    decidable = [kinds.get(word) for word in ("odd", "even")]
    bands = _bands(excited, *decidable) if any(decidable) else ()
    return Distortion(
        recording=name,
        loop=loop.name,
        unit=unit,
        periods=int(t.signals.shape[1]),
        excited=excited,
        odd=decidable[0],
        even=decidable[1],
        mixed=kinds.get("mixed"),
        through_input=_lines(t, through, quiet) if quiet.size else None,
        bands=bands,
        verdict=_verdict(bands, kinds),
    )


def remarks(run: Run, recordings: Sequence[Recording], frfs: Sequence[FRF]) -> Iterator[Remark]:
    """What periodic recordings with lines left out say of distortion: one for each loop and operating point."""
    first: dict[object, Recording] = {}
    for recording in (r for r in recordings if r.info.alone and r.info.period_s is not None):
        first.setdefault((recording.info.excites, tuple(sorted(recording.info.operating_point.items()))), recording)
    for recording in first.values():
        it = distortion(recording, run.loop(str(recording.info.excites)))
        if it.decidable:
            yield Remark("distortion", f"{recording.info.name}: {it.verdict}")


def _cannot(recording: Recording) -> str:
    """Why the record's length and period cannot carry the analysis, empty where they can."""
    info = recording.info
    if info.period_s is None:
        return f"recording {info.name} does not repeat: distortion and noise cannot be separated; {HOW}"
    n = len(next(iter(recording.columns.values())))
    periods = int((n / recording.rate_hz - (info.periodic_from_s or 0.0)) / info.period_s + 1e-9)
    if periods < 2:
        return f"recording {info.name} holds {periods} whole period(s): distortion and noise cannot be separated; {HOW}"
    return ""


def _without_drift(y: Array, recording: Recording) -> Array:
    """The signal (n,) without the line through its periods' means; of many the first, settling, is left out."""
    info, rate = recording.info, recording.rate_hz
    length, start = round((info.period_s or 0.0) * rate), round((info.periodic_from_s or 0.0) * rate)
    means = y[start : start + (y.size - start) // length * length].reshape(-1, length).mean(axis=1)
    kept = means[1:] if means.size > 3 else means
    slope = float(np.polyfit(np.arange(kept.size), kept, 1)[0]) / length if kept.size > 2 else 0.0
    return np.asarray(y - slope * np.arange(y.size))


def _own_and_through(t: Transforms, bins: np.ndarray) -> tuple[ComplexArray, ComplexArray]:
    """The output's transforms (k, nf) without what comes through the input linearly, and that part."""
    Y, U = t.signals
    response = against_instrument(t)[bins]
    G = response[:, 0] / response[:, 1]
    at, f = np.log(bins), np.log(np.maximum(np.arange(Y.shape[1]), 1))
    between = np.exp(np.interp(f, at, np.log(np.abs(G))) + 1j * np.interp(f, at, np.unwrap(np.angle(G))))
    through = between * U
    return Y - through, through


def _kinds(bins: np.ndarray) -> dict[str, np.ndarray]:
    """Unexcited lines between the excited ones, by what reaches them: odd, even, or mixed."""
    base = int(np.gcd.reduce(bins))
    harmonics = np.setdiff1d(np.arange(bins[0] // base, bins[-1] // base + 1), bins // base)
    if np.all(bins // base % 2 == 1):
        found = {"odd": harmonics[harmonics % 2 == 1], "even": harmonics[harmonics % 2 == 0]}
    else:
        found = {"mixed": harmonics}
    return {word: base * rows for word, rows in found.items() if rows.size}


def _lines(t: Transforms, X: ComplexArray, rows: np.ndarray) -> Lines:
    """Amplitude of the mean over periods, and its noise from their scatter."""
    x = X[:, rows]
    mean, k = x.mean(axis=0), x.shape[0]
    variance = (np.abs(x - mean) ** 2).sum(axis=0) / (k - 1) / k
    return Lines(t.frequency_hz[rows], 2.0 * np.abs(mean), 2.0 * np.sqrt(variance))


def _bands(excited: Lines, odd: Lines | None, even: Lines | None) -> tuple[DistortionBand, ...]:
    """Octaves from the lowest excited line on."""
    low, high = float(excited.frequency_hz[0]), float(excited.frequency_hz[-1])
    edges = low * 2.0 ** np.arange(np.ceil(np.log2(high / low) - 1e-9) + 1)
    edges[-1] = high * (1.0 + 1e-9)
    return tuple(_band(a, b, excited, odd, even) for a, b in zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True))


def _band(low: float, high: float, excited: Lines, odd: Lines | None, even: Lines | None) -> DistortionBand:
    empty = Lines(np.empty(0), np.empty(0), np.empty(0))
    o, e = (empty if lines is None else lines.between(low, high) for lines in (odd, even))
    noise = Lines(*(np.concatenate([getattr(o, k), getattr(e, k)]) for k in ("frequency_hz", "amplitude", "noise")))
    linear = excited.between(low, high).rms
    return DistortionBand((low, high), linear, o.rms, e.rms, noise.noise_rms, _seen(o), _seen(e))


def _seen(lines: Lines) -> bool:
    """Whether amplitudes exceed their noise: F-test on powers, with the fewest freedoms the noise can have."""
    n = lines.amplitude.size
    if not n:
        return False
    power = float(np.mean(lines.noise**2))
    ratio = float(np.mean(lines.amplitude**2)) / power if power > 0.0 else np.inf
    return bool(fdtrc(2 * n, 2 * n, ratio) < TOL.distortion_by_chance) if np.isfinite(ratio) else True


def _verdict(bands: tuple[DistortionBand, ...], kinds: dict[str, Lines]) -> str:
    """The sentence: which kind, where, how far above the noise and below the linear response."""
    if "mixed" in kinds:
        return f"odd and even frequencies were excited, so the two kinds of distortion cannot be separated; {HOW}"
    if not kinds:
        return f"every frequency of the band was excited, so distortion does not show; {HOW}"
    seen = [b for b in bands if b.odd_seen or b.even_seen]
    missing = "" if "odd" in kinds else f"; odd distortion does not show, every odd frequency was excited: {HOW}"
    if not seen:
        return "no distortion exceeds the noise" + _floor(bands) + missing
    largest = max(seen, key=lambda b: max(_clear(b)))
    filled = [b for b in bands if b.odd is not None or "odd" not in kinds]
    return _sentence(largest, largest is filled[0] and len(filled) > 1, kinds) + missing


def _floor(bands: tuple[DistortionBand, ...]) -> str:
    floors = [float(db(b.noise / b.linear)) for b in bands if b.noise and b.linear]
    return f", which lies {-max(floors):.0f} dB and more below the linear response" if floors else ""


def _clear(b: DistortionBand) -> tuple[float, float]:
    """Odd and even level where they exceed the noise, else zero."""
    return (b.odd or 0.0) * b.odd_seen, (b.even or 0.0) * b.even_seen


def _sentence(b: DistortionBand, lowest: bool, kinds: dict[str, Lines]) -> str:
    odd, even = _clear(b)
    word, main, other, less = ("odd", odd, "even", even) if odd >= even else ("even", even, "odd", odd)
    noise = f"{float(db(main / b.noise)):.0f} dB above the noise and " if b.noise else ""
    linear = f"{-float(db(main / b.linear)):.0f} dB below the linear response " if b.linear else ""
    text = f"{word} distortion {noise}{linear}from {b.band_hz[0]:.3g} to {b.band_hz[1]:.3g} Hz"
    if other in kinds:
        text += f"; {other} {float(db(main / less)):.0f} dB lower" if less else f"; {other} not clear of the noise"
    return text + _likeness(word, main, less, lowest)


def _likeness(word: str, main: float, less: float, lowest: bool) -> str:
    """What such distortion is like; a hint, never a finding."""
    if less and db(main / less) < TOL.distortion_clear_db:
        return ": both symmetric and asymmetric"
    if word == "even":
        return ": asymmetric, as unequal valves, gravity or an offset"
    if not lowest:
        return ": symmetric, as play, saturation or a hardening spring"
    return (
        ": largest at the low end and symmetric, friction-like; half the amplitude shows which (the share of"
        " friction grows, that of a hardening spring falls)"
    )
