"""Local estimates of a whole record: window and order chosen by how well they predict lines left out.

A window wide enough to average is wide enough to round off. What a chosen window rounds off is seen against one half as
wide, and counts in the covariance: a variance alone would call a rounded-off resonance well known.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import uniform_filter1d

from loopshape.core.errors import BadSignalError
from loopshape.core.units import Array, ComplexArray
from loopshape.data.signal.recording import Recording
from loopshape.identify.answers import Answers, plant_of
from loopshape.identify.local.local_fits import LocalFit, Window, fit_lines, predicted
from loopshape.identify.settings import Settings
from loopshape.identify.spectra.input_power import powered
from loopshape.identify.spectra.transforms import fast_length
from loopshape.identify.tolerances import TOL

HALVES = (6, 8, 12, 16, 24, 32, 48, 64, 96, 128, 192, 256, 384)
#: order of the polynomials and degree of the denominator
SHAPES = ((0, 0), (2, 0), (4, 0), (2, 2))
GROUPS, TOGETHER = 40, 9
#: outputs by which a window is chosen, where there are more
TRIED = 4
#: lines fitted at a time times their windows' lengths, which bounds memory
CHUNK = 12_000


@dataclass(frozen=True, eq=False)
class Lines:
    """Transforms of a whole record: signals (m, nf), instruments (nr, nf), and the stretch of lines that is excited."""

    frequency_hz: Array
    X: ComplexArray
    R: ComplexArray
    low: int
    high: int
    outputs: int
    density: float

    @property
    def count(self) -> int:
        """Excited lines."""
        return self.high - self.low + 1


@dataclass(frozen=True, eq=False)
class Choice:
    """The window chosen, and its mean logarithmic error of prediction, per frequency of the groups it was tried on."""

    window: Window
    error: Array
    groups: np.ndarray


def by_local_fits(
    recording: Recording,
    signals: Sequence[Array],
    instruments: Sequence[Array],
    outputs: int,
    settings: Settings,
) -> tuple[Answers, Choice, Lines]:
    """Answers of signals (n,), the first `outputs` of them plant outputs, to instruments (n,), and how it was chosen.

    Refuses a record with fewer excited lines in one stretch than the narrowest window needs.
    """
    lines = _lines(recording, signals, instruments, outputs)
    choice = _choose(recording, lines)
    return _answers(recording, lines, choice, settings), choice, lines


def _lines(recording: Recording, signals: Sequence[Array], instruments: Sequence[Array], outputs: int) -> Lines:
    n = fast_length(instruments[0].size)
    rate = recording.rate_hz
    X, R = (np.stack([np.fft.rfft(x[:n] - x[:n].mean()) for x in xs]) for xs in (signals, instruments))
    low, high = _stretch(R)
    return Lines(np.arange(X.shape[1], dtype=np.float64) * (rate / n), X, R, low, high, outputs, 2.0 / (rate * n))


def _stretch(R: ComplexArray) -> tuple[int, int]:
    """First and last line of the longest stretch (in octaves) that every instrument excites."""
    hann = 0.5 * R
    hann[:, 1:] -= 0.25 * R[:, :-1]
    hann[:, :-1] -= 0.25 * R[:, 1:]
    power = uniform_filter1d(np.einsum("af,bf->fab", hann, hann.conj()), 9, axis=0, mode="nearest")
    fed = powered(power)
    fed[:2] = fed[-1] = False
    edges = np.flatnonzero(np.diff(np.concatenate([[0], fed.astype(int), [0]])))
    stretches = [(a, b - 1) for a, b in zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True)]
    low, high = max(stretches, key=lambda s: (s[1] + 1) / s[0] if s[1] > s[0] else 0.0, default=(1, 0))
    inset = 4 if high - low > 40 else 0  # where the moving mean reaches over the end
    return low + inset if low > 1 else low, high - inset if high < R.shape[1] - 2 else high


def _choose(recording: Recording, lines: Lines) -> Choice:
    """The window whose fits predict lines left out best, over groups of neighbours spread over the band."""
    windows = [
        Window(half, *shape)
        for shape in SHAPES
        for half in HALVES
        if 2 * half + 1 >= Window(half, *shape).unknowns(lines.R.shape[0]) + TOL.local_freedom
        and 2 * half + 1 <= 0.5 * lines.count
    ]
    if not windows:
        raise BadSignalError(
            f"recording {recording.info.file} excites too few frequencies in one stretch for local fits",
            f"{max(lines.count, 0)} lines",
            "record longer, or ask for Welch's method",
        )
    groups, tried = _groups(lines), _some_outputs(lines)
    errors = np.empty((len(windows), groups.size))
    for shape in SHAPES:
        alike = [k for k, w in enumerate(windows) if (w.order, w.poles) == shape]
        if alike:
            errors[alike] = _prediction_errors(tried, groups, [windows[k] for k in alike])
    score = errors.mean(axis=1) + TOL.poles_pay_ln * np.array([w.poles > 0 for w in windows])
    best = int(score.argmin())
    alike = [k for k, w in enumerate(windows) if (w.order, w.poles) == (windows[best].order, windows[best].poles)]
    chosen = min((k for k in alike if score[k] <= score[best] + TOL.as_good_ln), key=lambda k: windows[k].half)
    return Choice(windows[chosen], errors[chosen], groups)


def _some_outputs(lines: Lines) -> Lines:
    """A few of many outputs, and all plant inputs: enough to choose a window by."""
    if lines.outputs <= TRIED:
        return lines
    rows = np.unique(np.linspace(0, lines.outputs - 1, TRIED).round().astype(int))
    kept = np.concatenate([lines.X[rows], lines.X[lines.outputs :]])
    return replace(lines, X=kept, outputs=rows.size)


def _groups(lines: Lines) -> np.ndarray:
    """Middles (groups,) of groups of neighbouring lines, half of them equally spaced, half by octaves."""
    half = TOGETHER // 2
    first, last = lines.low + half, lines.high - half
    each = GROUPS // 2
    middles = np.concatenate([np.linspace(first, last, each), np.geomspace(first, last, each)])
    return np.unique(np.round(middles).astype(int))


def _prediction_errors(lines: Lines, groups: np.ndarray, windows: Sequence[Window]) -> Array:
    """Logarithm of the power (windows, groups) by which lines left out are missed: y - P u for each output, per Hz, by
    windows of one order and degree, narrowest first."""
    half = TOGETHER // 2
    every = (groups[:, None] + np.arange(-half, half + 1)).ravel()
    response, left_out = predicted(lines.X, lines.R, every, lines.low, lines.high, windows)
    missed = [np.abs(_of_plant(H, e, lines.outputs)) ** 2 for H, e in zip(response, left_out, strict=True)]
    power = np.stack(missed).reshape(len(windows), groups.size, TOGETHER, lines.outputs).mean(axis=2)
    return np.asarray(np.log(lines.density * power + 1e-300).mean(axis=-1))


def _of_plant(response: ComplexArray, left_out: ComplexArray, outputs: int) -> ComplexArray:
    """y - P u (n, ny) of residuals (n, m) of outputs and inputs."""
    if response.shape[1] == outputs:
        return left_out
    if response.shape[2] != response.shape[1] - outputs:  # one column of several: inputs are not all known here
        return left_out[:, :outputs]
    with np.errstate(all="ignore"):
        P = response[:, :outputs] @ np.linalg.pinv(response[:, outputs:])
    return np.asarray(left_out[:, :outputs] - np.einsum("nab,nb->na", P, left_out[:, outputs:]))


def _chunks(lines: np.ndarray, window: Window) -> Iterator[np.ndarray]:
    size = max(1, CHUNK // (2 * window.half + 1))
    for k in range(0, lines.size, size):
        yield lines[k : k + size]


def _answers(recording: Recording, lines: Lines, choice: Choice, settings: Settings) -> Answers:
    """Answers at every so many lines of the record: as asked, else so that nothing that is sought falls between them.

    Answers to a closed loop's instrument are smooth where the plant resonates: what is sought is the plant.
    """
    most_lines, most_numbers = 5000, 4_000_000  # lines of an estimate, and numbers in its covariance
    most = min(most_lines, most_numbers // (lines.X.shape[0] * lines.R.shape[0]) ** 2)
    window, least = choice.window, max(1, -(-lines.count // most))
    if settings.resolution_hz is not None:
        return _at_every(recording, lines, window, max(1, round(settings.resolution_hz / lines.frequency_hz[1])))
    # a denominator follows what is sharper than the window
    step = max(least, window.half // (4 if window.poles == 0 else 24))
    answers = _at_every(recording, lines, window, step)
    while step > least and (finer := _fine_enough(answers, lines.outputs, step)) < step:
        step = max(least, finer)
        answers = _at_every(recording, lines, window, step)
    return answers


def _fine_enough(answers: Answers, outputs: int, step: int) -> int:
    """The step with which straight lines between the lines miss what is sought by less than its standard deviation."""
    sought, std = _sought(answers, outputs)
    bend = np.abs(np.diff(sought, 2, axis=0)) / 8.0
    seen = 1e-3  # what is bent by less than this between two lines, relative to itself, counts as straight
    worst = float(np.max(bend / np.maximum(std, seen * np.abs(sought))[1:-1], initial=0.0))
    return max(1, int(step / np.sqrt(worst))) if worst > 1.0 else step


def _sought(answers: Answers, outputs: int) -> tuple[ComplexArray, Array]:
    """The plant's elements and their standard deviations (n, elements); of one column of several, y over its input."""
    n, m, nr = answers.response.shape
    if m in (outputs, outputs + nr):
        plant = plant_of([answers], outputs)
        std = np.sqrt(np.einsum("nii->ni", plant.covariance).real)
        return plant.response.transpose(0, 2, 1).reshape(n, -1), std
    H, variance = answers.response[:, :, 0], np.einsum("nii->ni", answers.covariance).real[:, :m]
    u = outputs + int(np.median(np.abs(H[:, outputs:]), axis=0).argmax())
    sought, size = H[:, :outputs] / H[:, u : u + 1], np.abs(H[:, u : u + 1])
    return sought, np.sqrt(variance[:, :outputs] + np.abs(sought) ** 2 * variance[:, u : u + 1]) / size


