"""What both arms do around their kernels: requests checked, experiments handed over in parallel, endings told."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor

from loopshape.core.errors import WrongUseError
from loopshape.core.units import Array
from loopshape.data.experiment import Experiment, LoopSetup
from loopshape.data.recording import Recording, RecordingInfo
from loopshape.model.arm import closed_loop as kernel

INJECTIONS = {
    "controller_input": kernel.CONTROLLER_INPUT,
    "plant_input": kernel.PLANT_INPUT,
    "reference": kernel.CONTROLLER_INPUT,
    "control": kernel.CONTROL,
}
ENDED = {
    kernel.LEFT_ANGLE: "the angle left the model's range",
    kernel.LEFT_PRESSURE: "a muscle's pressure left the model's range",
    kernel.NOT_FINITE: "the state is no longer a number",
    kernel.LEFT_THETA1: "theta1 left the model's range",
    kernel.LEFT_THETA2: "theta2 left the model's range",
}


def check_request(solver: str, known: Sequence[str], steps_per_tick: int) -> None:
    """Refuse an unknown solver, and less than one step a tick."""
    if solver not in known:
        raise WrongUseError("a solver is not known", f"{solver!r}", f"use {' or '.join(known)}")
    if steps_per_tick < 1:
        raise WrongUseError("a tick is integrated in one step or more", f"{steps_per_tick!r}")


def each(
    experiments: Sequence[Experiment], one: Callable[[Experiment], Recording], threads: int | None
) -> list[Recording]:
    """One recording an experiment, in order, on `threads` (default: all cores)."""
    workers = min(len(experiments), threads or os.cpu_count() or 1)
    if workers <= 1:
        return [one(e) for e in experiments]
    with ThreadPoolExecutor(workers) as pool:
        return list(pool.map(one, experiments))


def period_ticks(rate_hz: float, pwm_hz: float) -> int:
    """Controller samples in a PWM period; refuses a period that is no whole number of them."""
    ticks = rate_hz / pwm_hz
    if abs(ticks - round(ticks)) > 1e-9 or ticks < 1:
        raise WrongUseError(
            "a PWM period must be a whole number of controller samples", f"{pwm_hz:g} Hz at {rate_hz:g} Hz"
        )
    return round(ticks)


def sections(loop: LoopSetup, e: Experiment) -> Array:
    """Biquads (n, 5) of a loop's controller; refuses one at another rate than the experiment's."""
    if loop.controller is None or loop.controller.rate_hz != e.rate_hz:
        raise WrongUseError(f"loop {loop.name} needs a controller at the rig's rate {e.rate_hz:g} Hz")
    return loop.controller.biquads()


def info(e: Experiment, ended: int, n: int) -> RecordingInfo:
    """What a recording of n samples says of itself, and why it ended early if it did."""
    early = None if ended == kernel.COMPLETE else f"{ENDED[ended]} at {n / e.rate_hz:.3f} s"
    return RecordingInfo.of(e, early)
