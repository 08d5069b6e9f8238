"""A recording so far -> how accurate it is by octaves, whether it is enough, or how much more it takes.

Who looks many times at a 95 % interval is wrong more often than in 5 %. Between looks at times t_k the standardised
error is that of a Brownian motion, B(t_k)/sqrt(t_k); `boundary` is the constant that it exceeds at any of them as
rarely as it exceeds 1.96 at one (Pocock, Biometrika 64, 1977; computed as Armitage, McPherson and Rowe, J. R. Stat.
Soc. A 132, 1969). Until the end, intervals are wider by that factor over 1.96.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum
from itertools import pairwise

import numpy as np

from loopshape.core.errors import BadSignalError, WrongUseError
from loopshape.core.json_ready import Plain, keys
from loopshape.core.outcomes import Outcome
from loopshape.core.units import Array
from loopshape.data.control.controller import Controller
from loopshape.data.requirement.requirements import Requirements
from loopshape.data.response.frf import FRF
from loopshape.data.signal.experiment import LoopSetup
from loopshape.data.signal.recording import Recording
from loopshape.identify.frequency_response import estimate_frf
from loopshape.toolbox.validation.comparison import estimate_sensitivity

#: one side of a 95 % interval
SIDE, NORMAL = 0.025, 1.959963984540054
#: periods at the first look; each next look comes after so many times the time of the one before
FIRST, APART = 4, 1.25
#: a recording without periods is looked at first after so many times 1/lowest frequency
CYCLES = 10.0
_GRID = np.linspace(-8.0, 8.0, 401)


class Of(StrEnum):
    """Whose accuracy ends a measurement: that of S, which margins of the running loop rest on, or of the plant."""

    SENSITIVITY = "S"
    PLANT = "P"


class State(StrEnum):
    """What a recording so far is good for; only the first goes on."""

    MORE = "more"
    ACCURATE = "accurate"
    DECIDED = "decided"


@dataclass(frozen=True)
class Band(Plain):
    """Rms over an octave of the std of S (over |S| where that is above 1) and of the plant's (over |P|).

    inf where nothing is known; a recording in open loop has no S. dS = -S T dP/P: margins need no more of P than S
    shows, which is most about the crossover.
    """

    low_hz: float
    high_hz: float
    sensitivity_std: float | None
    plant_std: float


@dataclass(frozen=True)
class Until:
    """What ends a recording: the accuracy `std` in every octave, of S or of the plant, or a decided verdict.

    The std of S is over |S| where that is above 1, that of the plant over |P|. The verdict is on each loop's
    `requirements` and its own controller, or that of `controllers`, by loop.
    """

    std: float | None = None
    requirements: tuple[Requirements, ...] = ()
    of: Of = Of.SENSITIVITY
    controllers: Mapping[str, Controller] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if (self.std is None) == (not self.requirements):
            raise WrongUseError(
                "a measurement ends at an accuracy or with a verdict",
                "both" if self.requirements else "neither",
                "give a relative std of S, or requirements",
            )
        if self.std is not None and not 0.0 < self.std < 1.0:
            raise WrongUseError("the accuracy that ends a measurement lies between 0 and 100 %", f"{self.std!r}")

    def worst(self, bands: Sequence[Band]) -> float:
        """The std of the worst octave."""
        plant = self.of is Of.PLANT
        found = [x.plant_std if plant or x.sensitivity_std is None else x.sensitivity_std for x in bands]
        return max(found, default=float("inf"))

    def required(self, loop: str) -> Requirements | None:
        """What is required of a loop, None without."""
        return next((one for one in self.requirements if one.loop in ("", loop)), None)


@dataclass(frozen=True)
class Look(Plain):
    """What a recording so far is: after `elapsed_s`, in `bands`; the verdict's `outcome` where one is asked for.

    `more_s` is about how much longer it takes if the estimates stay: 0 where it is enough, None where that is unknown.
    """

    ALSO = keys("sentence")

    recording: str
    elapsed_s: float
    state: State
    bands: tuple[Band, ...]
    outcome: Outcome | None = None
    more_s: float | None = None

    @property
    def sentence(self) -> str:
        """The same in words."""
        closed = any(one.sensitivity_std is not None for one in self.bands)
        asked = (("sensitivity_std", "S"), ("plant_std", "P"))[0 if closed else 1 :]
        known = " and ".join(_worst(self.bands, key, name) for key, name in asked)
        after = f"{self.recording} after {self.elapsed_s:.4g} s: {known}"
        if self.state is State.ACCURATE:
            return f"{after}: accurate enough"
        if self.state is State.DECIDED and self.outcome is not None:
            return f"{after}: enough for a verdict on these requirements ({self.outcome.word})"
        if self.more_s is None:
            return f"{after}: how much longer is not known yet"
        return f"{after}: about {self.more_s:.2g} s more"


def until_of(asked: Until | float | Sequence[Requirements] | None) -> Until | None:
    """What a number (a std of S) or requirements stand for."""
    if asked is None or isinstance(asked, Until):
        return asked
    return Until(std=float(asked)) if isinstance(asked, int | float) else Until(requirements=tuple(asked))


def _worst(bands: Sequence[Band], key: str, name: str) -> str:
    worst = max(bands, key=lambda one: float(getattr(one, key)), default=None)
    if worst is None:
        return f"nothing is known of {name} yet"
    return (
        f"{name} to {100.0 * float(getattr(worst, key)):.2g} % (worst at {worst.low_hz:.3g} to {worst.high_hz:.3g} Hz)"
    )


def look(
    recording: Recording, loop: LoopSetup, until: Until, widened: float = 1.0, *, strict: bool = False
) -> Look:  # fmt: skip
    """What a recording is so far; its intervals are wider by `widened` while more looks are to come.

    A recording from which nothing follows yet needs more of an unknown length; `strict` refuses it with how long it has
    to be. Misleads where the response is coarser
    than the recording's frequencies: no interval shows that.
    """
    name, elapsed_s = recording.info.name, _measured_s(recording)
    try:
        bands, P = accuracy(recording, loop)
    except BadSignalError:
        if strict:
            raise
        return Look(name, elapsed_s, State.MORE, ())
    if until.std is not None:
        times = (until.worst(bands) / until.std) ** 2
        state = State.ACCURATE if times <= 1.0 else State.MORE
        more = None if not np.isfinite(times) else max(times - 1.0, 0.0) * elapsed_s
        return Look(name, elapsed_s, state, bands, more_s=more)
    outcome, more = _verdict(P, loop, until, widened, elapsed_s)
    state = State.MORE if outcome is Outcome.UNDECIDED else State.DECIDED
    return Look(name, elapsed_s, state, bands, outcome, 0.0 if state is State.DECIDED else more)


def would_do(bands: Sequence[Band], P: FRF, loop: LoopSetup, until: Until, share: float) -> bool:
    """Whether a recording would be enough if its variance were `share` of that of `bands` and P."""
    if until.std is not None:
        return bool(until.worst(bands) * np.sqrt(share) <= until.std)
    return _verdict(P, loop, until, float(np.sqrt(share)), 1.0)[0] is not Outcome.UNDECIDED


def _verdict(
    P: FRF, loop: LoopSetup, until: Until, widened: float, elapsed_s: float
) -> tuple[Outcome, float | None]:  # fmt: skip
    """The verdict with wider intervals, and about how much more time it takes; refuses a loop without requirements."""
    from loopshape.verbs.chain import check

    own = until.controllers.get(loop.name) or until.controllers.get("") or loop.controller
    R, C = until.required(loop.name), own
    if R is None or C is None:
        raise WrongUseError(
            f"loop {loop.name!r} has no verdict that could end its recording",
            "no controller" if R else "no requirements of it", "give both",
        )  # fmt: skip
    if not P.valid.any():
        return Outcome.UNDECIDED, None
    found = check(replace(P, covariance=P.covariance * widened**2), C, R)
    if found.outcome is not Outcome.UNDECIDED:  # wider errors may hide what leaves the true ones undecided
        same = widened <= 1.0 or check(P, C, R).outcome is found.outcome
        return found.outcome if same else Outcome.UNDECIDED, 0.0 if same else None
    times = [line.longer for line in found.lines if line.outcome is Outcome.UNDECIDED]
    if not times or any(one is None or not np.isfinite(one) for one in times):
        return found.outcome, None
    return found.outcome, max(max(float(one or 1.0) for one in times) - 1.0, 0.0) * elapsed_s


def accuracy(recording: Recording, loop: LoopSetup) -> tuple[tuple[Band, ...], FRF]:
    """Accuracy by octaves and the plant's FRF."""
    P = estimate_frf(recording, loop)
    closed = recording.info.closed_loop and recording.info.alone
    S = estimate_sensitivity(recording, loop) if closed else P
    f, error = S.frequency_hz, np.sqrt(S.variance[:, 0, 0]) / np.maximum(np.abs(S.siso), 1.0)
    octaves = np.floor(np.log2(f / f[0]) + 1e-9)
    bands = []
    for k in np.unique(octaves):
        low, high = float(f[0] * 2.0**k), float(min(f[0] * 2.0 ** (k + 1.0), f[-1]))
        beside = (P.frequency_hz >= low * (1.0 - 1e-9)) & (P.frequency_hz <= high * (1.0 + 1e-9))
        bands.append(Band(low, high, _rms(error[octaves == k]) if closed else None, _rms(P.relative_std[beside, 0, 0])))
    return tuple(bands), P


