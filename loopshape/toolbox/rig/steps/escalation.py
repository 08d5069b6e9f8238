"""Amplitudes step by step: what a step showed, what the next one is predicted to do, and whether there is one."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum

import numpy as np

from loopshape.core.errors import BadSignalError, WrongUseError
from loopshape.core.json_ready import Plain, keys
from loopshape.core.units import Array
from loopshape.data.response.frf import FRF
from loopshape.data.signal.channel import sum_terms
from loopshape.data.signal.experiment import LoopSetup
from loopshape.data.signal.recording import Recording
from loopshape.toolbox.rig.settings import Limit
from loopshape.toolbox.rig.steps.enough import Band, Until, accuracy, would_do

#: noise is taken to reach this many times its rms
NOISE_PEAK = 4.0
#: share of a command's room that noise at rest may take
NOISE_SHARE = 0.5
#: a linear machine's excursions come again to this: two steps of a few periods differ by their transients
REPEATS = 0.05
#: samples at one end, or at one rate, as a share and as a number, from which a command counts as clipped
FLAT_SHARE, FLAT_COUNT = 0.005, 10
#: a sensor that stands still for so many times as long as it ever did is stuck; never in fewer ticks, and no sensor
#: that stood still for longer than the last
STILL_TIMES, STILL_TICKS, STILL_MOST = 3, 10, 20
#: one that should have moved by so many of its steps, and by this share of its travel, since it moved last, is stuck
STILL_STEPS, STILL_SHARE = 3.0, 0.1


class Stop(StrEnum):
    """Why the amplitude rises no further. After the first five the recording is made, after the others nothing moves.

    `FULL`: the study's own amplitude. `ACCURATE`: as accurate as wanted. `LIMIT_NEAR`: a next step could come too near
    to a limit, or this one did. `CLIPPED`, `RATE_LIMITED`: the actuator's log shows it, or the gain falls; this step's
    data are invalid.
    """

    FULL = "full_amplitude"
    ACCURATE = "accurate"
    LIMIT_NEAR = "limit_near"
    CLIPPED = "clipped"
    RATE_LIMITED = "rate_limited"
    LIMIT_PASSED = "limit_passed"
    DRIFTED = "drifted"
    STUCK = "stuck"
    NOISY = "noisy"
    UNEXPECTED = "unexpected"

    @property
    def records(self) -> bool:
        """Whether the recording itself is made after this, at the largest amplitude whose data are valid."""
        return self in (Stop.FULL, Stop.ACCURATE, Stop.LIMIT_NEAR, Stop.CLIPPED, Stop.RATE_LIMITED)

    @property
    def valid(self) -> bool:
        """Whether the data of the step that showed it are valid."""
        return self not in (Stop.CLIPPED, Stop.RATE_LIMITED, Stop.LIMIT_PASSED, Stop.STUCK, Stop.NOISY, Stop.UNEXPECTED)


class Trip(StrEnum):
    """What ends a recording while it runs: at a guard and with enough the excitation stops, else the machine vents."""

    GUARD = "guard"
    LIMIT = "limit"
    STUCK = "stuck"
    UNEXPECTED = "unexpected"
    ENOUGH = "enough"

    @property
    def vents(self) -> bool:
        """Whether the machine is vented at once."""
        return self in (Trip.LIMIT, Trip.STUCK, Trip.UNEXPECTED)


@dataclass(frozen=True)
class Escalation:
    """How the amplitude rises: from `start_percent` of the study's own, by a factor of `growth` at most each step.

    A step has `periods` periods. It is predicted to leave `reserve_percent` of the room between rest and each limit;
    half of that reserve is a guard at which the excitation stops while it runs. `base_percent` of the study's amplitude
    moves the setpoint slowly meanwhile, once a period, so that friction does not hold the machine. `travel` are windows
    by column that the mean over a step has to stay in.
    """

    start_percent: float = 5.0
    growth: float = 2.0
    periods: int = 2
    reserve_percent: float = 25.0
    base_percent: float = 0.0
    travel: Mapping[str, Limit] = field(default_factory=dict)

    def __post_init__(self) -> None:
        bounds = {"start_percent": (0.0, 100.0), "growth": (1.0, 10.0), "reserve_percent": (0.0, 90.0)}
        for name, (low, high) in bounds.items():
            if not low < (value := getattr(self, name)) <= high:
                raise WrongUseError(f"{name} of an escalation lies above {low:g} and up to {high:g}", f"{value!r}")
        if self.periods < 2 or not 0.0 <= self.base_percent <= 1000.0:
            raise WrongUseError(
                "an escalation has steps of two periods or more and a base motion of 0 to 1000 %",
                f"{self.periods!r} and {self.base_percent!r}",
            )


@dataclass(frozen=True)
class Room(Plain):
    """One side of a limit in the column's unit: at rest, the excursion of this step, the predicted one of the next.

    `predicted` is its interval at `next_percent` of the study's amplitude; `left_percent` is the room that its far end
    leaves between rest and the limit.
    """

    column: str
    limit: float
    rest: float
    reached: float
    predicted: tuple[float, float]
    left_percent: float


@dataclass(frozen=True)
class Step(Plain):
    """A step as it was tested: its amplitude, whether its data are valid, the accuracy by octaves, and all rooms.

    `full_std` is the std of the worst octave (of S, or of what is wanted) predicted for the study's own length at this
    amplitude; `next_percent` is the next step's amplitude, None where `stop` says why there is none.
    """

    ALSO = keys("sentence")

    recording: str
    percent: float
    valid: bool
    bands: tuple[Band, ...]
    full_std: float
    rooms: tuple[Room, ...]
    next_percent: float | None = None
    stop: Stop | None = None

    @property
    def sentence(self) -> str:
        """The same in words."""
        text = f"{self.recording} at {self.percent:.3g} % of the amplitude"
        if np.isfinite(self.full_std):
            text += f": std {100.0 * self.full_std:.2g} % over the whole length"
        if self.rooms:
            worst = min(self.rooms, key=lambda one: one.left_percent)
            text += f"; {worst.column} went to {worst.reached:.4g} of {worst.limit:.4g}"
        if not self.valid:
            text += "; its data are invalid"
        if self.next_percent is not None:
            return f"{text}; next {self.next_percent:.3g} %"
        return text if self.stop is None else f"{text}; {WORDS[self.stop]}"


WORDS = {
    Stop.FULL: "this is the study's amplitude",
    Stop.ACCURATE: "accurate enough",
    Stop.LIMIT_NEAR: "a larger step could come too near to a limit",
    Stop.CLIPPED: "an actuator saturates",
    Stop.RATE_LIMITED: "an actuator is at its largest rate",
    Stop.LIMIT_PASSED: "a limit was passed",
    Stop.DRIFTED: "the mean left its travel window",
    Stop.STUCK: "a sensor stands still",
    Stop.UNEXPECTED: "the machine did not do what the step before predicted",
    Stop.NOISY: "noise at rest alone takes the room of a command",
}


@dataclass(frozen=True, eq=False)
class Seen:
    """What a step before showed: its amplitude, the plant, and by column how far and how strongly it moved.

    `record` is a column from the start (n,), `grain` the least by which it ever changes.
    """

    percent: float
    plant: FRF | None
    mean: Mapping[str, float]
    high: Mapping[str, float]
    low: Mapping[str, float]
    rms: Mapping[str, float]
    still_ticks: Mapping[str, int]
    record: Mapping[str, Array] = field(default_factory=dict)
    grain: Mapping[str, float] = field(default_factory=dict)


def seen(recording: Recording, columns: tuple[str, ...], percent: float, plant: FRF | None, from_s: float) -> Seen:
    """A step's excursions from its mean, by column, from `from_s` on."""
    first = round(from_s * recording.rate_hz)
    values = {c: np.asarray(recording.column(c))[first:] for c in columns if c in recording.columns}
    values = {c: x for c, x in values.items() if x.size > 1}
    mean = {c: float(x.mean()) for c, x in values.items()}
    return Seen(
        percent, plant, mean,
        {c: float(x.max()) - mean[c] for c, x in values.items()},
        {c: mean[c] - float(x.min()) for c, x in values.items()},
        {c: float(x.std()) for c, x in values.items()},
        {c: longest_still(x) for c, x in values.items()},
        {c: np.array(recording.column(c)) for c in values},
        {c: least_change(x) for c, x in values.items()},
    )  # fmt: skip