def _at_every(recording: Recording, lines: Lines, window: Window, step: int) -> Answers:
    """Answers at every `step`-th line: at multiples of it, so that records share lines."""
    n = 2 * (lines.frequency_hz.size - 1)
    at = np.arange(-(-lines.low // step) * step, lines.high + 1, step)
    (response, covariance, apart, power), independent = _all_lines(lines, at, window)
    bias = _rounded_off(apart, max(5, window.half // step))
    return Answers(
        frequency_hz=lines.frequency_hz[at],
        response=response,
        covariance=covariance + bias,
        power=power,
        excited=np.ones(at.size, dtype=bool),
        averages=float(2 * window.half + 1),
        power_per="Hz",
        line_overlap=max(1.0, _overlap(lines, int(at[at.size // 2]), window) / step),
        freedom=2.0 * independent,
        pooled=1,
        method=f"{window.words} of {n / recording.rate_hz:.4g} s, {lines.frequency_hz[1] * step:.3g} Hz apart",
        method_numbers={"record_s": n / recording.rate_hz, "resolution_hz": float(lines.frequency_hz[1] * step)},
    )


def _all_lines(lines: Lines, at: np.ndarray, window: Window) -> tuple[tuple[ComplexArray, ...], float]:
    """Response, its noise's covariance, what a narrower window says otherwise beyond noise, cross-powers, (n, ...), and
    how many residuals the covariance rests on.
    """
    narrow, both = _narrower(window, lines.R.shape[0]), np.concatenate([lines.X, lines.R])
    found: list[tuple[ComplexArray, ...]] = []
    independent = []
    for part in _chunks(at, window):
        fit = fit_lines(lines.X, lines.R, part, lines.low, lines.high, window)
        apart = np.zeros_like(fit.spread)
        if narrow is not None:
            apart = _apart(fit, fit_lines(lines.X, lines.R, part, lines.low, lines.high, narrow))
        rows = fit.first[:, None] + np.arange(2 * window.half + 1)
        near = both[:, rows].transpose(1, 0, 2)
        power = near @ near.conj().transpose(0, 2, 1) * (lines.density / rows.shape[1])
        found.append((fit.response, fit.spread, apart, power))
        independent.append(fit.independent)
    return tuple(np.concatenate(x) for x in zip(*found, strict=True)), float(np.median(independent))


def _narrower(window: Window, instruments: int) -> Window | None:
    """The same shape over half as many lines, where that leaves freedom enough."""
    halves = [h for h in HALVES if h <= window.half // 2]
    made = Window(halves[-1], window.order, window.poles) if halves else None
    if made is None or 2 * made.half + 1 < made.unknowns(instruments) + 2:
        return None
    return made


def _apart(wide: LocalFit, narrow: LocalFit) -> ComplexArray:
    """d d^H less the covariance that noise gives d, the difference (n, m nr) of both fits' responses."""
    alike = slice(0, 1) if wide.residual is None else slice(None)  # polynomials weigh all answers alike
    weights = np.array(wide.weights[:, alike])
    n, _, _, short = narrow.weights.shape
    columns = (narrow.first - wide.first)[:, None] + np.arange(short)
    rows = np.arange(n)[:, None]
    weights.transpose(0, 3, 1, 2)[rows, columns] -= narrow.weights[:, alike].transpose(0, 3, 1, 2)
    d = (wide.response - narrow.response).transpose(0, 2, 1).reshape(n, -1)
    return np.einsum("na,nb->nab", d, d.conj()) - wide.spread_of(weights, narrow.scatter)


def _rounded_off(apart: ComplexArray, half: int) -> ComplexArray:
    """Mean of `apart` over neighbouring lines, without what is negative: what the window rounds off, squared."""
    half = min(half, apart.shape[0] - 1)
    padded = np.pad(apart, ((half, half), (0, 0), (0, 0)), mode="reflect")
    total = np.cumsum(np.concatenate([np.zeros_like(padded[:1]), padded]), axis=0)
    mean = (total[2 * half + 1 :] - total[: -(2 * half + 1)]) / (2 * half + 1)
    large = 24  # from this size on only variances are kept of what is rounded off
    if apart.shape[1] > large:
        diagonal = np.maximum(np.einsum("nii->ni", mean).real, 0.0)
        return np.asarray(diagonal[:, :, None] * np.eye(apart.shape[1]), dtype=complex)
    values, vectors = np.linalg.eigh(0.5 * (mean + mean.conj().transpose(0, 2, 1)))
    return np.asarray((vectors * np.maximum(values, 0.0)[:, None, :]) @ vectors.conj().transpose(0, 2, 1))


def _overlap(lines: Lines, at: int, window: Window) -> float:
    """How many neighbouring lines of the record carry one line's worth of independent error, at one line."""
    half = min(2 * window.half, max(at - lines.low - window.half, lines.high - window.half - at, 0))
    near = np.clip(np.arange(at - half, at + half + 1), lines.low, lines.high)
    fits = [fit_lines(lines.X, lines.R, part, lines.low, lines.high, window) for part in _chunks(near, window)]
    weights = np.concatenate([f.weights[:, 0, 0] for f in fits])
    first = np.concatenate([f.first for f in fits])
    spread = np.zeros((near.size, int(first.max() - first.min()) + weights.shape[1]), dtype=complex)
    spread[np.arange(near.size)[:, None], (first - first.min())[:, None] + np.arange(weights.shape[1])] = weights
    size = np.linalg.norm(spread, axis=1)
    alike = np.abs(spread.conj() @ spread[near.size // 2]) / (size * size[near.size // 2])
    return float(np.sum(alike**2))


def compared(choice: Choice, lines: Lines, other: Answers) -> float:
    """Mean logarithm of the error's power that `other` predicts lines with, less the local fits': positive is worse."""
    outputs, (nf, m, nr) = lines.outputs, other.response.shape
    solved = m in (outputs, outputs + nr)  # else one column of several: what the outputs answer to it is compared
    P = plant_of([other], outputs).response if solved else other.response[:, :outputs]
    left = np.zeros((nf, outputs, m + nr), dtype=complex)
    left[:, :, :outputs] = np.eye(outputs)
    first = outputs if solved else m  # plant inputs come after the outputs, where there are any, then instruments
    left[:, :, first : first + P.shape[2]] = -P
    error = np.real(np.einsum("fai,fij,faj->fa", left, other.power, left.conj()))
    k = other.averages
    error = np.log(np.maximum(error * (k / (k - P.shape[2])) * (1.0 + P.shape[2] / k), 1e-300)).mean(axis=1)
    usable = np.flatnonzero(other.excited & np.isfinite(error))
    if not usable.size:
        return np.inf
    f = lines.frequency_hz[choice.groups]
    inside = (f >= other.frequency_hz[usable[0]]) & (f <= other.frequency_hz[usable[-1]])
    at = np.interp(f[inside], other.frequency_hz[usable], error[usable])
    return float(np.mean(at - choice.error[inside])) if inside.any() else np.inf