def _rms(x: Array) -> float:
    return float(np.sqrt(np.mean(x**2))) if x.size else float("inf")


def _measured_s(recording: Recording) -> float:
    n = int(np.asarray(recording.columns[next(iter(recording.columns))]).size)
    return max(n / recording.rate_hz - (recording.info.periodic_from_s or 0.0), 0.0)


def looks_s(info_s: tuple[float | None, float | None], f_low_hz: float, whole_s: float) -> tuple[float, ...]:
    """When a recording is looked at, in s from its start, the last look at its end.

    `info_s` are its period and where that begins. The first look comes after `FIRST` periods (`CYCLES` of the lowest
    frequency without periods), each next one after `APART` times as long.
    """
    period_s, from_s = info_s[0], info_s[1] or 0.0
    step = period_s or CYCLES / f_low_hz
    count, times = float(FIRST if period_s else 1), []
    while from_s + count * step <= whole_s * (1.0 + 1e-9):
        times.append(from_s + count * step)
        count = float(np.ceil(count * APART)) if period_s else count * APART
    if not times or times[-1] < whole_s - 0.5 * step:
        times.append(whole_s)
    return tuple(times)


def boundary(times_s: Sequence[float]) -> float:
    """The constant that a standardised error exceeds at any of these times (rising, from the start) in 2.5 %.

    Examples
    --------
    >>> round(boundary([1.0]), 3), round(boundary([1.0, 2.0, 3.0, 4.0, 5.0]), 2)
    (1.96, 2.41)
    """
    steps = [_step(before, now) for before, now in pairwise(times_s)]
    low, high = NORMAL, 4.5
    for _ in range(30):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if _crossed(steps, middle) > SIDE else (low, middle)
    return 0.5 * (low + high)


def _step(before: float, now: float) -> Array:
    """Density of the standardised error at a time, given each of its values at a time before, on the grid."""
    tie = np.sqrt(before / now)
    spread = np.sqrt(max(1.0 - tie**2, 1e-6))
    wide = np.exp(-0.5 * ((_GRID[:, None] - tie * _GRID) / spread) ** 2)
    return np.asarray(wide / (spread * np.sqrt(2.0 * np.pi)))


def _crossed(steps: Sequence[Array], bound: float) -> float:
    """Probability that the standardised error exceeds `bound` at any look, by a recursion over its density."""
    cell = _GRID[1] - _GRID[0]
    inside = np.clip((bound - _GRID) / cell + 0.5, 0.0, 1.0)  # the share of each cell below the bound
    density = np.exp(-0.5 * _GRID**2) / np.sqrt(2.0 * np.pi) * inside
    for step in steps:
        density = (step @ density) * cell * inside
    return float(1.0 - density.sum() * cell)