def longest_still(x: Array) -> int:
    """Ticks of the longest stretch (n,) over which nothing changes."""
    moved = np.flatnonzero(np.diff(x) != 0.0)
    ends = np.concatenate([[-1], moved, [x.size - 1]])
    return int(np.diff(ends).max())


def least_change(x: Array) -> float:
    """The least by which a signal (n,) changes where it does; inf where it never does."""
    steps = np.abs(np.diff(x))
    return float(steps[steps > 0.0].min(initial=np.inf))


@dataclass(frozen=True, eq=False)
class Climb:
    """What all steps of one recording keep to: its loop, how the amplitude rises, limits by column, and what is enough.

    `commands` are the columns that an actuator makes.
    """

    loop: LoopSetup
    settings: Escalation
    limits: Mapping[str, Limit]
    commands: frozenset[str]
    until: Until | None


def tested(
    recording: Recording, climb: Climb, percent: float, past: tuple[Seen, ...], share: float, trip: Trip | None
) -> tuple[Step, Seen]:
    """A step and what follows from it.

    `past` begins with the step at rest, `share` is this one's measured length over the recording's own. Refuses
    nothing: of what cannot be estimated nothing is known, and the next step follows.
    """
    loop, settings, limits, until = climb.loop, climb.settings, climb.limits, climb.until
    name, from_s = recording.info.name, recording.info.periodic_from_s or 0.0
    try:
        bands, plant = accuracy(recording, loop)
    except BadSignalError:
        bands, plant = (), None
    now = seen(recording, tuple(limits) + tuple(settings.travel), percent, plant, 0.0 if trip else from_s)
    full = (until or Until(1e-2)).worst(bands) * float(np.sqrt(share))
    danger = _danger(recording, now, settings, trip)
    if danger is None and (_never_moved(now, past, loop) or _stopped_moving(recording, loop, past[0])):
        danger = Stop.STUCK
    spoilt = _spoilt(recording, now, past, climb.commands)
    factor = _factor(now, past, settings, limits)
    stop: Stop | None = danger or spoilt
    if stop is None and trip is Trip.GUARD:
        stop = Stop.LIMIT_NEAR
    if stop is None and plant and until and would_do(bands, plant, loop, until, share):
        stop = Stop.ACCURATE
    if stop is None and percent >= 100.0 * (1.0 - 1e-9):
        stop = Stop.FULL
    if stop is None and factor < 1.05:  # the least factor that is worth a step
        stop = Stop.LIMIT_NEAR
    after = None if stop else min(percent * factor, 100.0)
    rooms = _rooms(now, past, limits, (after or percent) / percent)
    return Step(name, percent, stop is None or stop.valid, bands, full, rooms, after, stop), now


