"""Loop under a new controller, what disturbed it under the old one -> rms of its error, and what its actuator must do.

Whatever disturbs a linear loop reaches its error through S. So the error's spectrum under C1 is that under C0 times
|S1/S0|² = |(1 + C0 P)/(1 + C1 P)|², wherever the disturbance enters; the plant's input is C1 times that error. The
ratio is analytic in P: an error d of P makes it wrong by d (C0 - C1)/(1 + C1 P)², from which variance and bias of the
sum over all lines follow.

Below the lowest frequency P goes on along its integrators, above the highest it falls as 1/f²; how much of the power
lies there is told, and above, the interval reaches to what P = 0 and P = constant would give.

Peaks are those of Gaussian noise with this rms over a record as long as the disturbance's: level a is crossed
(rate of the signal)/(2 pi rms) exp(-a²/2 rms²) times a second upward (Rice 1945), and by no more samples than there
are. A record of bursts says more than its spectrum: how much the mean square of a signal scatters from block to block,
beside that of noise with the same spectrum and phases at random (Theiler and others, Physica D 58, 1992), and how
large it gets in its blocks (exponential exceedances: Pickands, Annals of Statistics 3, 1975). What an actuator changes
that saturates within `control_range` is simulated (`saturated`).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from scipy.special import gammaincinv, ndtri

from loopshape.core.errors import WrongUseError
from loopshape.core.outcomes import ClosedLoop
from loopshape.core.units import Array, ComplexArray, angular
from loopshape.data.requirement.requirements import LIMITS, Requirements
from loopshape.data.result.margins import Interval, Margins, Reading
from loopshape.data.signal.disturbance import Disturbance
from loopshape.loop.loop import Loop
from loopshape.loop.margin.saturated import LONGEST, RARE, RECORDS, Actuator, Factor, Factors, Loops, Record, factors
from loopshape.loop.stability.continued import Continued, continued
from loopshape.loop.tolerances import TOL

#: names of the limits that need a disturbance
DISTURBED = tuple(limit.name for limit in LIMITS if limit.disturbed)
#: share of the error's power outside the measured band from which on a warning is given
OUTSIDE = 0.1


@dataclass(frozen=True)
class Disturbed:
    """What a disturbance makes of a loop: readings by the names of their limits.

    `outside` is the share of the error's power outside the FRF's band; `unlike` says that the recorded one is not like
    Gaussian noise, `coarse` that the sensor's step is larger than its rms, `away` that the loop runs away as its
    actuator saturates.
    """

    readings: Mapping[str, Reading]
    outside: float
    unlike: bool = False
    away: bool = False
    coarse: bool = False


class _Power(NamedTuple):
    """Mean square of a signal and its 95 % interval."""

    mean: float
    low: float
    high: float

    @property
    def rms(self) -> Array:
        """Its root at the estimate and at both ends, (3,)."""
        return np.sqrt(np.array(self))

    def of_size(self, values: Array) -> _Power:
        """With the mean square of a signal, as uncertain."""
        size = float(np.mean(values**2))
        return _Power(*(size * x / max(self.mean, 1e-300) for x in self))


@dataclass(frozen=True, eq=False)
class Carried:
    """What disturbs a loop, on its lines (nf,), from under old controllers to under new ones.

    `error` is the error under the new ones and `before` that under the old, as amplitudes whose squares are power;
    `scatter` is the variance of the power under the new ones. `moves` (k, nf) is how far relative errors of the plant's
    k elements, of `covariance` (lines, k, k) on the FRF's own lines, move `error`; `flat` is `error` were the plant
    above its last line as it is there. `unseen` (nf,) is the rms of the error that
    the sensor's rounding then and now may differ by, were its lines all as this one: twice step²/12, white.
    """

    f: Array
    before: ComplexArray
    error: ComplexArray
    scatter: Array
    C1: ComplexArray
    moves: ComplexArray
    there: Continued
    covariance: ComplexArray
    flat: ComplexArray
    band_hz: Interval
    overlap: float
    unseen: Array | float = 0.0

    @cached_property
    def bias(self) -> Array:
        """What the plant's errors add to the power of the error (nf,), to second order."""
        found, others = np.zeros(self.f.size, dtype=complex), self.moves.conj()
        for k, own in enumerate(self.moves):
            found += own * np.sum(self.there.bias(self.covariance[:, k]).T * others, axis=0)
        return np.asarray(found.real)

    def through(self, weight: Array, bursts: float = 1.0) -> _Power:
        """Mean square of the error times a filter of squared magnitude `weight` (nf,); it scatters `bursts` times."""
        kept = np.maximum(np.abs(self.error) ** 2 - self.bias, 0.0)
        mean = float(weight @ kept)
        each = np.array(
            [self.there.collected(weight * self.error.conj() * x, len(self.covariance)) for x in self.moves]
        )
        variance = 2.0 * self.overlap * float(np.einsum("al,lab,bl->", each, self.covariance, each.conj()).real)
        variance += bursts * float(self.scatter @ weight**2)
        above = self.f > self.band_hz[1]
        apart = [float(weight[above] @ (np.abs(x) ** 2 - kept)[above]) for x in (self.before, self.flat)]
        low, high = rms_interval(mean, variance)
        rounded = float(np.sqrt(np.mean(self.unseen**2 * weight)))  # white: lines of a record are evenly apart
        low, high = np.sqrt(max(low**2 + min(0.0, *apart), 0.0)), np.sqrt(high**2 + max(0.0, *apart))
        return _Power(mean, max(low - rounded, 0.0) ** 2, (high + rounded) ** 2)

    def outside(self) -> float:
        """Share of the error's power outside the measured band."""
        each = np.abs(self.error) ** 2
        off = (self.f > self.band_hz[1]) | (self.f < self.band_hz[0])
        return float(each[off].sum()) / max(float(each.sum()), 1e-300)


