"""A recording under the controllers of now -> what a target watches while the next share of the new one takes over.

The periods of a multisine part what its excitation makes of a loop (their mean) from what disturbs it (what they differ
by). Under the next controller the first is -T n (S n, -P S n) by the measured plant, the second follows by the ratio of
both sensitivities, with intervals (`loop.margin.disturbed`). Limits are the upper ends of what is predicted, with room
for one window's chance and for what a linear prediction leaves out.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.signal import sosfilt

from loopshape.core.errors import WrongUseError
from loopshape.core.json_ready import Plain
from loopshape.core.units import Array, ComplexArray, from_db
from loopshape.data.control.controller import Controller
from loopshape.data.signal.channel import sum_terms
from loopshape.data.signal.disturbance import Disturbance
from loopshape.data.signal.experiment import LoopSetup
from loopshape.data.signal.recording import Recording
from loopshape.loop.loop import Loop
from loopshape.loop.margin.disturbed import disturbed
from loopshape.toolbox.rig.target.trial import Watch
from loopshape.toolbox.validation.agreement import tail

#: room of a rms and of a peak beyond their prediction (`experiments/adopt` counts what it costs)
RMS_ROOM, PEAK_ROOM = 1.25, 1.5
#: Gaussian noise comes to a peak of so many rms once in 17 million samples; a recorded crest counts where it is more
CREST = 5.5
#: a window's mean square scatters by its std; so many of them are its chance
CHANCE = 5.0
#: windows in a row that grow by less than this, in the mean square, are no growth
GROWTH = 1.5


@dataclass(frozen=True, eq=False)
class Periods:
    """Whole periods of a recording: the mean period of error and control (n,), the rest of both (k n,), n's lines.

    `injected` is the complex amplitude of the excitation on each of the period's lines above 0 Hz, `frequency_hz`
    (lines,), where it is excited.
    """

    error: Array
    control: Array
    error_rest: Array
    control_rest: Array
    frequency_hz: Array
    injected: ComplexArray
    lines: np.ndarray
    injection: str
    rate_hz: float
    answers: ComplexArray
    """What the error answers on the excited lines, period by period (periods, lines)."""
    off: float
    """How far z lies off what the loop's controller makes of its input, relative: of five lines the median, at most.

    Both are logged by one program, so that nothing but another controller, or another order of signals, is far off.
    """

    def changed(self, tolerance_db: float) -> float:
        """p-value that a single period is another than the rest by no more than noise, and a rms change of |S|.

        Each period against the mean of the others, their scatter as its variance (F with 2 and 2 (k - 2) degrees of
        freedom on each line, their sum as in `agreement` and the largest alone), the smallest of all, by Bonferroni.
        1 of fewer than four periods.
        """
        k = len(self.answers)
        if k < 4:
            return 1.0
        slack, freedom, found = float(from_db(tolerance_db)) - 1.0, 2.0 * (k - 2), []
        for one in range(k):
            others = np.delete(self.answers, one, axis=0)
            mean = others.mean(axis=0)
            variance = np.sum(np.abs(others - mean) ** 2, axis=0) / (k - 2) * (1.0 + 1.0 / (k - 1))
            q = np.abs(self.answers[one] - mean) ** 2 / np.maximum(variance + (slack * np.abs(mean)) ** 2, 1e-300)
            x = 0.5 * freedom * np.log1p(2.0 * q / freedom)
            found += [tail(x, 1.0), x.size * float(np.exp(-x.max()))]
        return min(1.0, 2.0 * k * min(found))

    @classmethod
    def of(cls, recording: Recording, loop: LoopSetup) -> Periods:
        """From where the response repeats on. Refuses a recording without two whole periods."""
        info, rate_hz = recording.info, recording.rate_hz
        period = round((info.period_s or 0.0) * rate_hz)
        first = round((info.periodic_from_s or 0.0) * rate_hz)
        rows = np.asarray(recording.column(loop.control)).size
        count = (rows - first) // period if period else 0
        if count < 2:
            raise WrongUseError(
                f"a trial is watched by the periods of its excitation, and {info.name!r} has {count} whole ones",
                f"{rows / rate_hz:.4g} s", "excite with a multisine of two periods or more",
            )  # fmt: skip
        end = first + count * period

        def blocks(x: Array) -> Array:
            return np.asarray(x, dtype=float)[first:end].reshape(count, period)

        y = sum(np.asarray(recording.column(c), dtype=float) for c in sum_terms(loop.output))
        r = recording.column(loop.reference) if loop.reference else np.zeros(rows)
        e, z = blocks(np.asarray(r) - y), blocks(recording.column(loop.control))
        moved = r if info.injection == "reference" or loop.injected is None else recording.column(loop.injected)
        n = np.fft.rfft(blocks(np.asarray(moved)).mean(axis=0))
        lines = np.flatnonzero(np.abs(n) > 1e-6 * np.abs(n[1:]).max())
        lines = lines[(lines > 0) & (lines < period // 2)]
        rest = np.sqrt(count / (count - 1.0))
        at_input = info.injection == "controller_input" and loop.injected is not None
        entered = np.asarray(r) - y + (np.asarray(recording.column(str(loop.injected))) if at_input else 0.0)
        apart = blocks(np.asarray(recording.column(loop.control)) - _through(loop.controller, entered))
        parts = [(x.mean(axis=0), rest * (x - x.mean(axis=0)).ravel()) for x in (e, z)]
        return cls(
            parts[0][0], parts[1][0], parts[0][1], parts[1][1], lines * rate_hz / period, n[lines], lines,
            info.injection, rate_hz, np.fft.rfft(_joined(e))[:, lines],
            _off(*(np.abs(np.fft.rfft(_joined(x))[:, lines].mean(axis=0)) for x in (apart, z))),
        )  # fmt: skip

    def in_time(self, spectrum: ComplexArray) -> Array:
        """A signal (n,) of these complex amplitudes on the excited lines."""
        whole = np.zeros(self.error.size // 2 + 1, dtype=complex)
        whole[self.lines] = spectrum
        return np.asarray(np.fft.irfft(whole, self.error.size))


def _joined(blocks: Array) -> Array:
    """Periods (k, n) without the line from where each begins to where the next does: what drifts leaks no more."""
    last = blocks[-1, -1] + np.mean(blocks[1:, 0] - blocks[:-1, -1])
    ends = np.append(blocks[1:, 0], last) - blocks[:, 0]
    return np.asarray(blocks - ends[:, None] * np.arange(blocks.shape[1]) / blocks.shape[1])


def _through(controller: Controller | None, x: Array) -> Array:
    """What a controller makes of a signal (n,), from rest: off by what it was at before, which fades or is constant."""
    if controller is None:
        return np.full(x.size, np.nan)
    return np.asarray(sosfilt(np.insert(controller.biquads(), 3, 1.0, axis=1), x))


def _off(apart: Array, z: Array) -> float:
    off = apart / np.maximum(z, 1e-300)
    return float(np.median(np.lib.stride_tricks.sliding_window_view(off, min(5, off.size)), axis=1).max())


@dataclass(frozen=True)
class Expected(Plain):
    """What a step is predicted to be, excited: rms of error and control (about its mean) with 95 % intervals."""

    error_rms: tuple[float, float]
    control_rms: tuple[float, float]


def watch_of(
    periods: Periods, under: Controller, loop: Loop, share: float, ramp_s: float, lease_s: float
) -> tuple[Watch, Expected]:
    """What to watch while `loop`, the next controller on the measured plant, takes over from the one `under` which the
    periods were recorded, and what is expected. Misleads where what disturbs the machine is another by then."""
    rest = Disturbance.from_arrays(
        periods.error_rest, periods.rate_hz, recorded_under=under, control=periods.control_rest, loop=loop.plant.loop
    )
    found = disturbed(loop, rest).readings
    answers = _answers(periods, loop)
    error, control = (
        _Part.of(*pair, found[name].ends) for pair, name in zip(answers, ("error_rms", "control_rms"), strict=True)
    )
    mean_error = float(np.mean(periods.error)) * _low_ratio(periods, under, loop)
    window = periods.error.size
    chance = _chance(rest, window / periods.rate_hz)
    crests = [max(CREST, 1.2 * _crest(x)) for x in (periods.error_rest, periods.control_rest)]
    square = RMS_ROOM**2 * (error.answer_rms**2 + error.high**2 * (1.0 + CHANCE * chance) + mean_error**2)
    width = PEAK_ROOM * (control.answer_peak + crests[1] * control.high)
    middle = float(np.mean(periods.control))
    watch = Watch(
        share, round(ramp_s * periods.rate_hz), round(lease_s * periods.rate_hz), window,
        error_peak=PEAK_ROOM * (error.answer_peak + crests[0] * error.high + abs(mean_error)),
        control_low=middle - width, control_high=middle + width,
        error_rms=float(np.sqrt(square)), growth=max(GROWTH, 1.0 + CHANCE * chance),
    )  # fmt: skip
    return watch, Expected(error.interval, control.interval)


@dataclass(frozen=True)
class _Part:
    """Rms and peak of what answers the excitation, at the upper end of the plant's error, and the rest's interval."""

    answer_rms: float
    answer_peak: float
    least_rms: float
    low: float
    high: float

    @classmethod
    def of(cls, answer: Array, spread: float, rest: tuple[float, float]) -> _Part:
        rms = float(np.sqrt(np.mean(answer**2)))
        return cls(
            rms * (1.0 + spread), float(np.abs(answer).max()) * (1.0 + spread), rms * max(1.0 - spread, 0.0), *rest
        )

    @property
    def interval(self) -> tuple[float, float]:
        return float(np.hypot(self.least_rms, self.low)), float(np.hypot(self.answer_rms, self.high))


def _answers(periods: Periods, loop: Loop) -> tuple[tuple[Array, float], tuple[Array, float]]:
    """What error and control answer to the excitation (n,), and how far their rms may be off, relative, in 95 %."""
    plant = loop.measured
    f = periods.frequency_hz
    P = np.interp(f, plant.frequency_hz, plant.siso.real) + 1j * np.interp(f, plant.frequency_hz, plant.siso.imag)
    std = np.interp(f, plant.frequency_hz, plant.relative_std[:, 0, 0])
    C = loop.controller.response(f)
    S = 1.0 / (1.0 + C * P)
    to_error = {"controller_input": -C * P * S, "plant_input": -P * S, "reference": S}[periods.injection]
    to_control = {"controller_input": C * S, "plant_input": -C * P * S, "reference": C * S}[periods.injection]
    T, at_input = (
        C * P * S,
        periods.injection == "plant_input",
    )  # by a relative error of P: of T and P S as S, of S as T
    out = []
    for response, moved in (
        (to_error, T if periods.injection == "reference" else S),
        (to_control, S if at_input else T),
    ):
        size = np.abs(response * periods.injected) ** 2
        spread = 1.96 * float(np.sqrt(np.sum(size * np.abs(moved * std) ** 2) / max(np.sum(size), 1e-300)))
        out.append((periods.in_time(response * periods.injected), spread))
    return out[0], out[1]


def _low_ratio(periods: Periods, under: Controller, loop: Loop) -> float:
    """|S of the next controller over S of the last| at the lowest line: how a mean error follows; 1 at most of it."""
    plant = loop.measured
    f = plant.frequency_hz[:1]
    old, new = (1.0 + one.response(f) * plant.siso[:1] for one in (under, loop.controller))
    return float(max(np.abs(old / new)[0], 1.0))


def _chance(rest: Disturbance, window_s: float) -> float:
    """Relative std of a window's mean square, of Gaussian noise of this spectrum."""
    total = float(rest.power.sum())
    return float(np.sqrt(0.5 * rest.duration_s / window_s * np.sum(rest.power**2))) / max(total, 1e-300)


def _crest(x: Array) -> float:
    return float(np.abs(x).max() / max(float(np.sqrt(np.mean(x**2))), 1e-300))
