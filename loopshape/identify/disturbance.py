"""Recording of a loop without excitation -> the spectrum of its error."""

from __future__ import annotations

import numpy as np

from loopshape.core.errors import BadSignalError
from loopshape.data.signal.disturbance import LEAST_SAMPLES, Disturbance
from loopshape.data.signal.experiment import LoopSetup
from loopshape.data.signal.recording import Recording
from loopshape.data.signal.run import Run


def disturbance_of(recording: Recording, loop: LoopSetup) -> Disturbance:
    """The error's spectrum in a recording of a closed loop, about its mean; setpoints that move count as disturbances.

    Raises BadSignalError for a loop that was open, that is excited at its controller or its plant, whose controller is
    not known, and for fewer than 512 samples.
    """
    _refuse(recording, loop)
    error = np.asarray(recording.signal(loop.output), dtype=float)
    if loop.reference in recording.columns:
        error = np.asarray(recording.signal(str(loop.reference)), dtype=float) - error
    return Disturbance.from_arrays(
        error, recording.rate_hz, recorded_under=loop.controller, control=recording.signal(loop.control),
        loop=loop.name, recording=recording.info.name, operating_point=recording.info.operating_point,
    )  # fmt: skip


def _refuse(recording: Recording, loop: LoopSetup) -> None:
    info = recording.info
    why = None
    if not info.closed_loop or info.injection == "control":
        why = "its loops were open"
    elif loop.name in info.excited and info.injection != "reference":
        why = f"it excites loop {loop.name}"
    elif loop.controller is None:
        why = f"the controller of loop {loop.name} is not known"
    elif recording.signal(loop.output).size < LEAST_SAMPLES:
        why = f"it holds fewer than {LEAST_SAMPLES} samples"
    if why is not None:
        raise BadSignalError(
            f"recording {info.file} does not show what disturbs loop {loop.name}", why,
            "record the closed loop for a while without excitation, and name its controller in run.toml",
        )  # fmt: skip


def disturbances_in(run: Run, *loops: str) -> tuple[Disturbance, ...]:
    """What disturbs loops at each operating point of a run: the longest recording there that shows it of all of them.

    Raises BadSignalError, with the reason for the first recording, where none does.
    """
    setups, longest = [run.loop(loop) for loop in loops], dict[object, list[Disturbance]]()
    refused: BadSignalError | None = None
    for recording in run.recordings:
        try:
            found = [disturbance_of(recording, setup) for setup in setups]
        except BadSignalError as error:
            refused = refused or error
            continue
        point = tuple(sorted(recording.info.operating_point.items()))
        if point not in longest or found[0].power.size > longest[point][0].power.size:
            longest[point] = found
    if not longest:
        raise refused or BadSignalError(f"the run has no recording of loop {', '.join(loops)}", "", "record one")
    return tuple(one for found in longest.values() for one in found)