@dataclass(frozen=True, eq=False)
class OneOfSeveral(Disturbance):
    """What disturbs one of several loops: its error while all of them run under their new controllers."""

    carried: Carried | None = None


def carried(loop: Loop, disturbance: Disturbance) -> Carried:
    """What disturbs a loop, carried over to its controller. Raises WrongUseError for another rate."""
    if isinstance(disturbance, OneOfSeveral) and disturbance.carried is not None:
        return disturbance.carried
    rate_hz = loop.controller.rate_hz
    refuse_other_rate(disturbance, loop.plant.loop, rate_hz)
    f, power, scatter = lines_of(disturbance, rate_hz)
    plant, before = loop.measured, np.sqrt(power).astype(complex)
    there = continued(plant, f, loop.integrators or 0)
    C0, C1, P = _old(disturbance, f), loop.controller.response(f), there.response
    ratio = (1.0 + C0 * P) / (1.0 + C1 * P)  # S under the new controller over S under the old one
    toward = P * (C0 - C1) / (1.0 + C1 * P) ** 2  # by a relative error of P
    relative = plant.variance[:, 0, 0] / np.abs(plant.siso) ** 2
    return Carried(
        f=f, before=before, error=before * ratio, scatter=scatter * np.abs(ratio) ** 4, C1=C1,
        moves=(before * toward)[None], there=there, covariance=relative[:, None, None].astype(complex),
        flat=before * (1.0 + C0 * plant.siso[-1]) / (1.0 + C1 * plant.siso[-1]),
        band_hz=(float(plant.frequency_hz[0]), float(plant.frequency_hz[-1])), overlap=plant.line_overlap,
        unseen=disturbance.step / np.sqrt(6.0) * np.abs(1.0 / (1.0 + C1 * P)) if disturbance.coarse else 0.0,
    )  # fmt: skip


def lines_of(disturbance: Disturbance, rate_hz: float) -> list[Array]:
    """Frequencies above 0 Hz and below half the rate, the power there and its variance."""
    rows = (disturbance.frequency_hz > 0.0) & (disturbance.frequency_hz < 0.5 * rate_hz)
    return [x[rows] for x in (disturbance.frequency_hz, disturbance.power, disturbance.scatter)]


def refuse_other_rate(disturbance: Disturbance, loop: str, rate_hz: float) -> None:
    """Refuse what was recorded at another rate in Hz than the new controller's."""
    held = disturbance.recorded_under
    own_hz = disturbance.rate_hz if held is None else held.rate_hz
    if own_hz is not None and abs(own_hz - rate_hz) > 1e-6 * rate_hz:
        raise WrongUseError(
            f"what disturbs loop {loop} was recorded at another rate than the controller's",
            f"{own_hz:g} Hz and {rate_hz:g} Hz",
            "record it with a controller of this rate",
        )


def _old(disturbance: Disturbance, f: Array) -> ComplexArray:
    held = disturbance.recorded_under
    return np.zeros(f.size, dtype=complex) if held is None else held.response(f)


