"""Is the controller the declared one? z recomputed from logged r, n and y by the controller's own code."""

from __future__ import annotations

import numpy as np

from loopshape.core.errors import BadSignalError
from loopshape.core.kernels import biquads
from loopshape.core.units import Array
from loopshape.data.signal.channel import sum_terms
from loopshape.data.signal.experiment import LoopSetup
from loopshape.data.signal.recording import Recording
from loopshape.data.signal.run import Run


def software_check(run: Run) -> list[str]:
    """A sentence for each loop and recording whose z is not its controller's answer; empty where all is as stated."""
    out = []
    allowed = 1e-3
    for recording in run.recordings:
        for loop in run.loops:
            try:
                off = difference(recording, loop)
            except BadSignalError:  # the reference or the like is damaged: only this check needs it
                continue
            if off is not None and off > allowed:
                out.append(
                    f"{recording.info.file}: z of loop {loop.name} is not what its controller answers to r, n and y "
                    f"(off by {100.0 * off:.2g} % rms): software or timing, not the plant"
                )
    return out


def difference(recording: Recording, loop: LoopSetup) -> float | None:
    """Rms of logged z less z recomputed, over z's rms; None where it cannot be told."""
    c = recording.columns
    needed = (loop.reference, loop.injected, loop.control, *sum_terms(loop.output))
    if loop.controller is None or not recording.info.closed_loop or any(n is None or n not in c for n in needed):
        return None
    error = recording.column(str(loop.reference)) - recording.output(loop.output)
    if recording.info.injection == "controller_input":
        error = error + recording.column(str(loop.injected))
    z = recording.column(loop.control)
    start_s = 2.0  # the controller's state at the first sample follows from so much, by least squares
    first = round(start_s * recording.rate_hz)
    if z.size < 2 * first:
        return None
    sections = loop.controller.biquads()
    answer = recomputed(sections, np.ascontiguousarray(error), z[:first])
    rest = z[first:] - answer[first:]
    grid = np.median(np.abs(np.diff(np.unique(z)))) if np.unique(z).size > 1 else 0.0
    scale = float(np.sqrt(np.mean(z[first:] ** 2))) + 1e-12
    off = float(np.sqrt(np.mean(rest**2)))
    return 0.0 if off < 8.0 * grid else off / scale  # a difference over what z's own grid explains


def recomputed(sections: Array, error: Array, z_first: Array) -> Array:
    """The controller's answer (n,), its first state fitted to the first samples of z."""
    rest = biquads.run(sections, np.zeros((len(sections), 2)), error)
    slopes = np.empty((z_first.size, 2 * len(sections)))
    silent = np.zeros(error.size)
    free = []
    for k in range(slopes.shape[1]):
        state = np.zeros((len(sections), 2))
        state[k // 2, k % 2] = 1.0
        free.append(biquads.run(sections, state, silent))
        slopes[:, k] = free[-1][: z_first.size]
    states, *_ = np.linalg.lstsq(slopes, z_first - rest[: z_first.size], rcond=None)
    return np.asarray(rest + np.tensordot(states, np.array(free), 1))