def at_rest(recording: Recording, limits: Mapping[str, Limit], commands: frozenset[str]) -> tuple[Step, Seen]:
    """The step without excitation: noise of a command that alone takes too much of its room ends all."""
    now = seen(recording, tuple(limits), 0.0, None, 0.0)
    noisy = False
    for column in commands & now.mean.keys():
        room = min(limits[column].high - now.mean[column], now.mean[column] - limits[column].low)
        noisy |= NOISE_PEAK * now.rms[column] > NOISE_SHARE * room
    stop = Stop.LIMIT_PASSED if recording.info.ended_early else Stop.NOISY if noisy else None
    rooms = _rooms(now, (now,), limits, 1.0)
    return Step(recording.info.name, 0.0, stop is None, (), np.inf, rooms, None, stop), now


def _danger(recording: Recording, now: Seen, settings: Escalation, trip: Trip | None) -> Stop | None:
    if trip in (Trip.STUCK, Trip.UNEXPECTED):
        return Stop(trip.value)
    if trip is Trip.LIMIT or (recording.info.ended_early and trip is None):
        return Stop.LIMIT_PASSED
    outside = [c for c, x in settings.travel.items() if c in now.mean and not x.low <= now.mean[c] <= x.high]
    return Stop.DRIFTED if outside else None