def _actuator(loop: Loop, disturbance: Disturbance, control_range: Interval) -> Actuator:
    """The room about the mean under the loop's controller, which follows from the old mean by both near 0 Hz."""
    f = np.array([1e-3 * loop.frequency_hz[0]])
    P = continued(loop.measured, f, loop.integrators or 0).response[0]
    C0, C1 = _old(disturbance, f)[0], loop.controller.response(f)[0]
    mean = disturbance.control_mean
    if mean and C0 and C1:
        mean *= float(np.real(C1 / C0 * (1.0 + C0 * P) / (1.0 + C1 * P)))
    return Actuator(mean - control_range[0], control_range[1] - mean)


def disturbed(loop: Loop, disturbance: Disturbance, control_range: Interval | None = None) -> Disturbed:
    """What a loop makes of a disturbance; the loop is taken as stable. Raises WrongUseError for another rate.

    `control_range` are the actuator's ends in the input's unit. Where the loop runs away as it saturates nothing but
    `saturation_percent` is read.
    """
    found, rate_hz = carried(loop, disturbance), loop.controller.rate_hz
    samples = disturbance.duration_s * rate_hz
    own = _recorded(loop, disturbance)
    signals = (own.error, own.control, own_rate := np.diff(own.control) * rate_hz, np.zeros(0))
    bursts = [1.0 if disturbance.repeats else _bursts(x) for x in signals]
    weights = zip(_weights(found, rate_hz), bursts, strict=True)
    error, control, rate, jerk = (found.through(*both) for both in weights)
    moving = slice(0, own.error.size // 2)
    if disturbance.repeats:
        error, control = error.of_size(own.error[moving]), control.of_size(own.control[moving])
    peaks = (
        _Peak.of(control, rate, samples, rate_hz, own.control, bursts[1], repeats=disturbance.repeats),
        _Peak.of(rate, jerk, samples, rate_hz, own_rate, bursts[2], repeats=disturbance.repeats),
    )
    unlike = any(peak.unlike for peak in peaks)
    changed, readings = (Factors(),) * 3, dict[str, Reading]()
    if control_range is not None:
        actuator = _actuator(loop, disturbance, control_range)
        records = own.pieces() if unlike else _at_random(loop, disturbance, samples)
        if disturbance.repeats:  # the move without the rest after it
            records = [Record(own.control[moving], own.error[moving])]
        changed = _changed(loop, control, actuator, records, counted=unlike or disturbance.repeats)
        readings["saturation_percent"] = _saturation(control, actuator, changed)
        if any(one.away for one in changed):
            return Disturbed(readings, found.outside(), away=True)
    readings["error_rms"] = _rms(error, [one.error for one in changed])
    readings["control_rms"] = _rms(control, [one.control for one in changed])
    if samples > 0.0:
        readings["control_peak"] = peaks[0].reading([one.peak for one in changed])
        readings["control_rate"] = peaks[1].reading([one.rate for one in changed])
    return Disturbed(readings, found.outside(), unlike=unlike, coarse=disturbance.coarse)


def _weights(carried: Carried, rate_hz: float) -> tuple[Array, Array, Array, Array]:
    """Squared magnitudes (nf,) from the error to itself, to the plant's input, to its rate, and to the rate of that."""
    control, faster = np.abs(carried.C1) ** 2, np.abs(change(carried.f, rate_hz)) ** 2
    return np.ones(control.size), control, control * faster, control * faster**2


def change(f: Array, rate_hz: float) -> ComplexArray:
    """From a signal to its differences a second."""
    return np.asarray(rate_hz * (1.0 - np.exp(-1j * angular(f) / rate_hz)))


def _changed(
    loop: Loop, control: _Power, actuator: Actuator, records: Sequence[Record], *, counted: bool
) -> tuple[Factors, Factors, Factors]:
    """What saturation changes at the estimate and at both ends of the power of the plant's input.

    With `counted` few samples outside count as well: the records are what there is, and no noise.
    """
    rms, size = control.rms, max(float(np.sqrt(np.mean([np.mean(one.control**2) for one in records]))), 1e-300)
    largest_scale = float(rms[2] / size)
    if (counted or actuator.share(rms[2]) < RARE) and all(actuator.holds(largest_scale * x.control) for x in records):
        return (Factors(share=Factor(0.0, 0.0, 0.0) if counted else None),) * 3
    n = max(one.control.size for one in records) // 2 * 2
    f = _lines(n, loop.controller.rate_hz)
    P, C1 = continued(loop.plant, f, loop.integrators or 0).response, loop.controller.response(f)
    loops = Loops.of(*(_padded(x, n) for x in (C1 * P / (1.0 + C1 * P), P / (1.0 + C1 * P))))
    middle, low, high = (factors(records, loops, actuator, float(x / size), counted=counted) for x in rms)
    return middle, low, high


def _bursts(signal: Array) -> float:
    """How many times as much the mean square of a signal scatters as that of noise with its spectrum; 1 at least."""
    parts = TOL.record_parts
    n = signal.size // (2 * parts) * 2 * parts
    if n < 8 * parts:
        return 1.0
    size, rng = np.abs(np.fft.rfft(signal[:n])), np.random.default_rng(0)
    noise = np.fft.irfft(size * np.exp(2j * np.pi * rng.random((TOL.record_surrogates, size.size))), n)
    scatter = [np.var(np.mean(x.reshape(parts, -1) ** 2, axis=1)) for x in (signal[:n], *noise)]
    ratio = float(scatter[0] / max(np.mean(scatter[1:]), 1e-300))
    return ratio if ratio > TOL.bursts else 1.0


def _largest_of_blocks(signal: Array, samples: float) -> Array:
    """The largest |value| of a record of so many samples, (3,) at 2.5, 50 and 97.5 %, by the largest of its blocks.

    The largest of them lie exponentially above the next one; the error of their scale is in it. One event alone
    is as large as it was.
    """
    parts, tail = TOL.record_parts, TOL.largest_parts
    found = np.sort(np.abs(signal[: signal.size // parts * parts]).reshape(parts, -1).max(axis=1))
    threshold = float(found[-tail - 1])
    scale = float(found[-tail:].mean()) - threshold
    away = scale * np.log(tail * samples / signal.size / -np.log([0.025, 0.5, 0.975]))
    reach = np.hypot(away - away[1], TOL.normal_95 * away[1] / np.sqrt(tail))
    ends = np.maximum(threshold + away[1] + np.array([-1.0, 0.0, 1.0]) * reach, 1e-9 * max(found[-1], 1e-300))
    return np.asarray(ends * found[-1] / ends[1] if found[-1] > TOL.event_alone * ends[1] else ends)


def _lines(n: int, rate_hz: float) -> Array:
    """Lines of a real transform of n samples above 0 Hz and below half the rate."""
    f = np.fft.rfftfreq(n, 1.0 / rate_hz)[1:]
    return np.asarray(f[f < 0.5 * rate_hz], dtype=float)


def _padded(response: ComplexArray, n: int) -> ComplexArray:
    """A response on the lines of n samples, with the first's real part at 0 Hz, the last's at half the rate."""
    ends = np.real(response[:1]), np.real(response[-1:])
    return np.concatenate([ends[0], response, ends[1][: n // 2 - response.size]])


def _through_time(loop: Loop, C0: ComplexArray, error: ComplexArray, n: int) -> Record:
    """Input and error of the linear loop from the error under the old controller, on the lines of n samples."""
    f = _lines(n, loop.controller.rate_hz)
    P, C1 = continued(loop.measured, f, loop.integrators or 0).response, loop.controller.response(f)
    made = error * (1.0 + C0 * P) / (1.0 + C1 * P)
    still = [np.concatenate([[0.0], x, np.zeros(n // 2 - f.size)]) for x in (C1 * made, made)]
    return Record(*(np.fft.irfft(x, n) for x in still))


def _recorded(loop: Loop, disturbance: Disturbance) -> Record:
    """The recorded disturbance under the loop's controller, without the ends of the record, which transforms join."""
    n = disturbance.samples.size // 2 * 2
    if not n:
        return Record(np.zeros(0), np.zeros(0))
    f = _lines(n, loop.controller.rate_hz)
    error = np.fft.rfft(disturbance.samples[:n])[1 : f.size + 1]
    # share of a record at each of its ends that its transform blurs
    made, edge = _through_time(loop, _old(disturbance, f), error, n), int(0.1 * n)
    if disturbance.repeats:  # at rest before it and after
        return Record(made.control - made.control[-1], made.error - made.error[-1])
    return Record(made.control[edge : n - edge], made.error[edge : n - edge])


def _at_random(loop: Loop, disturbance: Disturbance, samples: float) -> list[Record]:
    """Records of the linear loop with the disturbance's spectrum and phases at random, the same each time."""
    n = int(min(samples, LONGEST) if samples > 0.0 else LONGEST) // 2 * 2
    f, rng = _lines(n, loop.controller.rate_hz), np.random.default_rng(0)
    edges = np.concatenate([[0.0], 0.5 * (f[1:] + f[:-1]), [0.5 * loop.controller.rate_hz]])
    own_hz, power, _ = lines_of(disturbance, loop.controller.rate_hz)
    power = np.diff(np.interp(edges, np.append(0.0, own_hz), np.append(0.0, np.cumsum(power))))
    phases = np.exp(2j * np.pi * rng.random((RECORDS, f.size)))
    return [_through_time(loop, _old(disturbance, f), n * np.sqrt(0.5 * power) * one, n) for one in phases]


def _rms(power: _Power, factors: Sequence[Factor]) -> Reading:
    """A rms and its interval, with what saturation makes of it at the estimate and at both ends."""
    value, low, high = power.rms * [factors[0].value, factors[1].low, factors[2].high]
    return Reading(float(value), (float(low), float(high)))


def crossings_a_sample(mean: float, rate_mean: float, rate_hz: float) -> float:
    """Upward crossings of the mean a sample, of Gaussian noise with this power and this power of its rate."""
    if mean <= 0.0:
        return 0.0
    return float(np.arccos(np.clip(1.0 - 0.5 * rate_mean / (rate_hz**2 * mean), -1.0, 1.0))) / (2.0 * np.pi)


def largest(crossings: float, samples: float, level: float) -> float:
    """The largest |value| over the rms that Gaussian noise stays below with this probability, in a record of samples.

    `crossings` are the record's upward crossings of the mean.
    """
    rare = -np.log(level)
    by_crossings = np.sqrt(2.0 * np.log(max(2.0 * crossings / rare, 1.0)))
    one, every = (ndtri(0.5 * (1.0 + level ** (1.0 / n))) for n in (1.0, max(samples, 1.0)))  # alike, independent
    return float(min(max(by_crossings, one), every))


@dataclass(frozen=True)
class _Peak:
    """The largest |value| of a signal in a record as long as the disturbance's.

    `levels` (5,) are its quantiles over the rms at 0.1, 2.5, 50, 97.5 and 99.9 % for Gaussian noise; `own` are (3,) at
    2.5, 50 and 97.5 % those of a recorded disturbance that is unlike it, None of one that is not.
    """

    power: _Power
    levels: Array
    own: Array | None = None

    @classmethod
    def of(
        cls, power: _Power, faster: _Power, samples: float, rate_hz: float, own: Array, bursts: float, *, repeats: bool
    ) -> _Peak:  # fmt: skip
        """From the power of a signal and of its rate; what repeats has the peak of the signal itself."""
        if repeats:
            return cls(power, np.full(5, float(np.abs(own).max()) / max(float(power.rms[0]), 1e-300)))
        crossings = samples * crossings_a_sample(power.mean, faster.mean, rate_hz)
        chances = (0.001, 0.025, 0.5, 0.975, 0.999) if samples > 0.0 else ()
        levels = np.maximum([largest(crossings, samples, x) for x in chances], 1e-9)
        most, rms = float(np.abs(own).max(initial=0.0)), float(power.rms[0])
        usual = not levels.size or most == 0.0 or levels[0] * rms <= most <= levels[4] * rms
        return cls(power, levels, None if usual and bursts < TOL.unlike_noise else _largest_of_blocks(own, samples))

    @property
    def unlike(self) -> bool:
        """Whether the recorded signal is none of Gaussian noise."""
        return self.own is not None

    def reading(self, factors: Sequence[Factor]) -> Reading:
        """The interval is that of another record's peak: the chance of the peak, and the error of the rms."""
        rms = self.power.rms
        if rms[0] <= 0.0:
            return Reading(0.0, (0.0, 0.0))
        less, middle, more = rms[0] * self.levels[1:4] if self.own is None else self.own
        below, above = np.log(rms[0] / max(rms[1], 1e-9 * rms[0])), np.log(rms[2] / rms[0])
        low = middle * factors[1].low * float(np.exp(-np.hypot(np.log(middle / less), below)))
        high = middle * factors[2].high * float(np.exp(np.hypot(np.log(more / middle), above)))
        return Reading(float(middle * factors[0].value), (float(low), float(high)))


def _saturation(control: _Power, actuator: Actuator, changed: Sequence[Factors]) -> Reading:
    """Share of the time at which the plant's input lies outside its range, in percent."""
    by_noise = [Factor(*[actuator.share(std)] * 3) for std in control.rms]
    shares = [one.share or noise for one, noise in zip(changed, by_noise, strict=True)]
    value, low, high = shares[0].value, min(one.low for one in shares[:2]), max(one.high for one in shares)
    return Reading(100.0 * value, (100.0 * low, 100.0 * min(high, 1.0)))


def made_of(
    loops: Mapping[str, Loop], found: Mapping[str, Margins], requirements: Requirements,
    disturbances: Mapping[str, Disturbance],
) -> dict[str, Disturbed]:  # fmt: skip
    """What disturbances make of error and input of loops with these margins; inf where one is unstable."""
    unstable = Disturbed(dict.fromkeys(DISTURBED, Reading(float("inf"))), 0.0)
    return {
        name: unstable
        if found[name].stable is ClosedLoop.UNSTABLE
        else disturbed(loops[name], one, requirements.of(loops[name].plant.operating_point).control_range)
        for name, one in disturbances.items()
    }


def of_points(loops: Mapping[str, Loop], disturbances: Sequence[Disturbance]) -> dict[str, Disturbance]:
    """The disturbance of each operating point by its name: that recorded there; one alone serves all."""
    if len(disturbances) == 1 and not isinstance(disturbances[0], OneOfSeveral):
        return dict.fromkeys(loops, disturbances[0])
    known = {tuple(sorted(one.operating_point.items())): one for one in disturbances}
    points = {name: tuple(sorted(loop.plant.operating_point.items())) for name, loop in loops.items()}
    return {name: known[point] for name, point in points.items() if point in known}


def disturbance_warnings(
    loops: Mapping[str, Loop], found: Mapping[str, Disturbed], requirements: Requirements
) -> tuple[str, ...]:
    """Sentences on limits whose disturbance is not known, or is unlike noise, or lies outside the measured band."""
    out = []
    for name, loop in loops.items():
        required = requirements.of(loop.plant.operating_point)
        asked = [x for x in DISTURBED if getattr(required, x) is not None]
        if name not in found:
            if asked:
                out.append(
                    f"{', '.join(asked)} at {name} cannot be decided: what disturbs the loop there is not known; give"
                    " a run (--disturbance RUN)"
                )
            continue
        out += _of_one(found[name], name, loop, asked)
    return tuple(out)


def _of_one(found: Disturbed, name: str, loop: Loop, asked: Sequence[str]) -> Iterator[str]:
    if found.away:
        yield (
            f"the loop at {name} runs away in simulation where its actuator saturates, or nearly so, though it is"
            " stable without: neither error nor input are predicted; give the actuator more range, or the controller"
            " less gain"
        )
    elif asked and (unread := [x for x in asked if x not in found.readings]):
        yield (
            f"{', '.join(unread)} at {name} cannot be decided: a peak belongs to a record of some length; give a"
            " recording, or duration_s with the spectrum"
        )
    if found.coarse:
        yield (
            f"the sensor's step at {name} is larger than the rms of the error that was recorded: what moves within a"
            " step is not known, and intervals are as wide as its rounding makes them; record with a finer sensor"
        )
    elif found.unlike:
        yield (
            f"what disturbs the loop at {name} is unlike Gaussian noise (tones or shocks): peaks are those of the"
            " recording itself; a longer one shows more of them"
        )
    if found.outside > OUTSIDE:
        low, high = loop.frequency_hz[0], loop.frequency_hz[-1]
        yield (
            f"{100.0 * found.outside:.0f} % of the power of the error at {name} lies outside the measured band,"
            f" {low:.3g} to {high:.3g} Hz, where the plant is continued"
        )


def rms_interval(power: float, variance: float) -> tuple[float, float]:
    """95 % interval of a rms, from the mean square and its variance, as that of chi square with their ratio."""
    if power <= 0.0 or variance <= 0.0:
        return float(np.sqrt(max(power, 0.0))), float(np.sqrt(max(power, 0.0)))
    freedom = 2.0 * power**2 / variance
    low, high = (float(np.sqrt(0.5 * power * freedom / gammaincinv(0.5 * freedom, level))) for level in (0.975, 0.025))
    return low, high
