"""The direct estimator's signals, and what the injected signal says of feedback around them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from loopshape.estimate.averages import against_instrument
from loopshape.estimate.settings import Settings
from loopshape.estimate.signals import LoopSignals, has_instrument, loop_signals
from loopshape.estimate.transforms import transform
from loopshape.experiment import LoopSetup
from loopshape.recording import Recording
from loopshape.units import db


def direct_signals(recording: Recording, loop: LoopSetup, settings: Settings) -> tuple[LoopSignals, tuple[str, ...]]:
    """Signals with the plant's input as its own instrument, and a warning where there is feedback."""
    if has_instrument(recording, loop):
        s = loop_signals(recording, loop)
        return replace(s, instrument=s.u), _feedback_note(recording, loop, s, settings) if s.feedback else ()
    opened = Recording(replace(recording.info, closed_loop=False), recording.rate_hz, recording.columns)
    return loop_signals(opened, loop), (BIASED,)


#: what can be said of every direct estimate under feedback
BIASED = "direct estimator in closed loop: biased towards -1/C where noise outweighs the excitation"


def _feedback_note(recording: Recording, loop: LoopSetup, s: LoopSignals, settings: Settings) -> tuple[str, ...]:
    """The warning, with how far the plant's input answers the injected signal otherwise than without feedback."""
    at_plant = recording.info.injection == "plant_input"
    if loop.controller is None and not at_plant:
        return (BIASED,)
    t = transform(recording, [s.u], s.instrument, settings)
    rows = np.flatnonzero(t.excited & (t.frequency_hz < 0.45 * recording.rate_hz))
    f = t.frequency_hz[rows]
    alone = np.ones(f.size) if at_plant or loop.controller is None else loop.controller.response(f)
    change = db(against_instrument(t)[rows, 0] / alone)
    worst = int(np.argmax(np.abs(change)))
    return (f"{BIASED}; feedback changes what reaches the plant by {change[worst]:+.1f} dB at {f[worst]:.3g} Hz",)
