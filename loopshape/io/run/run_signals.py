"""A look at a run's signals before anything is estimated: do they move, are they numbers, are they clipped?"""

from __future__ import annotations

import numpy as np

from loopshape.core.errors import BadSignalError
from loopshape.core.stretches import Signal, constant, stretches
from loopshape.data.signal.channel import sum_terms
from loopshape.data.signal.experiment import LoopSetup
from loopshape.data.signal.recording import Recording, RecordingInfo
from loopshape.data.signal.run import Run
from loopshape.identify.quality.faults import by_stretches, saturated, spikes


def check_recordings(run: Run) -> list[str]:
    """Look at every recording; returns a sentence for each signal that seems saturated or holds spikes.

    Raises `BadSignalError` for values that are not numbers, stamps off the rate, and a signal of an excited
    loop, or one of the run's `outputs`, that does not move while a loop is excited. Saturated means that an excited
    loop's z or y, or one of the outputs, takes over 200 values and is cut off at its largest or smallest one, as
    `estimate.faults.saturated` says: coarse converters and a staircase pass, a clipped signal does not.
    """
    return [warning for recording in run.recordings for warning in _check_recording(run, recording)]


def _check_recording(run: Run, recording: Recording) -> list[str]:
    watched = {} if recording.info.excites is None else _watched(run, recording.info)
    for name in recording.columns:
        signal = recording.signal(name)
        if not signal.size:
            raise BadSignalError(f"recording {recording.info.file} has no rows", "an empty table", "leave it out")
        if name not in watched or name == watched[name].injected:  # the others are read below
            for _ in stretches(signal):  # a long recording's values are looked at as they are read
                pass
    info = recording.info
    if info.excites is None:
        return []
    found = []
    for name, loop in watched.items():
        if not all(term in recording.columns for term in sum_terms(name)):
            continue
        values = recording.signal(name)
        if constant(values):
            raise BadSignalError(
                f"{name} of recording {info.file} does not move although loop {loop.name} is excited",
                f"{float(values[:1][0]):g} in all {values.size} rows",
                "check the sensor and the column, or leave the recording out"
                + ("; in open loop the control is what enters the plant" if name == loop.control else ""),
            )
        if name != loop.injected:
            found += _spoiled(name, values, info, recording.rate_hz)
    return [sentence for sentence in [*found, _pulses_saturated(run, recording)] if sentence]


def _watched(run: Run, info: RecordingInfo) -> dict[str, LoopSetup]:
    """The signals that must move, each with an excited loop: n, z and y of all of these, then the run's outputs."""
    excited = [run.loop(name) for name in info.excited]
    with_noise = info.injection in ("controller_input", "plant_input")
    watched = {
        name: loop
        for loop in excited
        for name in (loop.injected if with_noise else None, loop.control, loop.output)
        if name
    }
    return watched | {name: excited[0] for name in run.outputs if name not in watched}


def _pulses_saturated(run: Run, recording: Recording) -> str:
    """A sentence where flow commands `u_..._v` lie beyond what the PWM can give for over 1 % of the time."""
    commands = [name for name in recording.columns if name.startswith("u_") and name.endswith("_v")]
    if not run.pwm or not commands:
        return ""
    share = max(_share_beyond(recording.signal(name), 1.0) for name in commands)
    if share < 0.01:
        return ""
    return (
        f"the PWM of recording {recording.info.file} is saturated for {100.0 * share:.0f} % of the time (|u| > 1):"
        " the FRF is that of a clipped input; excite less"
    )


def _share_beyond(signal: Signal, limit: float) -> float:
    return sum(int(np.sum(np.abs(part) > limit)) for (part,) in stretches(signal)) / signal.size


def _spoiled(name: str, values: Signal, info: RecordingInfo, rate_hz: float) -> list[str]:
    """Sentences on clipped samples and spikes, which they name."""
    whole = f"{name} of recording {info.file}"
    return [fault.sentence for fault in by_stretches((saturated, spikes), values, rate_hz, whole)]
