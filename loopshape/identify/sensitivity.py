"""Recording -> sensitivity S of a closed loop, directly from what the loop answers to the injected signal."""

from __future__ import annotations

import numpy as np

from loopshape.core.errors import BadSignalError
from loopshape.data.response.frf import FRF
from loopshape.data.response.frf_arrays import trusted_lines
from loopshape.data.signal.experiment import LoopSetup
from loopshape.data.signal.recording import Recording
from loopshape.identify.answers import ordinary_coherence
from loopshape.identify.respond import respond
from loopshape.identify.settings import Settings
from loopshape.identify.signals import loop_signals, wiring_notes


def estimate_sensitivity(recording: Recording, loop: LoopSetup, settings: Settings | None = None) -> FRF:
    """S (1 x 1) of the loop that a recording excites: 1 - y/n with n in front of the controller or as the reference,
    u/n with n at the plant's input, where u is what enters the plant.

    It is what 1/(1 + C P) makes of the P of the same recording, if z is the controller's answer to the error, and it
    stays well known where that P is not: where C lets little through, z is small and noise hides P but not S. Its
    error is that of one linear average (-S times the disturbance over n), without a quotient's bias. The channels are
    the loop's output; the valid band is where S is known to 10 %, as for a plant. Other loops stay closed.

    Raises BadSignalError for a recording in open loop, and as `estimate_frf` does.
    """
    info = recording.info
    if not info.closed_loop or info.injection == "control" or not info.alone:
        raise BadSignalError(
            f"recording {info.file} has no sensitivity of loop {loop.name}",
            "its loop was open" if info.excites == loop.name else f"it excites {', '.join(info.excited) or 'no loop'}",
            "give a recording that excites this loop alone, closed",
        )
    s = loop_signals(recording, loop)
    every = respond(recording, [s.y, s.u], [s.instrument], 1, settings or Settings())
    at_input = info.injection == "plant_input"
    k = 1 if at_input else 0
    sound = every.excited & np.isfinite(every.response[:, :, 0]).all(axis=1)
    sound &= np.isfinite(every.covariance).all(axis=(1, 2))
    if not sound.any():
        raise BadSignalError(f"no frequency of recording {info.file} is excited", every.method, "excite more")
    a, f = every.select(sound), every.frequency_hz[sound]
    S = a.response[:, k, 0] if at_input else 1.0 - a.response[:, 0, 0]
    variance = a.covariance[:, k, k].real
    z = a.response[:, 1, 0] - (1.0 if at_input else 0.0)
    column = s.output_channel.column
    return FRF(
        frequency_hz=f,
        response=S[:, None, None],
        covariance=np.asarray(variance[:, None, None], dtype=complex),
        trusted=trusted_lines(f, np.sqrt(variance) / np.abs(S), a.excited),
        inputs=(column,),
        outputs=(column,),
        method=f"sensitivity from the injected signal, {a.method}",
        method_numbers=a.method_numbers,
        recording=info.name,
        recordings=(info.name,),
        loop=loop.name,
        rate_hz=recording.rate_hz,
        operating_point=dict(info.operating_point),
        coherence=np.clip(ordinary_coherence(a.power, 0, 2), 0.0, 1.0),
        power_per=a.power_per,
        line_overlap=a.line_overlap,
        variance_freedom=a.freedom,
        variance_pooled=a.pooled,
        averages=a.averages,
        parameters=dict(info.parameters),
        held_by=loop.controller,
        notes=tuple(
            dict.fromkeys(
                (
                    *a.notes,
                    *wiring_notes(recording, loop, f, z, a.response[:, 0, 0], np.sqrt(a.covariance[:, 1, 1].real)),
                )
            )
        ),
    )
