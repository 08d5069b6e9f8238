"""What each step from an old controller to a new one will be, on a measured plant: stable, how near to -1, and S."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from loopshape.core.json_ready import Plain, keys
from loopshape.core.outcomes import ClosedLoop, Outcome
from loopshape.core.units import db
from loopshape.data.algebra import feedback
from loopshape.data.control.controller import Controller
from loopshape.data.requirement.requirements import Requirements
from loopshape.data.response.frf import FRF
from loopshape.data.result.verdict import Verdict
from loopshape.loop.loop import Loop
from loopshape.loop.loops import loops_of
from loopshape.loop.stability.stability import closed_loop_stability
from loopshape.toolbox.rig.adopt.blend import blended
from loopshape.toolbox.validation.predicted.nouns import Prediction

#: shares of the new controller, step by step
SHARES = (0.25, 0.5, 1.0)
#: largest |S| of a step on the way, the upper end of its 95 % interval: the loop then stays 0.3 away from -1
WAY_PEAK_DB = 10.0
#: what is required of the new controller where nothing is: |S| of at most 6 dB is a modulus margin of 0.5
PEAK_DB = 6.0
#: relative std of lines that are known, in the median of five
KNOWN = 0.1


def required(loop: str, asked: Sequence[Requirements]) -> Requirements:
    """The requirements of a loop, or the default: stable, with a peak |S| of 6 dB."""
    own = next((one for one in asked if one.loop in ("", loop)), None)
    return own or Requirements(loop, sensitivity_peak_db=PEAK_DB)


@dataclass(frozen=True, eq=False)
class Foreseen(Plain):
    """One step on one plant: the `share` of the new controller, S as predicted, and the largest |S| with its 95 % end.

    `reason` says why the step is not taken, "" where it may be; `decided` that no further measurement would change it.
    """

    IN_JSON = keys("share", "recording", "stability", "peak_db", "peak_most_db", "reason")

    share: float
    loop: Loop
    prediction: Prediction
    peak_db: float
    peak_most_db: float
    reason: str
    decided: bool = True

    @property
    def recording(self) -> str:
        """Where the plant was measured."""
        return self.prediction.recording

    @property
    def stability(self) -> ClosedLoop:
        """What the count says."""
        return self.prediction.stability


def foresee(P: FRF, controller: Controller, R: Requirements, share: float) -> Foreseen:
    """One controller, or a share of one, on one plant (1 x 1). The step is refused unless it is stable by the data.

    Misleads where the plant is another by now, or answers another amplitude otherwise.
    """
    (loop,), notes = loops_of([P], controller, R)
    stability = closed_loop_stability(loop)
    plant = loop.measured
    S = replace(feedback(plant, controller).S_o, recorded_under=controller, loop=P.loop)
    size, spread = np.abs(S.siso), np.sqrt(S.variance[:, 0, 0])
    peak, most = float(db(size.max())), float(db((size + 1.96 * spread).max()))
    reason, decided = "", True
    if stability.outcome is not ClosedLoop.STABLE:
        reason, decided = (
            f"the loop is {stability.outcome}: {stability.reason}",
            stability.outcome is ClosedLoop.UNSTABLE,
        )
    elif share < 1.0 and most > WAY_PEAK_DB:
        reason, decided = f"|S| may reach {most:.3g} dB, more than {WAY_PEAK_DB:g} dB", peak > WAY_PEAK_DB
    return Foreseen(share, loop, Prediction(S, stability.outcome, notes=notes), peak, most, reason, decided)


@dataclass(frozen=True, eq=False)
class Forecast(Plain):
    """Every step to a new controller on one plant, and the verdict on it alone.

    `outcome` is "passed" where all may be done, "failed" where the data rule a step or the new controller out, and else
    "undecided".
    """

    IN_JSON = keys("outcome", "reason", "steps", "verdict")

    steps: tuple[Foreseen, ...]
    verdict: Verdict

    @property
    def refused(self) -> Foreseen | None:
        """The first step that may not be done."""
        return next((one for one in self.steps if one.reason), None)

    @property
    def outcome(self) -> Outcome:
        """The worst of the steps and the verdict."""
        steps = [Outcome.FAILED if one.decided else Outcome.UNDECIDED for one in self.steps if one.reason]
        return Outcome.worst([*steps, self.verdict.outcome])

    @property
    def reason(self) -> str:
        """Why the outcome is not "passed", "" where it is."""
        if self.verdict.outcome is Outcome.FAILED or (
            self.refused is None and self.verdict.outcome is not Outcome.PASSED
        ):
            return f"the new controller: {_verdict_words(self.verdict)}"
        one = self.refused
        return "" if one is None else f"at a share of {one.share:g}: {one.reason}"


def forecast(P: FRF, old: Controller, new: Controller, R: Requirements, shares: Sequence[float] = SHARES) -> Forecast:
    """All steps from one controller to another on a measured plant. A sum of two stabilising ones need not be one.

    Of a new controller that fails by itself the steps are not looked at.
    """
    from loopshape.verbs.chain import check

    verdict = check(P, new, R)
    shares = () if verdict.outcome is Outcome.FAILED else shares
    return Forecast(tuple(foresee(P, blended(old, new, share), R, share) for share in shares), verdict)


def _verdict_words(verdict: Verdict) -> str:
    """The outcome with the line that decides it, or why the loop's stability does."""
    lines = [x for x in verdict.lines if x.outcome is not Outcome.PASSED]
    worst = max(lines, key=lambda x: x.outcome.severity, default=None)
    loops = [m for m in verdict.margins.values() if m.stable is not ClosedLoop.STABLE]
    reason = next((m.stability_reason for m in loops if m.stable.outcome is verdict.outcome), "")
    found = f"{worst.quantity} {worst.value:.3g}, required {worst.required:.3g}" if worst else ""
    return f"{verdict.outcome.word}; " + (reason or found or "nothing is decided")
