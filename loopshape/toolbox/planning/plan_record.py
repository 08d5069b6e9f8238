"""What a first recording tells a planner: response, noise, how input and output follow what is injected.

The error of G at a line is E over the part of U that the instrument N causes, with E = Y - G U: the noise of the output
as it would be with the loop open (Pintelon and Schoukens 2012, ch. 2). It is read off what the record leaves
unexplained: the scatter between periods, or what local fits leave over (ibid., ch. 7), both free of the transients that
segments show.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from loopshape.core.errors import BadSignalError, WrongUseError
from loopshape.core.units import Array, ComplexArray
from loopshape.data.response.frf import FRF
from loopshape.data.signal.experiment import LoopSetup
from loopshape.data.signal.recording import Recording
from loopshape.identify.answers import Answers
from loopshape.identify.frequency_response import estimate_frf
from loopshape.identify.local.local import CHUNK
from loopshape.identify.local.local_fits import Window, fit_lines
from loopshape.identify.respond import respond
from loopshape.identify.settings import Settings
from loopshape.identify.signals import LoopSignals, loop_signals
from loopshape.identify.spectra.transforms import transform
from loopshape.toolbox.rig.distortion import Distortion, distortion

#: sqrt(E|d|²)/|H| below which a response to the instrument is one
KNOWN = 0.3
#: noise is averaged over a third of an octave to both sides
BAND_FACTOR = 2.0 ** (1.0 / 3.0)
#: lines to each side, order and poles of the fits that leave the noise over
WINDOW = Window(8, 2, 0)


@dataclass(frozen=True, eq=False)
class FirstRecord:
    """A first recording on the frequencies of the valid band (nf,) of its FRF; signals in stored units.

    `plant` is G, `to_input` U/N, `to_output` Y/N, `noise` the power of Y - G U per Hz (one-sided), known as the mean of
    `averages` (nf,) independent values; `std` the relative std of |G| as the record gives it. `input_rest` is the mean
    of u, `input_noise` and `output_noise` the rms of what the instrument does not cause, `input_caused` that of what it
    does, `amplitude` the instrument's own peak about its mean. `distortion` is None where the record does not repeat.
    """

    recording: Recording
    loop: LoopSetup
    frf: FRF
    plant: ComplexArray
    to_input: ComplexArray
    to_output: ComplexArray
    noise: Array
    averages: Array
    std: Array
    input_rest: float
    input_noise: float
    input_caused: float
    output_noise: float
    amplitude: float
    distortion: Distortion | None

    @property
    def frequency_hz(self) -> Array:
        """Valid lines (nf,) in Hz."""
        return self.frf.frequency_hz


def first_record(recording: Recording, loop: LoopSetup, settings: Settings | None = None) -> FirstRecord:
    """What a recording that excites one loop tells; refuses what `estimate_frf` refuses, and one without a valid band.

    Distortion of a record that does not repeat counts as noise here, and periods will not average it away.
    """
    if recording.info.excites_also:
        raise WrongUseError(
            f"recording {recording.info.file} excites several loops at once",
            ", ".join(recording.info.excited),
            "plan from a recording that excites one loop",
        )
    settings = settings or Settings()
    every = estimate_frf(recording, loop, settings)
    frf = every.valid_lines()
    s = loop_signals(recording, loop)
    answers = respond(recording, [s.y, s.u], [s.instrument], 1, settings)
    all_lines = answers.select(np.isin(answers.frequency_hz, every.frequency_hz))
    mine = answers.select(np.isin(answers.frequency_hz, frf.frequency_hz))
    moved = _moved(mine)
    if not moved.any():
        raise BadSignalError(
            f"what is injected in recording {recording.info.file} does not exceed the noise",
            "under feedback its FRF is then that of the inverse controller",
            "excite more, or measure longer",
        )
    frf, mine = frf.select(moved), mine.select(moved)
    f, G = frf.frequency_hz, frf.siso
    at, power, averages = _noise(recording, s, every, settings)
    noise, count = smoothed_over_octaves(at, power, averages, f)
    input_noise = _unexplained(s.u, s.instrument, recording.rate_hz, all_lines, 1)
    return FirstRecord(
        recording=recording,
        loop=loop,
        frf=frf,
        plant=G,
        to_input=mine.response[:, 1, 0],
        to_output=mine.response[:, 0, 0],
        noise=noise,
        averages=count,
        std=frf.modulus_std[:, 0, 0],
        input_rest=float(s.u.mean()),
        input_noise=input_noise,
        input_caused=float(np.sqrt(max(float(np.var(s.u)) - input_noise**2, 0.0))),
        output_noise=_unexplained(s.y, s.instrument, recording.rate_hz, all_lines, 0),
        amplitude=float(np.abs(s.instrument - s.instrument.mean()).max()),
        distortion=distortion(recording, loop) if recording.info.period_s is not None else None,
    )


def _moved(answers: Answers) -> np.ndarray:
    """Lines (nf,) whose input and output are known to follow the instrument, to `KNOWN`.

    Under feedback an FRF that noise made looks sure of itself: input and output are then tied by the controller.
    """
    variance = np.einsum("nii->ni", answers.covariance).real[:, :2]
    return np.asarray((variance < (KNOWN * np.abs(answers.response[:, :2, 0])) ** 2).all(axis=1))


def between(at_hz: Array, f: Array, response: ComplexArray) -> ComplexArray:
    """A response (nf,) on lines f between them: logarithm of magnitude and phase linear in log f; constant beyond."""
    x, x0 = np.log(np.maximum(at_hz, 1e-12)), np.log(f)
    size = np.interp(x, x0, np.log(np.abs(response)))
    return np.asarray(np.exp(size + 1j * np.interp(x, x0, np.unwrap(np.angle(response)))))


def _noise(recording: Recording, s: LoopSignals[Array], frf: FRF, settings: Settings) -> tuple[Array, Array, float]:
    """Lines (n,), power of Y - G U on them per Hz (n,), and independent averages per Hz behind it."""
    if recording.info.period_s is None:
        return _noise_of_fits(recording, s, frf)
    return _noise_of_periods(recording, s, frf, settings)


def _noise_of_periods(
    recording: Recording, s: LoopSignals[Array], frf: FRF, settings: Settings
) -> tuple[Array, Array, float]:
    """From what differs between periods, at the lines that are not excited too."""
    t = transform(recording, [s.y, s.u], s.instrument, settings)
    rows = (t.frequency_hz >= frf.frequency_hz[0]) & (t.frequency_hz <= frf.frequency_hz[-1])
    f = t.frequency_hz[rows]
    Y, U = t.signals[:, :, rows]
    E = Y - between(f, frf.frequency_hz, frf.siso) * U
    k, period_s = E.shape[0], 1.0 / float(t.frequency_hz[1])
    power = (np.abs(E - E.mean(axis=0)) ** 2).sum(axis=0) / (k - 1)
    return f, 2.0 * period_s * power, (k - 1) * period_s


def _noise_of_fits(recording: Recording, s: LoopSignals[Array], frf: FRF) -> tuple[Array, Array, float]:
    """From what local fits of output and input to the instrument leave over; narrow ones, which follow resonances.

    A window as wide as the response is best estimated by would count what it rounds off as noise.
    """
    n, window = s.y.size, WINDOW
    X = np.stack([np.fft.rfft(x - x.mean()) for x in (s.y, s.u)])
    R = np.fft.rfft(s.instrument - s.instrument.mean())[None]
    width = 2 * window.half + 1
    if n // 2 < 2 * width:
        raise BadSignalError(
            f"recording {recording.info.file} is too short to plan from: its noise does not show", f"{n} samples",
            f"record {4 * width} samples ({4 * width / recording.rate_hz:.3g} s) at the least, better several periods"
            " of the lowest frequency that matters",
        )  # fmt: skip
    low, high = (int(np.clip(round(f * n / recording.rate_hz), 1, n // 2 - 1)) for f in frf.frequency_hz[[0, -1]])
    low = max(1, min(low, high - width))
    high = min(n // 2 - 1, max(high, low + width))
    at = np.arange(low, high + 1, max(1, (high - low) // 4000))  # lines at which local fits look for the noise, at most
    few = CHUNK // width
    fits = [fit_lines(X, R, at[k : k + few], low, high, window) for k in range(0, at.size, few)]
    f = np.asarray(at * (recording.rate_hz / n), dtype=np.float64)
    left = np.stack([np.ones(f.size), -between(f, frf.frequency_hz, frf.siso)], axis=1)
    scatter = np.concatenate([fit.scatter for fit in fits])
    power = np.einsum("na,nab,nb->n", left, scatter, left.conj()).real
    return f, 2.0 / (recording.rate_hz * n) * power, fits[0].freedom / width * n / recording.rate_hz


def smoothed_over_octaves(f: Array, power: Array, averages: float, at_hz: Array) -> tuple[Array, Array]:
    """Mean power (n,) at `at_hz` (n,) of lines f (nf,) within a third of an octave, and how many averages carry it.

    `averages` is of one Hz of band. Five lines at least count; noise on one line alone is smeared over its neighbours.
    """
    middle = np.searchsorted(f, at_hz)
    low = np.clip(np.minimum(np.searchsorted(f, at_hz / BAND_FACTOR), middle - 2), 0, f.size - 1)
    high = np.clip(np.maximum(np.searchsorted(f, at_hz * BAND_FACTOR), middle + 3), low + 1, f.size)
    total = np.concatenate([[0.0], np.cumsum(power)])
    step = float(np.median(np.diff(f))) if f.size > 1 else 1.0
    count = np.maximum(averages * (high - low) * step, 1.0)
    return (total[high] - total[low]) / (high - low), count


def _unexplained(x: Array, instrument: Array, rate_hz: float, answers: Answers, row: int) -> float:
    """Rms of a signal (n,) without what it answers to the instrument (n,), by the responses of the whole record.

    Transients count, so that it is rather too large.
    """
    f, H = answers.frequency_hz, answers.response[:, row, 0]
    known = answers.excited & np.isfinite(H) & (np.abs(H) > 0.0)
    if not known.any():
        raise BadSignalError("no frequency of the recording shows how its signals follow the injected one")
    n = x.size
    at = np.asarray(np.fft.rfftfreq(n, 1.0 / rate_hz), dtype=np.float64)
    caused = between(at, f[known], H[known]) * np.fft.rfft(instrument - instrument.mean())
    left = x - x.mean() - np.fft.irfft(caused, n)
    return float(np.std(left))
