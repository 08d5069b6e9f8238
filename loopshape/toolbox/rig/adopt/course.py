"""From share to share of a new controller: predicted, watched, measured, compared, and on or back."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, field, replace
from enum import StrEnum
from typing import Protocol

import numpy as np

from loopshape.core.errors import LoopshapeError, WrongUseError
from loopshape.core.json_ready import Plain, keys
from loopshape.core.outcomes import Outcome
from loopshape.core.units import from_db
from loopshape.data.control.controller import Controller
from loopshape.data.requirement.requirements import Requirements
from loopshape.data.response.frf import FRF
from loopshape.data.signal.experiment import LoopSetup
from loopshape.data.signal.recording import Recording
from loopshape.identify.frequency_response import estimate_frf
from loopshape.toolbox.rig.adopt.blend import blended
from loopshape.toolbox.rig.adopt.forecast import SHARES, Forecast, Foreseen, forecast, foresee
from loopshape.toolbox.rig.adopt.watched import Expected, Periods, watch_of
from loopshape.toolbox.rig.target.trial import Phase, Progress, Watch
from loopshape.toolbox.validation.comparison import compare, estimate_sensitivity
from loopshape.toolbox.validation.nouns import Agreement, Comparison

#: of so many periods more is a share's recording that decides nothing, once
LONGER = 3.0
#: a recording whose periods differ with a smaller p-value is of no one machine
UNSTEADY = 1e-4
#: stds by which a single line lies off what noise does to the worst of many
SURE = 5.0
#: z this far off what a controller gives is that of another one
OTHER = 0.1


class Adopted(StrEnum):
    """How a trial ended."""

    ADOPTED = "adopted"
    WENT_BACK = "went back"
    UNDECIDED = "undecided"
    REFUSED = "refused"


@dataclass(frozen=True)
class TrialSettings:
    """How a new controller takes over: its `shares`, each reached over `ramp_s` and measured.

    `tolerance_db` is by how much |S|, rms, may lie off its prediction and count as confirmed; `level` is for all
    comparisons together. The target goes back by itself where the host says nothing for `host_s` after a share's
    recording ought to be over.
    """

    shares: tuple[float, ...] = SHARES
    ramp_s: float = 1.0
    tolerance_db: float = 1.0
    level: float = 0.05
    host_s: float = 30.0

    def __post_init__(self) -> None:
        pairs = zip((0.0, *self.shares), self.shares, strict=False)
        if not self.shares or self.shares[-1] != 1.0 or not all(a < b for a, b in pairs):
            raise WrongUseError("shares of a new controller rise from above 0 to 1", f"{self.shares}", "end with 1.0")


@dataclass(frozen=True, eq=False)
class Step(Plain):
    """One share: what was predicted and watched, what was measured, and what followed.

    `error_rms` is of the recording's whole periods, in the output's unit; `outcome` is how the trial ends here, None
    where it goes on.
    """

    IN_JSON = keys(
        "share", "outcome", "reason", "expected", "error_rms", "comparison", "peak_db", "watched", "progress"
    )  # fmt: skip

    share: float
    reason: str
    outcome: Adopted | None = None
    expected: Expected | None = None
    error_rms: float | None = None
    comparison: Comparison | None = None
    watch: Watch | None = None
    progress: Progress | None = None

    @property
    def peak_db(self) -> float | None:
        """Largest |S| as measured."""
        return None if self.comparison is None else self.comparison.measured_peak_db

    @property
    def watched(self) -> dict[str, float] | None:
        """The limits that the target kept, by name."""
        return None if self.watch is None else vars(self.watch)

    @property
    def sentence(self) -> str:
        """The same in words."""
        found = f"share {self.share:g}: "
        if self.comparison is not None:
            found += f"S {self.comparison.outcome} (p = {self.comparison.p_value:.2g}), "
        if self.error_rms is not None and self.expected is not None:
            low, high = self.expected.error_rms
            found += f"error rms {self.error_rms:.3g} (predicted {low:.3g} to {high:.3g}), "
        return found + ("on" if self.outcome is None else str(self.outcome)) + f": {self.reason}"


@dataclass(frozen=True, eq=False)
class Adoption(Plain):
    """How a trial ended and why, share by share. Only "adopted" leaves the new controller in charge."""

    IN_JSON = keys("outcome", "reason", "steps", "controller")

    outcome: Adopted
    reason: str
    steps: tuple[Step, ...]
    controller: Controller
    """The one that is in charge at the end."""

    @classmethod
    def refused(cls, trial: Trial, reason: str) -> Adoption:
        """Nothing moved."""
        return cls(Adopted.REFUSED, reason, (), trial.old)

    @property
    def went_back_by_itself(self) -> bool:
        """Whether the target did, without being asked."""
        return any(one.progress is not None and one.progress.phase is Phase.WENT_BACK for one in self.steps)


class Machine(Protocol):
    """A machine with an old controller in charge and a new one beside it."""

    def record(self, share: float, controller: Controller, watch: Watch | None, longer: float) -> Recording | None:
        """At this share (None watched: the old one alone), that many times as long; None where nothing was recorded."""

    def progress(self) -> Progress:
        """Where the trial is."""

    def keep(self, watch: Watch) -> Progress:
        """The new controller stays."""

    def back(self) -> None:
        """To the old controller; where it is already, nothing."""

    def thinking(self) -> AbstractContextManager[None]:
        """While the host is busy with something else, the machine is told that it is there."""


@dataclass(frozen=True, eq=False)
class Trial:
    """What is tried: `loop` with its `old` controller, the `new` one, and what is required of it."""

    loop: LoopSetup
    old: Controller
    new: Controller
    requirements: Requirements
    settings: TrialSettings = field(default_factory=TrialSettings)

    def at(self, share: float) -> Controller:
        """What closes the loop at a share."""
        return blended(self.old, self.new, share)

    def forecast(self, P: FRF, shares: Sequence[float] | None = None) -> Forecast:
        """Every step on a plant."""
        return forecast(P, self.old, self.new, self.requirements, shares or self.settings.shares)


@dataclass(frozen=True, eq=False)
class _Measured:
    """A recording at a share and what follows from it."""

    P: FRF
    S: FRF
    periods: Periods
    error_rms: float
    recorded_s: float
    ends: tuple[FRF, ...]
    """The plant by the last half of the periods, and by the last two: a machine that changed under way shows there."""

    @classmethod
    def of(cls, recording: Recording, loop: LoopSetup, controller: Controller) -> _Measured:
        own = replace(loop, controller=controller)
        periods = Periods.of(recording, own)
        rms = float(np.sqrt(np.mean(periods.error**2) + np.mean(periods.error_rest**2)))
        S = replace(estimate_sensitivity(recording, own), recorded_under=controller)
        n = np.asarray(recording.column(loop.control)).size
        ends = tuple(estimate_frf(one, own) for one in _ends(recording, len(periods.answers)))
        return cls(estimate_frf(recording, own), S, periods, rms, n / recording.rate_hz, ends)


def _ends(recording: Recording, count: int) -> list[Recording]:
    """The last half of so many periods, and the last two, where that is less than all of them."""
    info, made = recording.info, []
    period = round((info.period_s or 0.0) * recording.rate_hz)
    end = round((info.periodic_from_s or 0.0) * recording.rate_hz) + count * period
    for kept in sorted({count // 2, 2} - {count, 0, 1}):
        columns = {name: np.asarray(recording.column(name))[end - kept * period : end] for name in recording.columns}
        columns["t_s"] = np.arange(kept * period) / recording.rate_hz
        made.append(Recording(replace(info, periodic_from_s=0.0), recording.rate_hz, columns))
    return made


Report = Callable[[Step], None]


def adopt(trial: Trial, machine: Machine, before: Sequence[FRF], report: Report = lambda step: None) -> Adoption:
    """Cross over share by share, or go back.

    `before` are FRFs of the run that the new controller was made from, at this operating point: they rule out what
    they can before anything moves. The plant that everything else is predicted from is measured first, under the old
    controller, so that one that changed since then is seen there. On the way each share's S is compared with that
    prediction, and each recording's own plant must allow the shares that are left.
    """
    steps: list[Step] = []

    def ended(step: Step) -> bool:
        steps.append(step)
        report(step)
        return step.outcome is not None

    def end(outcome: Adopted, reason: str, controller: Controller = trial.old) -> Adoption:
        return Adoption(outcome, reason, tuple(steps), controller)

    if (reason := ruled_out(trial, before)) is not None:
        return end(Adopted.REFUSED, reason)
    base, step = _base(trial, machine)
    if ended(step) or base is None:
        return end(step.outcome or Adopted.UNDECIDED, step.reason)
    last, under = base, trial.old
    for share in (*trial.settings.shares, 1.0):  # what changes while the last share is recorded shows in its second
        last_or_none, step = _share(trial, machine, share, base, last, under)
        if ended(step) or last_or_none is None:
            machine.back()
            return end(step.outcome or Adopted.UNDECIDED, step.reason)
        last, under = last_or_none, trial.at(share)
    kept = machine.keep(replace(steps[-1].watch or Watch(1.0, 0, 0, 1), ramp=0, lease=0))
    if kept.phase is not Phase.STAYS:
        return end(Adopted.WENT_BACK, went_back_words(kept))
    return end(Adopted.ADOPTED, step.reason, trial.new)


def ruled_out(trial: Trial, before: Sequence[FRF]) -> str | None:
    """Why a step to the new controller, or it itself, is ruled out by FRFs; None where it is not."""
    for P in before:
        if not P.valid.any():
            continue
        found = trial.forecast(P)
        if found.outcome is Outcome.FAILED:
            return f"on the plant of {P.recording}, {found.reason}"
    return None


def went_back_words(found: Progress) -> str:
    """Why a target went back by itself."""
    numbers = f" ({found.value:.4g}, watched for {found.limit:.4g})" if found.limit else ""
    return f"the target went back by itself: {found.why.sentence}{numbers}, {found.ticks} ticks after this share began"


def _base(trial: Trial, machine: Machine) -> tuple[_Measured | None, Step]:
    """The old controller alone: the plant as it is now, and whether every step is allowed on it."""
    why = "nothing was recorded"
    for longer in (1.0, LONGER):
        recording = machine.record(0.0, trial.old, None, longer)
        if recording is None or recording.info.ended_early:
            why = "nothing was recorded" if recording is None else str(recording.info.ended_early)
            break
        with machine.thinking():
            try:
                base = _Measured.of(recording, trial.loop, trial.old)
                found = trial.forecast(base.P)
            except LoopshapeError as error:  # nothing is known of the plant
                why = str(error)
                continue
        if found.outcome is Outcome.PASSED:
            return base, Step(0.0, "on the plant as it is now every share is stable and the requirements hold")
        why = f"on the plant as it is now, {found.reason}"
        if found.outcome is Outcome.FAILED:
            return base, Step(0.0, why, Adopted.REFUSED)
    return None, Step(0.0, why, Adopted.UNDECIDED)


def _share(
    trial: Trial, machine: Machine, share: float, base: _Measured, last: _Measured, under: Controller
) -> tuple[_Measured | None, Step]:
    """One share: predicted from the base, watched by the last recording, measured, twice where once decides nothing."""
    controller, step = trial.at(share), Step(share, "nothing was recorded", Adopted.UNDECIDED)
    for longer in (1.0, LONGER):
        with machine.thinking():
            predicted = foresee(base.P, controller, trial.requirements, share)
            now = foresee(last.P, controller, trial.requirements, share)
            lease_s = trial.settings.ramp_s + longer * last.recorded_s + trial.settings.host_s
            watch, expected = watch_of(last.periods, under, now.loop, share, trial.settings.ramp_s, lease_s)
        recording = machine.record(share, controller, watch, longer)
        step = Step(share, "nothing was recorded", Adopted.UNDECIDED, expected, watch=watch)
        if (found := machine.progress()).phase is Phase.WENT_BACK:
            return None, replace(step, reason=went_back_words(found), outcome=Adopted.WENT_BACK, progress=found)
        if recording is None:
            break
        with machine.thinking():
            try:
                measured = _Measured.of(recording, trial.loop, controller)
                step = _tested(trial, replace(step, error_rms=measured.error_rms), predicted, measured)
            except LoopshapeError as error:
                step = replace(step, reason=str(error))
                continue
        if step.outcome is not Adopted.UNDECIDED:
            return measured, step
    return None, step


def _tested(trial: Trial, step: Step, predicted: Foreseen, measured: _Measured) -> Step:
    """Whether S is what was predicted, and this recording's own plant allows what is left."""
    settings = trial.settings
    if (off := measured.periods.off) > OTHER:
        why = f"z is not what this share of the new controller gives: off by {100.0 * off:.2g} %"
        return replace(step, reason=why, outcome=Adopted.WENT_BACK)
    level = 1.0 - (1.0 - settings.level) ** (1.0 / len(settings.shares))
    found = compare(predicted.prediction, measured.S, level=level, tolerance_db=settings.tolerance_db)
    step = replace(step, comparison=found)
    if found.outcome is Agreement.REFUTED:
        why = "S is not the predicted one"
        if (worst := found.worst) is not None:
            why += f", most from {worst.low_hz:.3g} to {worst.high_hz:.3g} Hz ({worst.sensitivity_db:+.2g} dB)"
        return replace(step, reason=why, outcome=Adopted.WENT_BACK)
    if (at_hz := larger_at(predicted.prediction.sensitivity, measured.S, 2.0 * settings.tolerance_db)) is not None:
        why = f"|S| is more than {2.0 * settings.tolerance_db:g} dB above its prediction at {at_hz:.4g} Hz"
        return replace(step, reason=why, outcome=Adopted.WENT_BACK)
    if found.outcome is Agreement.CANNOT_TELL:
        return replace(step, reason="the recording would not notice another S", outcome=Adopted.UNDECIDED)
    if measured.periods.changed(settings.tolerance_db) < UNSTEADY:
        return replace(step, reason="the machine changed while it was recorded", outcome=Adopted.UNDECIDED)
    left = tuple(one for one in settings.shares if one > step.share) or (1.0,)
    last = step.share == settings.shares[-1]
    for end in measured.ends if last else ():
        if end.valid.any() and (late := trial.forecast(end, left)).outcome is Outcome.FAILED:
            return replace(step, reason=f"on the plant of its end, {late.reason}", outcome=Adopted.WENT_BACK)
    plant = trial.forecast(measured.P, left)
    if plant.outcome is Outcome.FAILED:
        return replace(step, reason=f"on the plant as it is now, {plant.reason}", outcome=Adopted.WENT_BACK)
    if last and plant.outcome is not Outcome.PASSED:
        return replace(step, reason=f"on the plant as it is now, {plant.reason}", outcome=Adopted.UNDECIDED)
    done = "the requirements hold under the new controller" if last else "the shares that are left are allowed"
    return replace(step, reason=f"S is as predicted, {done}", outcome=None)


def larger_at(predicted: FRF, measured: FRF, by_db: float) -> float | None:
    """The frequency at which a measured |S| is surely larger than a predicted one by more than so many dB, or None.

    A resonance that moved is a line or two, which a comparison over bands that allows a rms deviation does not notice.
    Refuses none: lines that only one of them has are left out.
    """
    f, i, j = np.intersect1d(predicted.frequency_hz, measured.frequency_hz, return_indices=True)
    if not f.size:
        return None
    allowed = float(from_db(by_db))
    more = np.abs(measured.siso[j]) - allowed * np.abs(predicted.siso[i])
    std = np.hypot(np.sqrt(measured.variance[j, 0, 0]), allowed * np.sqrt(predicted.variance[i, 0, 0]))
    sure = more / np.maximum(std, 1e-300)
    k = int(np.argmax(sure))
    return float(f[k]) if sure[k] > SURE else None
