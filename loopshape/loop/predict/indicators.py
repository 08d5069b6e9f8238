"""What is read off steps and profiles, of a predicted response or of a recording; defined in `Indicators`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.ndimage import uniform_filter1d

from loopshape.core.errors import BadSignalError
from loopshape.core.outcomes import Settling
from loopshape.core.units import Array
from loopshape.data.result.prediction import INDICATORS, Indicators, StepComparison, Tracking
from loopshape.data.signal.experiment import LoopSetup
from loopshape.data.signal.recording import Recording

#: share of what was seen whose mean is the final value, and share over which a settled response stays in its band
END, STAYS = 0.1, 0.2
#: a recorded response is smoothed over this share of its rise; bands are wider than what moved over this share before
SMOOTHED, BEFORE, ROOM = 0.1, 0.4, 1.5


def indicators(time_s: Array, response: Array, *, floor: float = 0.0, final: float | None = None) -> Indicators:
    """Indicators of an answer (n,) to a unit step at time 0, from rest at 0; `time_s` (n,) begins at 0.

    `final` is y1 where it is known (of a model), else the mean of the last tenth. `floor` is how far the response
    moves by itself, by noise: narrower bands cannot be seen and are widened to it, and no smaller overshoot counts.
    """
    y1 = float(np.mean(response[-max(1, round(END * response.size)) :])) if final is None else final
    if abs(y1) < 1e-9:
        nan = float("nan")
        return Indicators(nan, nan, nan, nan, 1.0, Settling.NOT_SETTLED)
    y, floor = response / y1, floor / abs(y1)
    stays = np.abs(y[-max(1, round(STAYS * y.size)) :] - 1.0) <= max(0.02, floor)
    overshoot = float(y.max()) - 1.0
    return Indicators(
        rise_time_s=_first(time_s, y, 0.9) - _first(time_s, y, 0.1),
        settling_time_s=_settled_from(time_s, y, max(0.02, floor)),
        settling_time_5_s=_settled_from(time_s, y, max(0.05, floor)),
        overshoot=overshoot if overshoot > floor else 0.0,
        steady_state_error=1.0 - y1,
        outcome=Settling.SETTLED if stays.all() else Settling.NOT_SETTLED,
    )


def _first(time_s: Array, y: Array, level: float) -> float:
    """When y first reaches a level, nan where it never does."""
    reached = np.flatnonzero(y >= level)
    if not reached.size:
        return float("nan")
    k = int(reached[0])
    return float(time_s[0]) if k == 0 else _between(time_s, y, level, k - 1)


def _between(time_s: Array, y: Array, level: float, k: int) -> float:
    share = (level - y[k]) / (y[k + 1] - y[k])
    return float(time_s[k] + share * (time_s[k + 1] - time_s[k]))


def _settled_from(time_s: Array, y: Array, band: float) -> float:
    """From when on |y - 1| stays within the band; nan where it leaves it within the last fifth of what was seen."""
    outside = np.flatnonzero(np.abs(y - 1.0) > band)
    if not outside.size:
        return float(time_s[0])
    k = int(outside[-1])
    if k >= y.size - max(1, round(STAYS * y.size)):
        return float("nan")
    return _between(time_s, np.abs(y - 1.0), band, k)


def with_intervals(nominal: Indicators, drawn: Sequence[Indicators]) -> Indicators:
    """The nominal indicators with the 2.5 and 97.5 % quantiles of draws; one that does not settle counts as never."""
    found: dict[str, tuple[float, float]] = {}
    for name in INDICATORS:
        values = np.array([getattr(one, name) for one in drawn])
        values = np.where(np.isnan(values), np.inf, values)
        low, high = np.quantile(values, [0.025, 0.975], method="closest_observation")
        found[name] = (float(low), float(high))
    return replace(nominal, intervals=found)


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
