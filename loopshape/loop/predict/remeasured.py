"""A run under new controllers and the predictions that it is compared with: who belongs to whom, all of it at once."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from loopshape.core.errors import WrongUseError
from loopshape.core.json_ready import Plain, keys
from loopshape.data.response.frf import FRF
from loopshape.data.result.prediction import Comparison, Prediction, StepComparison, Tracking
from loopshape.data.signal.recording import Recording
from loopshape.data.signal.run import Run
from loopshape.identify.frequency_response import estimate_sensitivity
from loopshape.identify.settings import Settings
from loopshape.loop.predict.indicators import recorded_steps, tracking
from loopshape.loop.predict.prediction import compare, compare_step, sensitivity_of


@dataclass(frozen=True, eq=False)
class Remeasured(Plain):
    """One prediction with all that a run says of it: S measured and compared, steps, and profiles by recording.

    Empty where the run has nothing of that kind at the prediction's operating point.
    """

    IN_JSON = keys(
        loop="prediction.loop", predicted_from="prediction.recording",
        operating_point="prediction.sensitivity.operating_point", comparisons="comparisons", steps="steps",
        profiles="profiles",
    )  # fmt: skip

    prediction: Prediction
    measured: tuple[FRF, ...]
    comparisons: tuple[Comparison, ...]
    steps: tuple[StepComparison, ...]
    profiles: Mapping[str, Tracking]


def remeasure(
    run: Run,
    predictions: Sequence[Prediction],
    *,
    frfs: Sequence[FRF] = (),
    settings: Settings | None = None,
    level: float = 0.05,
    tolerance_db: float = 0.0,
) -> list[Remeasured]:
    """Each prediction against the recordings of its loop at its operating point and settings of the rig.

    S comes from the estimation recordings that excite the loop alone; where a run has none there, from `frfs` of it
    that name the controller. `level` is for all comparisons together: each is judged at 1 - (1 - level)^(1/n), so that
    a run that bears every prediction out is contradicted `level` of the time. Steps come from every recording in which
    the loop's setpoint steps, profiles from those in which it moves otherwise. Refuses a run in which no recording
    belongs to any prediction.
    """
    found = [(one, measured_of(run, one, frfs, settings), _moving(run, one)) for one in predictions]
    count = sum(len(measured) for _, measured, _ in found)
    if not count and not any(moving for _, _, moving in found):
        raise WrongUseError(
            "no recording of the run belongs to any of the predictions",
            f"{len(run.recordings)} recordings, {len(predictions)} predictions",
            "measure the predicted loops at the predicted operating points, under the predicted controllers",
        )
    each = 1.0 - (1.0 - level) ** (1.0 / max(count, 1))
    return [
        Remeasured(
            one,
            measured,
            tuple(compare(one, frf, level=each, tolerance_db=tolerance_db) for frf in measured),
            tuple(compare_step(step, one) for r in moving for step in recorded_steps(r, run.loop(one.loop))),
            {r.info.name: _tracked(run, r, one) for r in moving if not recorded_steps(r, run.loop(one.loop))},
        )
        for one, measured, moving in found
    ]


def measured_of(
    run: Run, prediction: Prediction, frfs: Sequence[FRF] = (), settings: Settings | None = None
) -> tuple[FRF, ...]:
    """S of a prediction's loop at its operating point, from each recording that excites it, else from FRFs."""
    loop = run.loop(prediction.loop)
    mine = [r for r in run.recordings if _here(r.info.operating_point, r.info.parameters, prediction)]
    exciting = [
        r for r in mine if r.info.alone and r.info.excites == loop.name and r.info.role == "estimation"
        and r.info.injection != "control" and r.info.closed_loop
    ]  # fmt: skip
    if exciting:
        return tuple(estimate_sensitivity(r, loop, settings) for r in exciting)
    return tuple(
        sensitivity_of(frf) for frf in frfs if frf.loop == loop.name and frf.recorded_under is not None
        and _here(frf.operating_point, frf.parameters, prediction)
    )  # fmt: skip


def _here(point: Mapping[str, float], parameters: Mapping[str, float], prediction: Prediction) -> bool:
    """Whether something was measured at a prediction's operating point and settings of the rig."""
    S = prediction.sensitivity
    return _same(point, S.operating_point) and _same(parameters, S.parameters)


def _same(one: Mapping[str, float], two: Mapping[str, float]) -> bool:
    return set(one) == set(two) and all(abs(one[k] - two[k]) <= 1e-9 * max(1.0, abs(one[k])) for k in one)


def _moving(run: Run, prediction: Prediction) -> list[Recording]:
    """Closed-loop recordings at a prediction's operating point in which its loop's setpoint moves."""
    loop = run.loop(prediction.loop)
    return [
        r for r in run.recordings
        if r.info.closed_loop and loop.reference is not None and loop.reference in r.columns
        and _here(r.info.operating_point, r.info.parameters, prediction) and np.ptp(r.column(loop.reference)) > 0.0
    ]  # fmt: skip


def _tracked(run: Run, recording: Recording, prediction: Prediction) -> Tracking:
    step = prediction.step
    if step is None:
        return tracking(recording, run.loop(prediction.loop))
    return tracking(recording, run.loop(prediction.loop), step.time_s, step.response)
