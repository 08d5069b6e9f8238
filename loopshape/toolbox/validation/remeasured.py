"""A run under new controllers beside the predictions that it is compared with: S, steps and profiles of each."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import uniform_filter1d

from loopshape.core.errors import BadSignalError, WrongUseError
from loopshape.core.json_ready import Plain, keys
from loopshape.core.units import Array
from loopshape.data.response.frf import FRF
from loopshape.data.signal.experiment import LoopSetup
from loopshape.data.signal.recording import Recording
from loopshape.data.signal.run import Run
from loopshape.identify.settings import Settings
from loopshape.loop.predict.indicators import END, indicators
from loopshape.toolbox.validation.comparison import compare, compare_step, estimate_sensitivity, sensitivity_of
from loopshape.toolbox.validation.nouns import Comparison, StepComparison, Tracking
from loopshape.toolbox.validation.predicted.nouns import Prediction

#: a recorded response is smoothed over this share of its rise; bands are wider than what moved over this share before
SMOOTHED, BEFORE, ROOM = 0.1, 0.4, 1.5


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


def recorded_steps(recording: Recording, loop: LoopSetup) -> tuple[StepComparison, ...]:
    """Each step of a loop's setpoint in a recording, with its indicators; empty where the setpoint does not step.

    A step is a jump between two stretches on which the setpoint stands still for 50 samples at least; it is looked at
    until the next jump of it. y0 is the mean of the last tenth before the jump, and what the output moved by itself
    over the last two fifths before it is noise: bands narrower than 1.5 times that are widened to it, and it is noted.
    The response is smoothed over a tenth of its rise. Misleads where the output had not come to rest before (noted).
    Other loops' setpoints are not looked at.
    """
    r, y = _setpoint(recording, loop), recording.output(loop.output)
    jumps = np.flatnonzero(np.diff(r)) + 1
    edges = np.concatenate([[0], jumps, [r.size]])
    least_samples = 50  # steps closer together than this many samples are no steps but a moving setpoint
    if not jumps.size or np.diff(edges).min() < least_samples:
        return ()
    return tuple(
        _recorded(recording, loop, y[start:end], int(at - start), int(at), float(r[at] - r[at - 1]))
        for start, at, end in zip(edges[:-2], edges[1:-1], edges[2:], strict=True)
    )


def _recorded(recording: Recording, loop: LoopSetup, y: Array, at: int, row: int, size: float) -> StepComparison:
    """The step at sample `at` of a stretch y (n,), which is row `row` of the recording."""
    before = float(y[:at][-max(1, round(END * at)) :].mean())
    raw = (y - before) / size
    width = _width(raw[at:])
    rest, response = (np.asarray(uniform_filter1d(x, width, mode="nearest")) for x in (raw[:at], raw[at:]))
    calm = rest[-max(2, round(BEFORE * at)) :]
    floor = ROOM * float(np.abs(calm - calm.mean()).max())
    time_s = np.arange(response.size) / recording.rate_hz
    return StepComparison(
        recording=recording.info.name,
        loop=loop.name,
        operating_point=dict(recording.info.operating_point),
        at_s=row / recording.rate_hz,
        size=size,
        measured=indicators(time_s, response, floor=floor),
        time_s=time_s,
        response=response,
        notes=_notes(calm, floor),
    )


def _setpoint(recording: Recording, loop: LoopSetup) -> Array:
    if loop.reference is None or loop.reference not in recording.columns:
        raise BadSignalError(
            f"recording {recording.info.file} has no setpoint of loop {loop.name}",
            ", ".join(recording.columns),
            "name the column as the loop's reference",
        )
    return recording.column(loop.reference)


def _width(raw: Array) -> int:
    """Samples, an odd number, of a tenth of the time to 90 % of where a response ends."""
    final = float(np.mean(raw[-max(1, round(END * raw.size)) :]))
    rise = int(np.argmax(np.abs(uniform_filter1d(raw, 9, mode="nearest")) >= 0.9 * abs(final)))
    return max(1, 2 * round(0.5 * SMOOTHED * rise) + 1)


def _notes(calm: Array, floor: float) -> tuple[str, ...]:
    half = max(calm.size // 2, 1)
    drift = abs(float(calm[:half].mean() - calm[half:].mean()))
    notes: tuple[str, ...] = ()
    if drift > 0.02:
        notes += (f"the output still moved by {100.0 * drift:.2g} % of the step before it",)
    if floor > 0.02:
        notes += (f"noise hides a band of 2 % of the step: it is read at {100.0 * floor:.2g} %",)
    return notes


def tracking(
    recording: Recording, loop: LoopSetup, step_time_s: Array | None = None, step: Array | None = None
) -> Tracking:
    """Largest and rms error r - y over a recording, in the loop's unit; predicted too from a unit step's response.

    The mean of r - y before the setpoint first moves is taken off. With `step` (n,) on `step_time_s` the prediction
    is the sum of the setpoint's increments, each answered by that step: exact for a linear loop at rest before.
    """
    r, y = _setpoint(recording, loop), recording.output(loop.output)
    moves = np.flatnonzero(np.diff(r))
    if not moves.size:
        raise BadSignalError(
            f"the setpoint of loop {loop.name} in recording {recording.info.file} does not move", f"{r[0]:g}"
        )
    error = r - y - float(np.mean((r - y)[: moves[0] + 1]))
    found = Tracking(float(np.abs(error).max()), float(np.sqrt(np.mean(error**2))))
    if step is None or step_time_s is None:
        return found
    from scipy.signal import fftconvolve

    at = np.arange(r.size) / recording.rate_hz
    answer = fftconvolve(np.diff(r, prepend=r[0]), np.interp(at, step_time_s, step))[: r.size]
    left = (r - r[0]) - answer
    return Tracking(found.largest_error, found.rms_error, float(np.abs(left).max()), float(np.sqrt(np.mean(left**2))))
