"""Loop under a new controller, what disturbed it under the old one -> rms of its error, with an interval.

Whatever disturbs a linear loop reaches its error through S. So the error's spectrum under C1 is that under C0 times
|S1/S0|² = |(1 + C0 P)/(1 + C1 P)|², wherever the disturbance enters. The ratio is analytic in P: an error d of P makes
it wrong by d (C0 - C1)/(1 + C1 P)², from which variance and bias of the sum over all lines follow.

Below the lowest frequency P goes on along its integrators, above the highest it falls as 1/f²; how much of the power
lies there is told, and above, the interval reaches to what P = 0 and P = constant would give.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from loopshape.core.errors import WrongUseError
from loopshape.core.noise import rms_interval
from loopshape.core.outcomes import ClosedLoop
from loopshape.data.requirement.requirements import Requirements
from loopshape.data.result.margins import Margins, Reading
from loopshape.data.signal.disturbance import Disturbance
from loopshape.loop.loop import Loop
from loopshape.loop.stability.continued import continued

#: share of the error's power outside the measured band from which on a warning is given
OUTSIDE = 0.1


@dataclass(frozen=True)
class ErrorRms:
    """Rms of a loop's error in the output's unit, 95 % interval, and the share of its power outside the FRF's band."""

    rms: float
    interval: tuple[float, float]
    outside: float


def error_rms(loop: Loop, disturbance: Disturbance) -> ErrorRms:
    """What a loop makes of a disturbance; the loop is taken as stable. Raises WrongUseError for another rate."""
    held = disturbance.recorded_under
    if held is not None and held.rate_hz != loop.controller.rate_hz:
        raise WrongUseError(
            f"what disturbs loop {loop.plant.loop} was recorded at another rate than the controller's",
            f"{held.rate_hz:g} Hz and {loop.controller.rate_hz:g} Hz",
            "record it with a controller of this rate",
        )
    rows = (disturbance.frequency_hz > 0.0) & (disturbance.frequency_hz < 0.5 * loop.controller.rate_hz)
    f, power, scatter = (x[rows] for x in (disturbance.frequency_hz, disturbance.power, disturbance.scatter))
    plant = loop.plant if loop.raw is None else loop.raw
    there = continued(plant, f, loop.integrators or 0)
    P, C1 = there.response, loop.controller.response(f)
    C0 = np.zeros(f.size) if held is None else held.response(f)
    ratio = (1.0 + C0 * P) / (1.0 + C1 * P)
    toward = P * (C0 - C1) / (1.0 + C1 * P) ** 2  # by a relative error of P
    relative = plant.variance[:, 0, 0] / np.abs(plant.siso) ** 2
    kept = np.maximum(np.abs(ratio) ** 2 - np.abs(toward) ** 2 * there.bias(relative), 0.0)
    mean = float(power @ kept)
    each = there.collected(power * ratio.conj() * toward, relative.size)
    variance = 2.0 * plant.line_overlap * float(np.sum(np.abs(each) ** 2 * relative))
    variance += float(scatter @ np.abs(ratio) ** 4)
    above = f > plant.frequency_hz[-1]
    held_up = (1.0 + C0[above] * plant.siso[-1]) / (1.0 + C1[above] * plant.siso[-1])
    apart = [float(power[above] @ (x - kept[above])) for x in (np.ones(int(above.sum())), np.abs(held_up) ** 2)]
    outside = float(power @ (kept * (above | (f < plant.frequency_hz[0])))) / max(mean, 1e-300)
    low, high = rms_interval(mean, variance)
    ends = (max(low**2 + min(0.0, *apart), 0.0), high**2 + max(0.0, *apart))
    return ErrorRms(float(np.sqrt(mean)), (float(np.sqrt(ends[0])), float(np.sqrt(ends[1]))), outside)


def with_error_rms(loop: Loop, margins: Margins, disturbance: Disturbance) -> Margins:
    """Margins with the rms of the error that a disturbance makes; inf where the loop is unstable."""
    if margins.stable is ClosedLoop.UNSTABLE:
        return margins.with_readings(error_rms=Reading(float("inf")))
    found = error_rms(loop, disturbance)
    return margins.with_readings(error_rms=Reading(found.rms, found.interval))


def refuse_several_disturbed(names: Sequence[str], disturbances: object) -> None:
    """Refuse what disturbs one loop where several loops are closed anew."""
    if len(names) > 1 and disturbances:
        raise WrongUseError(
            "the error of several loops follows from what disturbs all of them, which a recording of one does not tell",
            f"loops {', '.join(names)} and a disturbance", "take one loop alone",
        )  # fmt: skip


def of_points(loops: Mapping[str, Loop], disturbances: Sequence[Disturbance]) -> dict[str, Disturbance]:
    """The disturbance of each operating point by its name: that recorded there; one alone serves all."""
    if len(disturbances) == 1:
        return dict.fromkeys(loops, disturbances[0])
    known = {tuple(sorted(one.operating_point.items())): one for one in disturbances}
    points = {name: tuple(sorted(loop.plant.operating_point.items())) for name, loop in loops.items()}
    return {name: known[point] for name, point in points.items() if point in known}


def error_warnings(
    loops: Mapping[str, Loop], disturbances: Mapping[str, Disturbance], requirements: Requirements
) -> tuple[str, ...]:
    """Sentences on a limit of the error without a disturbance, and on power that lies outside the measured band."""
    out = []
    for name, loop in loops.items():
        if name not in disturbances:
            if requirements.of(loop.plant.operating_point).error_rms is not None:
                out.append(
                    f"error_rms at {name} is not decided: what disturbs the loop there is not known; give a run"
                    " (--disturbance RUN)"
                )
            continue
        outside = error_rms(loop, disturbances[name]).outside
        if outside > OUTSIDE:
            low, high = loop.frequency_hz[0], loop.frequency_hz[-1]
            out.append(
                f"{100.0 * outside:.0f} % of the power of the error at {name} lies outside the measured band,"
                f" {low:.3g} to {high:.3g} Hz, where the plant is continued"
            )
    return tuple(out)
