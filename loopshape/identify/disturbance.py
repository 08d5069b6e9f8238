"""Recording of a loop without excitation -> the spectrum of its error."""

from __future__ import annotations

import numpy as np
from scipy.signal.windows import tukey

from loopshape.core.errors import BadSignalError
from loopshape.core.units import Array
from loopshape.data.signal.disturbance import Disturbance
from loopshape.data.signal.experiment import LoopSetup
from loopshape.data.signal.recording import Recording
from loopshape.data.signal.run import Run

#: share of a recording over which its ends are faded in and out, so that a steep spectrum does not leak
FADED = 0.2
SHORTEST = 512


def disturbance_of(recording: Recording, loop: LoopSetup) -> Disturbance:
    """The error's spectrum in a recording of a closed loop, about its mean; setpoints that move count as disturbances.

    Raises BadSignalError for a loop that was open, that is excited at its controller or its plant, whose controller is
    not known, and for fewer than 512 samples.
    """
    _refuse(recording, loop)
    error = np.asarray(recording.signal(loop.output), dtype=float)
    if loop.reference in recording.columns:
        error = np.asarray(recording.signal(str(loop.reference)), dtype=float) - error
    frequency_hz, power, scatter = powers(error, recording.rate_hz)
    return Disturbance(
        frequency_hz, power, scatter, loop.controller, loop.name, recording.info.name, recording.info.operating_point
    )


def powers(values: Array, rate_hz: float) -> tuple[Array, Array, Array]:
    """Frequencies in Hz of a signal's lines, the power on each, and the variance of that, for noise; (nf,) each."""
    n = values.size
    window = tukey(n, FADED, sym=False)
    spectrum = np.abs(np.fft.rfft((values - values.mean()) * window)[1:]) ** 2
    power = 2.0 * spectrum / (n * float(window @ window))
    if n % 2 == 0:
        power[-1] *= 0.5
    correlated = n * float(np.sum(window**4)) / float(window @ window) ** 2
    return np.asarray(np.fft.rfftfreq(n, 1.0 / rate_hz)[1:], dtype=float), power, 0.5 * correlated * power**2


def _refuse(recording: Recording, loop: LoopSetup) -> None:
    info = recording.info
    why = None
    if not info.closed_loop or info.injection == "control":
        why = "its loops were open"
    elif loop.name in info.excited and info.injection != "reference":
        why = f"it excites loop {loop.name}"
    elif loop.controller is None:
        why = f"the controller of loop {loop.name} is not known"
    elif recording.signal(loop.output).size < SHORTEST:
        why = f"it holds fewer than {SHORTEST} samples"
    if why is not None:
        raise BadSignalError(
            f"recording {info.file} does not show what disturbs loop {loop.name}", why,
            "record the closed loop for a while without excitation, and name its controller in run.toml",
        )  # fmt: skip


def disturbances_in(run: Run, loop: str) -> tuple[Disturbance, ...]:
    """What disturbs a loop at each operating point of a run: the longest recording there that shows it.

    Raises BadSignalError, with the reason for the first recording, where none does.
    """
    setup, longest = run.loop(loop), dict[object, tuple[int, Disturbance]]()
    refused: BadSignalError | None = None
    for recording in run.recordings:
        try:
            found = disturbance_of(recording, setup)
        except BadSignalError as error:
            refused = refused or error
            continue
        point = tuple(sorted(found.operating_point.items()))
        if found.power.size > longest.get(point, (0, found))[0]:
            longest[point] = (found.power.size, found)
    if not longest:
        raise refused or BadSignalError(f"the run has no recording of loop {loop}", "", "record one")
    return tuple(found for _, found in longest.values())
