"""Sweeps, one way or both ways: local models of a whole record's transform, each line with a window of its own.

A sweep passes a frequency once or twice, so segments see each line too seldom to average. The transform of the whole
record sees it all: X(k) = H(k) R(k) + T(k) + V(k), and over neighbouring lines H and the transient T of start, end and
drift are smooth (Pintelon, Schoukens, Vandersteen, Barbe, MSSP 24, 2010). What is left over is noise, wherever in the
record it lies: what is heard while the sweep passes, and just before and after, counts where it is louder.

While a sweep passes f / m, a nonlinear plant answers at f too, at another time than when the sweep itself passes there
(Farina, AES 108, 2000; Novak, Simon, Kadlec, Lotton, IEEE TIM 59, 2010). In the record's transform that is a ripple
over frequency, sum_m H_m(k) R_m(k) with R_m of m times the sweep's phase: a narrow window takes it for the plant, a
wide one for noise, and it is neither. These harmonics are taken out before local models are fitted.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from loopshape.core.errors import BadSignalError
from loopshape.core.stretches import AT_ONCE, Signal
from loopshape.core.units import Array, ComplexArray
from loopshape.data.signal.excitation_kind import zero_crossings
from loopshape.data.signal.recording import Recording
from loopshape.identify.answers import Answers
from loopshape.identify.local.local_models import Fits, Shape, influences, solve, window_moments
from loopshape.identify.local.sweep_windows import HALVES, HEARD, POLYNOMIAL, RATIONAL, Chosen, Transient, choose
from loopshape.identify.settings import Settings
from loopshape.identify.spectra.averages import smoothed
from loopshape.identify.spectra.transforms import FLOOR, fast_length, low_lines, quadrature
from loopshape.identify.tolerances import TOL

#: lines lie this share of their frequency apart, or are the record's own
DENSE = 150


def by_sweep(
    recording: Recording, signals: Sequence[Signal], instrument: Signal, outputs: int, settings: Settings
) -> tuple[Answers, Harmonics]:
    """Answers of signals (n,), the first `outputs` of them plant outputs, to a sweep (n,), within the band it crosses.

    And the harmonics that were taken out.

    Lines are the record's own, thinned out to `DENSE` a frequency or to the resolution asked for. Signals are read one
    after the other, and their lines above the band are left out. Refuses a record whose band holds fewer lines than the
    narrowest window. Misleads where the plant changes while the sweep passes:
    one direction alone cannot show it.
    """
    n = fast_length(instrument.size)
    unit = recording.rate_hz / n
    low_hz, high_hz = swept_band(instrument, recording.rate_hz)
    low, high = max(2, int(0.5 * low_hz / unit)), min(n // 2 - 1, int(1.3 * high_hz / unit))
    lines = _grid(max(low, int(np.ceil(low_hz / unit))), min(high, int(high_hz / unit)), unit, settings)
    if high - low < 2 * HALVES[0] + 2 or lines.size < 2:
        raise BadSignalError(
            f"the sweep of recording {recording.info.file} crosses too few lines",
            f"{low_hz:.3g} to {high_hz:.3g} Hz with lines {unit:.3g} Hz apart",
            "record longer, or sweep a wider band",
        )
    z, scale = _transforms(signals, instrument, n, high)
    nonlinear = _harmonics(z, np.array(instrument[:n]), low, high, low_hz / unit)
    z[low : high + 1, 2:] -= nonlinear.added
    chosen, transient = choose(z, lines, low, high, outputs)
    response, covariance, power, freedom = _estimated(z, lines, chosen, transient, 1.0 - nonlinear.share[lines - low])
    to_unit, width = scale[2:] / scale[0], chosen.right - chosen.left + 1
    order = [*range(2, z.shape[1]), 0]
    density = 2.0 / (recording.rate_hz * recording.rate_hz / unit)
    share, fed = float(np.mean(chosen.rational)), power[:, 0, 0].real
    answers = Answers(
        frequency_hz=lines * unit,
        response=(response * to_unit)[:, :, None],
        covariance=covariance * (to_unit[:, None] * to_unit),
        power=(power * (scale[:, None] * scale))[:, order][:, :, order] * density,
        excited=fed > FLOOR * fed.max(),
        averages=float(np.median(width)),
        power_per="Hz",
        line_overlap=max(1.0, float(np.median(0.5 * TOL.sweep_overlap * width / np.gradient(lines.astype(float))))),
        freedom=freedom,
        pooled=2 * TOL.noise_pooled + 1,
        method=f"local fits of a sweep of {1.0 / unit:.4g} s, windows of {width.min() * unit:.3g} to"
        f" {width.max() * unit:.3g} Hz, {100.0 * share:.0f} % of lines by rationals"
        f"{nonlinear}",
        method_numbers={"sweep_s": 1.0 / unit, "rationals_percent": 100.0 * share},
    )
    return answers, nonlinear


def _transforms(signals: Sequence[Signal], instrument: Signal, n: int, high: int) -> tuple[ComplexArray, Array]:
    """Transforms up to line `high` (high + 1, 2 + m) of instrument, 1 and signals without their trends, each to unit
    power, and by what they were divided."""
    z, scale = np.ones((high + 1, 2 + len(signals)), dtype=complex), np.ones(2 + len(signals))
    for k, signal in ((0, instrument), *enumerate(signals, start=2)):
        x = _without_trend(np.asarray(signal[:n]))
        scale[k] = np.sqrt(_line_power(x))
        z[:, k] = low_lines(x, high) / scale[k]
    return z, scale


def _line_power(x: Array) -> float:
    """Mean square of the lines 0 to n // 2 of the transform of x (n,), by Parseval."""
    nyquist = x[::2].sum() - x[1::2].sum() if x.size % 2 == 0 else 0.0
    return float(0.5 * (x.size * (x @ x) + x.sum() ** 2 + nyquist**2) / (x.size // 2 + 1))


def _without_trend(x: Array) -> Array:
    """x (n,) without its mean and straight trend: what this takes from the sweep's own answer is smooth over lines."""
    x = x - x.mean()
    middle = 0.5 * (x.size - 1)
    parts = [slice(start, min(start + AT_ONCE, x.size)) for start in range(0, x.size, AT_ONCE)]
    moment = sum(float((np.arange(part.start, part.stop) - middle) @ x[part]) for part in parts)
    slope = moment / (middle * (middle + 1.0) * x.size / 3.0)  # the sum of squared distances from the middle
    for part in parts:
        x[part] -= slope * (np.arange(part.start, part.stop) - middle)
    return np.asarray(x)


def swept_band(instrument: Signal, rate_hz: float) -> tuple[float, float]:
    """Lowest and highest frequency in Hz that a sweep (n,) crosses: by its zero crossings, and one more at each end.

    Refuses a signal of fewer than four cycles.
    """
    at = _crossings(instrument) / rate_hz
    if at.size < 8:
        raise BadSignalError("a sweep has four cycles at least", f"{0.5 * at.size:g} of them", "record longer")
    f, t = 1.0 / (at[2:] - at[:-2]), 0.5 * (at[2:] + at[:-2])  # whole cycles: an offset moves every second crossing
    logarithmic = _straighter(np.log(f), t, f)
    reverse = instrument.size / rate_hz - t[::-1]
    ends = _before_first(f, t, logarithmic), _before_first(f[::-1], reverse, logarithmic)
    return float(min(f.min(), *ends)), float(min(max(f.max(), *ends), 0.5 * rate_hz))


def _crossings(x: Signal) -> Array:
    """Zero crossings of a sweep (n,) in samples: all of them, but of one with noise those that are clear."""
    clear, values = zero_crossings(x), np.asarray(x)
    values = values - values.mean()
    k = np.flatnonzero(np.diff(np.signbit(values)))
    return clear if k.size > clear.size + 2 else np.asarray(k + values[k] / (values[k] - values[k + 1]))


def _straighter(one: Array, at: Array, other: Array) -> bool:
    """Whether `one` (k,) is straighter over `at` than `other`, up to the latter's peak or from there on."""
    peak = int(np.argmax(other))
    part = slice(0, peak + 1) if peak >= at.size // 2 - 1 else slice(peak, None)
    return bool(abs(np.corrcoef(one[part], at[part])[0, 1]) > abs(np.corrcoef(other[part], at[part])[0, 1]))


def _before_first(f_hz: Array, at_s: Array, logarithmic: bool) -> float:
    """Frequency at time 0, or one and a half half-cycles earlier than the first of those of `f_hz` (k,) at `at_s`."""
    k = min(8, f_hz.size // 4)
    share = min(at_s[0], 1.5 / f_hz[0]) / (at_s[k] - at_s[0])
    found = f_hz[0] * (f_hz[0] / f_hz[k]) ** share if logarithmic else f_hz[0] - (f_hz[k] - f_hz[0]) * share
    return float(np.clip(found, 0.5 * f_hz[0], 2.0 * f_hz[0]))


def _grid(first: int, last: int, unit: float, settings: Settings) -> np.ndarray:
    """Lines from `first` to `last`: of the resolution asked for, else ever further apart; records of one length share
    them."""
    if settings.resolution_hz is not None:
        step = max(1, round(settings.resolution_hz / unit))
        return np.arange(-(-first // step) * step, last + 1, step)
    lines, k = [], 1
    while k <= last:
        lines.append(k)
        k += max(1, k // DENSE)
    found = np.array(lines, dtype=int)
    return found[found >= first]


def _estimated(
    z: ComplexArray, lines: np.ndarray, chosen: Chosen, transient: Transient, left_of_noise: Array
) -> tuple[ComplexArray, ComplexArray, ComplexArray, float]:
    """Responses (n, m), their covariance, cross-powers of z over each window, and degrees of freedom of a variance.

    `left_of_noise` (n,) is the share of the noise that z still holds.
    """
    n, m = lines.size, z.shape[1] - 2
    response, total = np.empty((n, m), dtype=complex), np.zeros((n, m, m), dtype=complex)
    held, gain, effective = np.empty_like(total), np.empty(n), np.empty(n)
    power = np.empty((n, m + 2, m + 2), dtype=complex)
    for shape, rows in ((POLYNOMIAL, np.flatnonzero(~chosen.rational)), (RATIONAL, np.flatnonzero(chosen.rational))):
        if not rows.size:
            continue
        left, right, expected = chosen.left[rows], chosen.right[rows], transient.select(rows)
        M = window_moments(z, lines[rows], left[:, None], right[:, None], shape.powers)[:, 0]
        count, ridge = (right - left + 1).astype(float), expected.ridge(left, right)
        fits = solve(M, count, shape, ridge)
        response[rows], gain[rows] = fits.response, fits.inverse[:, 0, 0].real
        power[rows] = M[:, 0].conj() / count[:, None, None]
        held[rows] = _held(fits, ridge, expected, 0.5 * (right - left))
        total[rows], effective[rows] = influences(z, lines[rows], left, right, shape.order, fits)
    noise = smoothed(np.asarray(total / gain[:, None, None], dtype=complex), TOL.noise_pooled)
    passing = np.einsum("nxx->n", chosen.passing).real > 0.0
    noise[passing] = chosen.passing[passing]
    gain = gain / left_of_noise
    width = chosen.right - chosen.left + 1.0
    freedom = 2.0 * effective * (1.0 + 2 * TOL.noise_pooled * np.gradient(lines.astype(float)) / width)
    freedom = np.where(passing, np.minimum(freedom, HEARD), freedom)
    return response, np.asarray(noise * gain[:, None, None] + held), power, float(np.median(freedom))


def _held(fits: Fits, ridge: Array, transient: Transient, half: Array) -> ComplexArray:
    """Covariance (n, m, m) of what a transient held to its expected size may still leave in the responses."""
    terms = np.arange(ridge.shape[1])
    share = np.abs(fits.inverse[:, 0, -terms.size :] * ridge) ** 2 * half[:, None] ** (2.0 * terms)
    return np.asarray(np.einsum("ns,nsxy->nxy", share, transient.covariance))


#: highest harmonic looked for
_HIGHEST = 12
#: half a window: this share of its frequency, if that is not as many lines up to another share, or fewer lines at worst
_WIDTH, _ENOUGH, _WIDEST, _LEAST = 0.1, 40, 0.4, 20
#: what is tried for the sweep's own answer over a window, none, one or two resonances, and the order of a harmonic's
_SHAPES, _ORDER = (Shape(2, 0), Shape(2, 2), Shape(4, 4)), 2


@dataclass(frozen=True, eq=False)
class Harmonics:
    """What a sweep's harmonics add: to the transforms (lines, m) from line `low` on, the share (lines,) of the noise
    that went with them, and which were found (their numbers)."""

    low: int
    added: ComplexArray
    share: Array
    harmonics: tuple[int, ...]

    def __str__(self) -> str:
        numbers = ", ".join(str(m) for m in self.harmonics)
        return f", without the sweep's harmonic{'s' * (len(self.harmonics) > 1)} {numbers}" * bool(self.harmonics)


def _harmonics(z: ComplexArray, instrument: Array, low: int, high: int, lowest: float) -> Harmonics:
    """The harmonics in lines [low, high] of z (nf, 2 + m), an instrument's transform, 1 and answers.

    `instrument` (n,) is the sweep over time, from line `lowest` on: harmonic m begins at m times that. It is used up.
    A harmonic that resonances or noise may explain as well is left where it is.
    """
    inputs = _inputs(instrument, low, high)
    middle, half = _windows(low, high)
    added = np.zeros((high + 1 - low, z.shape[1] - 2), dtype=complex)
    share = np.zeros(high + 1 - low)
    found: set[int] = set()
    left, right = middle - half, middle + half
    M = window_moments(z, middle, left[:, None], right[:, None], _SHAPES[-1].powers)[:, 0]
    count = right - left + 1.0
    fits = [(shape, solve(M, count, shape)) for shape in _SHAPES]
    windows = []
    for i, (c, h) in enumerate(zip(middle, half, strict=True)):
        k, t = np.arange(c - h, c + h + 1), np.arange(-h, h + 1) / h
        residuals = min((_residuals(z[k], t, *x, i) for x in fits), key=lambda r: float(np.prod(_energy(r))))
        here = slice(c - h, c + h + 1)
        beyond = inputs[: max(0, int(c / lowest) - 1), here.start - low : here.stop - low]
        windows.append(_Window(k, t, z[here, 0], residuals, beyond))
    apart = [window.apart() for window in windows]
    taken = [window.explained(those)[1] for window, those in zip(windows, apart, strict=True)]
    often = {j for those in taken for j in those if _times(j, taken) >= max(2.0, TOL.harmonic_often * _times(j, apart))}
    for i, (window, those) in enumerate(zip(windows, apart, strict=True)):
        part, chosen = window.explained([j for j in those if j in often])
        k, weight = window.lines, np.interp(window.lines, middle, np.eye(middle.size)[i])
        added[k - low] += weight[:, None] * part
        share[k - low] += weight * len(chosen) * (_ORDER + 1) / k.size
        found.update(j + 2 for j in chosen)
    return Harmonics(low, added, share, tuple(sorted(found)))


def _times(j: int, lists: list[list[int]]) -> int:
    return sum(j in those for those in lists)


def _inputs(instrument: Array, low: int, high: int) -> ComplexArray:
    """Transforms (_HIGHEST - 1, lines) of a sweep, which is used up, at 2, 3, ... times its phase, up to Nyquist."""
    size, phase, most = _analytic(instrument)
    found = np.empty((_HIGHEST - 1, high + 1 - low), dtype=complex)
    wave = instrument
    for m in range(2, _HIGHEST + 1):
        np.multiply(m, phase, out=wave)
        np.cos(wave, out=wave)
        wave *= size
        wave[most < m] = 0.0
        found[m - 2] = low_lines(wave, high)[low:]
    return found


def _analytic(x: Array) -> tuple[Array, Array, np.ndarray]:
    """Amplitude (n,) and phase (n,) in rad of a sweep over time, and its highest harmonic (n,) below Nyquist.

    The sweep's mean is taken from it in place.
    """
    x -= x.mean()
    y = quadrature(x)
    size = np.hypot(x, y)
    phase = np.arctan2(y, x, out=y)
    most = np.empty(phase.size, dtype=np.int8)
    for start in range(0, phase.size, AT_ONCE):
        first, stop = max(start - 1, 0), min(start + AT_ONCE, phase.size)
        step = np.gradient(np.unwrap(phase[first : stop + 1]))[start - first : stop - first]
        most[start:stop] = np.where(step * _HIGHEST < np.pi, _HIGHEST, np.ceil(np.pi / np.maximum(step, 0.1)) - 1.0)
    return size, phase, most


def _windows(low: int, high: int) -> tuple[np.ndarray, np.ndarray]:
    """Middles and half widths of windows within [low, high], each reaching to the next one's middle."""

    def width(c: int) -> int:
        return min(max(_LEAST, min(_ENOUGH, int(_WIDEST * c)), int(_WIDTH * c)), (high - low) // 2)

    half = [width(low)]
    middle = [low + half[0]]
    while middle[-1] + half[-1] < high:
        middle.append(middle[-1] + half[-1])
        half.append(width(middle[-1]))
        middle[-1] = min(middle[-1], high - half[-1])
    return np.array(middle), np.array(half)


def _residuals(z: ComplexArray, t: Array, shape: Shape, fits: Fits, i: int) -> ComplexArray:
    """What the fit over window i leaves of its answers, (lines, m)."""
    powers = t[:, None] ** np.arange(shape.order + 1)
    shaped = np.hstack([z[:, :1] * powers, powers]) @ fits.theta[i]
    denominator = fits.denominator[i]
    return np.asarray(z[:, 2:] - shaped / (powers[:, : denominator.size] @ denominator)[:, None])


@dataclass(frozen=True, eq=False)
class _Window:
    """Lines (n,), t over half of them, the sweep there, what a fit leaves of the answers (n, m), harmonics' inputs."""

    lines: np.ndarray
    t: Array
    sweep: ComplexArray
    residuals: ComplexArray
    inputs: ComplexArray

    def apart(self) -> list[int]:
        """Which harmonics pass at another time than the sweep."""
        # a harmonic passes with the sweep, not apart, that the sweep times a polynomial of this order explains
        smooth = np.linalg.qr(self.sweep[:, None] * np.polynomial.chebyshev.chebvander(self.t, 8))[0]
        return [j for j, x in enumerate(self.inputs) if _energy(smooth.conj().T @ x) < TOL.harmonic_apart * _energy(x)]

    def explained(self, among: list[int]) -> tuple[ComplexArray, list[int]]:
        """What harmonics explain of the residuals, and which of those named these are."""
        powers = self.t[:, None] ** np.arange(_ORDER + 1)
        base = np.hstack([self.sweep[:, None] * powers, powers])
        basis = np.linalg.qr(base)[0]
        left = self.residuals - basis @ (basis.conj().T @ self.residuals)
        start = size = _energy(left)
        taken: list[int] = []
        while len(taken) < len(among):
            spans = {j: _span(self.inputs[j][:, None] * powers, basis) for j in among if j not in taken}
            less = {j: float(np.mean(_energy(span.conj().T @ left) / size)) for j, span in spans.items()}
            best = max(less, key=less.__getitem__)
            free = self.t.size - basis.shape[1]
            if free < 4 * powers.shape[1] or less[best] < TOL.harmonic_clear * powers.shape[1] / free:
                break
            taken.append(best)
            basis = np.hstack([basis, spans[best]])
            left = left - spans[best] @ (spans[best].conj().T @ left)
            size = _energy(left)
        # no machine has higher ones alone
        if not {0, 1} & set(taken) or float(np.mean(size / start)) > TOL.harmonic_leaves:
            return np.zeros_like(self.residuals), []
        columns = np.hstack([base, *(self.inputs[j][:, None] * powers for j in taken)])
        columns /= np.sqrt(_energy(columns))
        theta = np.linalg.lstsq(columns, self.residuals, rcond=None)[0]
        return np.asarray(columns[:, base.shape[1] :] @ theta[base.shape[1] :]), taken


def _span(columns: ComplexArray, basis: ComplexArray) -> ComplexArray:
    """An orthonormal basis of what of columns (lines, p) lies outside of `basis` (lines, q)."""
    return np.linalg.qr(columns - basis @ (basis.conj().T @ columns))[0]


def _energy(x: ComplexArray) -> Array:
    return np.maximum((np.abs(x) ** 2).sum(axis=0), 1e-300)