def _never_moved(now: Seen, past: tuple[Seen, ...], loop: LoopSetup) -> bool:
    """Whether a sensor of the loop stood still over this step, which moved before, or over too many steps."""
    steps = [one for one in past if one.percent]
    still_at_most = 4  # and one that moved in no excited step of so many
    for column in sum_terms(loop.output):
        moved = [one.grain.get(column, 0.0) < np.inf for one in (*steps, now)]
        if not moved[-1] and (any(moved) or len(moved) >= still_at_most):
            return True
    return False


def stuck(motion: Array, at: np.ndarray, since: np.ndarray, least: float) -> np.ndarray:
    """Whether a sensor (rows at `at`, unchanged `since` so many ticks) should have moved by `least` meanwhile."""
    now = np.minimum(at, motion.size - 1)
    apart = np.abs(motion[now] - motion[np.maximum(now - since, 0)])
    return np.asarray((since >= STILL_TICKS) & (apart > least))


def _stopped_moving(recording: Recording, loop: LoopSetup, rest: Seen) -> bool:
    """Whether a sensor of the loop stood still where it moved a period before."""
    period = round((recording.info.period_s or 0.0) * recording.rate_hz)
    first = round((recording.info.periodic_from_s or 0.0) * recording.rate_hz)
    for column in sum_terms(loop.output):
        x = np.asarray(recording.column(column))[first:]
        x = x[: x.size // period * period] if period else x[:0]
        if x.size < 2 * period or not period:
            continue
        place, change = np.arange(x.size), np.concatenate([[True], np.diff(x) != 0.0])
        since = place - np.maximum.accumulate(np.where(change, place, 0))
        before = np.concatenate([np.full(period, np.nan), x[:-period]])
        noise = 2.0 * NOISE_PEAK * rest.rms.get(column, 0.0)
        least = max(2.0 * (STILL_STEPS * least_change(x) + noise), STILL_SHARE * float(np.ptp(x)))
        if stuck(before, place, since, least).any():
            return True
    return False


def _spoilt(recording: Recording, now: Seen, past: tuple[Seen, ...], commands: frozenset[str]) -> Stop | None:
    """What an actuator that is at its end does to the data: seen in its log, or in a gain that falls."""
    for column in commands & recording.columns.keys():
        u = np.asarray(recording.column(column))
        least = max(FLAT_COUNT, FLAT_SHARE * u.size)
        if np.unique(u).size <= FLAT_COUNT:
            continue
        if max(np.count_nonzero(u == u.max()), np.count_nonzero(u == u.min())) >= least:
            return Stop.CLIPPED
        rate = np.abs(np.diff(u))
        if rate.max() > 0.0 and np.count_nonzero(rate >= rate.max() * (1.0 - 1e-9)) >= least:
            return Stop.RATE_LIMITED
    before = next((one.plant for one in reversed(past) if one.plant is not None), None)
    return Stop.CLIPPED if before is not None and now.plant is not None and gain_falls(before, now.plant) else None


def gain_falls(before: FRF, now: FRF) -> bool:
    """Whether the plant's gain is lower than at a smaller amplitude in some octave, beyond errors and by 5 %."""
    f, i, j = np.intersect1d(before.frequency_hz, now.frequency_hz, return_indices=True)
    # frequencies whose gain is known better than this can show that
    known = np.maximum(before.modulus_std[i, 0, 0], now.modulus_std[j, 0, 0]) < 0.1  # noise has no gain
    f, i, j = f[known], i[known], j[known]
    if not f.size:
        return False
    change = np.log(np.abs(now.siso[j]) / np.abs(before.siso[i]))
    variance = before.modulus_std[i, 0, 0] ** 2 + now.modulus_std[j, 0, 0] ** 2
    octaves = np.floor(np.log2(f / f[0]) + 1e-9)
    # a gain that falls with the amplitude by more deviations, and by a larger share, is an actuator that saturates
    falls_sigma, falls_share = 4.0, 0.05
    for k in np.unique(octaves):
        weights = (octaves == k) / np.maximum(variance, 1e-12)
        fall, sigma = -float(weights @ change / weights.sum()), float(1.0 / np.sqrt(weights.sum()))
        if fall > falls_share and fall > falls_sigma * sigma:
            return True
    return False


def _factor(now: Seen, past: tuple[Seen, ...], settings: Escalation, limits: Mapping[str, Limit]) -> float:
    """The largest growth whose prediction leaves the reserve to every limit."""
    most = min(settings.growth, 100.0 / now.percent)
    for factor in np.geomspace(most, 1.0, 60) if most > 1.0 else []:
        rooms = _rooms(now, past, limits, float(factor))
        if min((one.left_percent for one in rooms), default=100.0) >= settings.reserve_percent:
            return float(factor)
    return 0.0


def _rooms(now: Seen, past: tuple[Seen, ...], limits: Mapping[str, Limit], factor: float) -> tuple[Room, ...]:
    """Both sides of every limit under so many times the amplitude.

    Excursions grow as a power of the amplitude that is 1 at the near end of the interval and, at the far end, what the
    step before showed where that is more (friction that lets go); a longer record's noise peaks higher by its rms.
    """
    rest = past[0] if past else now
    rooms = []
    for column, limit in limits.items():
        if column not in now.mean:
            continue
        middle, noise = rest.mean.get(column, now.mean[column]), NOISE_PEAK * rest.rms.get(column, 0.0)
        steep = exponent(now, past, column)
        for sign, end, far in ((1.0, limit.high, now.high[column]), (-1.0, limit.low, now.low[column])):
            shift = sign * (now.mean[column] - middle)
            near = shift + max(far - noise, 0.0) * factor * (1.0 - REPEATS)
            most = max(shift, 0.0) * factor + far * factor**steep * (1.0 + REPEATS) + noise / NOISE_PEAK
            room = max(sign * (end - middle), 1e-300)
            predicted = (middle + sign * near, middle + sign * most)
            left = 100.0 * (1.0 - most / room)
            rooms.append(Room(column, end, middle, middle + sign * (shift + far), predicted, left))
    return tuple(rooms)


def exponent(now: Seen, past: tuple[Seen, ...], column: str) -> float:
    """By which power of the amplitude a column's motion grew since the step before; 1 at least."""
    before = past[-1] if len(past) > 1 else None
    if before is None or not now.percent > before.percent > 0.0 or column not in before.rms:
        return 1.0
    noise = past[0].rms.get(column, 0.0) ** 2
    was, now_is = max(before.rms[column] ** 2 - noise, 0.0), max(now.rms[column] ** 2 - noise, 0.0)
    if not was > noise:  # it cannot be told from noise
        return 1.0
    grew = 0.5 * np.log(now_is / was) / np.log(now.percent / before.percent) if now_is > 0.0 else 1.0
    return float(np.clip(grew, 1.0, 2.0))  # largest exponent by which an excursion is taken to grow with the amplitude
