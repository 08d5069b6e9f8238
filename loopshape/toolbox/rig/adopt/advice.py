"""From logs alone: go, no go, or not decidable, and then what to record."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from loopshape.core.errors import WrongUseError
from loopshape.core.json_ready import Plain
from loopshape.core.outcomes import Graded, Outcome
from loopshape.data.control.controller import Controller
from loopshape.data.requirement.requirements import Requirements
from loopshape.data.response.frf import FRF
from loopshape.data.result.verdict import SettledBy, Verdict
from loopshape.data.signal.disturbance import Disturbance
from loopshape.data.signal.run import Run
from loopshape.identify.disturbance import disturbances_in
from loopshape.loop.tolerances import TOL
from loopshape.toolbox.rig.adopt.course import TrialSettings
from loopshape.toolbox.rig.adopt.forecast import Forecast, forecast, foresee
from loopshape.toolbox.validation.nouns import Agreement, Comparison
from loopshape.toolbox.validation.remeasured import remeasure

#: a recipe without a plant: so many lines, S on each to this std, after so many seconds; its band as shares of the rate
LINES, ACCURACY, SECONDS, BAND = 100, 0.05, 60.0, (5e-4, 0.2)


class Advice(Graded):
    """What logs say of a change of controllers."""

    GO = "go"
    NOT_DECIDABLE = "not decidable"
    NO_GO = "no go"


@dataclass(frozen=True, eq=False)
class Advised(Plain):
    """The advice, why, and where nothing is decided what to record, a sentence each.

    `forecasts` are of each FRF under the old controller; `comparisons` of what was recorded under the new one with what
    was predicted, empty without such a log. "go" without one means that a trial may begin, not that it will end well.
    """

    advice: Advice
    reason: str
    recipe: tuple[str, ...] = ()
    forecasts: tuple[Forecast, ...] = ()
    comparisons: tuple[Comparison, ...] = ()


def advise(
    before: Sequence[FRF], old: Controller, new: Controller, R: Requirements, settings: TrialSettings,
    after: Run | None = None, after_frfs: Sequence[FRF] = (),
) -> Advised:  # fmt: skip
    """Of FRFs under the old controller, and perhaps a run under the new one with its FRFs."""
    from loopshape.verbs.chain import check

    found = tuple(forecast(P, old, new, R, settings.shares) for P in before)
    worst = max(found, key=lambda one: one.outcome.severity)
    if worst.outcome is Outcome.FAILED:
        return Advised(Advice.NO_GO, worst.reason, (), found)
    if after is None:
        if worst.outcome is Outcome.PASSED:
            why = "every share is stable on the measured plant and the requirements hold: try it in shares"
            return Advised(Advice.GO, why, (), found)
        return Advised(Advice.NOT_DECIDABLE, worst.reason, _orders(worst), found)
    predicted = [foresee(P, new, R, 1.0).prediction for P in before]
    try:
        seen = remeasure(after, predicted, frfs=after_frfs, level=settings.level, tolerance_db=settings.tolerance_db)
    except WrongUseError as error:
        return Advised(Advice.NOT_DECIDABLE, str(error), (_EXCITE,), found)
    compared = tuple(c for one in seen for c in one.comparisons)
    verdict = check(list(after_frfs), new, R) if after_frfs else None
    return _of_both(worst, found, compared, verdict, settings)


def _of_both(
    worst: Forecast, found: tuple[Forecast, ...], compared: tuple[Comparison, ...], verdict: Verdict | None,
    settings: TrialSettings,
) -> Advised:  # fmt: skip
    """What a log under the new controller adds."""
    refuted = [c for c in compared if c.outcome is Agreement.REFUTED]
    blind = [c for c in compared if c.outcome is Agreement.CANNOT_TELL]
    if refuted:
        first = refuted[0]
        why = f"S is not the predicted one under the new controller ({first.measured_from}, p = {first.p_value:.2g})"
        return Advised(Advice.NO_GO, why, (), found, compared)
    if verdict is not None and verdict.outcome is Outcome.FAILED:
        return Advised(Advice.NO_GO, f"under the new controller: {verdict!r}", (), found, compared)
    if blind or not compared:
        why = (
            "the log under the new controller would not notice another S" if blind else "nothing excites the loop there"
        )
        return Advised(
            Advice.NOT_DECIDABLE, why, tuple(_longer(c, settings) for c in blind) or (_EXCITE,), found, compared
        )
    if verdict is None or verdict.outcome is not Outcome.PASSED:
        why = "the requirements are not decided under the new controller"
        return Advised(Advice.NOT_DECIDABLE, why, _orders(worst, verdict), found, compared)
    return Advised(Advice.GO, "S is the predicted one and the requirements hold under it", (), found, compared)


_EXCITE = "record a multisine at the controller's input under the new controller, and name it as the excitation"


def _longer(c: Comparison, settings: TrialSettings) -> str:
    """How much more a comparison needs: its errors fall with the square root of the length."""
    wanted = max(TOL.noticed_db, 2.0 * settings.tolerance_db)
    if not np.isfinite(c.noticed_db):
        return f"{c.measured_from}: excite the frequencies of the run under the old controller, with more amplitude"
    times = (c.noticed_db / wanted) ** 2
    return (
        f"{c.measured_from}: record {times:.2g} times as long, or with {np.sqrt(times):.2g} times the amplitude (now a"
        f" change of the gain of {c.noticed_db:.2g} dB would be noticed, {wanted:.2g} dB are to be)"
    )


def _orders(worst: Forecast, verdict: Verdict | None = None) -> tuple[str, ...]:
    """What would settle a verdict, as the commands that plan it; words where no measurement does."""
    orders = (verdict or worst.verdict).orders
    made = [
        f"record {x.low_hz:.4g} to {x.high_hz:.4g} Hz in steps of {x.resolution_hz:.2g} Hz for {x.seconds:.3g} s:"
        f" {x.command}"
        for x in orders
        if x.by is SettledBy.MEASUREMENT
    ]
    if any(x.by is SettledBy.DECLARATION for x in orders):
        made.append("declare integrators and unstable_poles of the loop in the requirements")
    return tuple(made) or ("record for longer, or with more amplitude, about the frequency of the largest |S|",)


def without_plant(run: Run, loop: str, why: str) -> Advised:
    """Of a run from which no FRF follows: what to record, by what disturbs the loop where the run shows it."""
    rests = disturbances_in(run, loop)
    return Advised(Advice.NOT_DECIDABLE, why, (_first(rests[0]) if rests else _FIRST,))


_FIRST = (
    "record the loop with a multisine at the controller's input, four periods or more, over a decade on both sides of"
    " the crossover, as large as limits allow"
)


def _first(rest: Disturbance) -> str:
    """A multisine after which S is known to `ACCURACY` on each line, by the error's largest density in its band."""
    rate_hz = rest.rate_hz or 0.0
    low, high = (share * rate_hz for share in BAND)
    width = float(rest.frequency_hz[1] - rest.frequency_hz[0])
    smooth = np.convolve(rest.power / width, np.full(9, 1.0 / 9.0), "same")
    density = float(smooth[(rest.frequency_hz >= low) & (rest.frequency_hz <= high)].max(initial=0.0))
    rms = np.sqrt(LINES * density / SECONDS) / ACCURACY
    return (
        f"record {SECONDS:g} s with a multisine at the controller's input, {low:.3g} to {high:.3g} Hz, {LINES}"
        f" frequencies (logarithmic), rms {rms:.3g} in the output's unit: S is then known to {100.0 * ACCURACY:g} %"
    )
