"""The direct estimator's signals, and what the injected signal says of feedback around them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from loopshape.estimate.averages import against_instrument
from loopshape.estimate.signals import LoopSignals, has_instrument, loop_signals
from loopshape.estimate.transforms import Settings, transform
from loopshape.experiment import LoopSetup
from loopshape.recording import Recording
from loopshape.units import db


def direct_signals(recording: Recording, loop: LoopSetup) -> tuple[LoopSignals, tuple[str, ...]]:
    """Signals with the plant's input as its own instrument, and a warning where there is feedback."""
    if has_instrument(recording, loop):
        s = loop_signals(recording, loop)
        return replace(s, instrument=s.u), _feedback_note(recording, loop, s)
    opened = Recording(replace(recording.info, closed_loop=False), recording.rate_hz, recording.columns)
    note = "direct estimator in closed loop: biased towards -1/C where noise outweighs the excitation"
    return loop_signals(opened, loop), (note,)


def _feedback_note(recording: Recording, loop: LoopSetup, s: LoopSignals) -> tuple[str, ...]:
    """A warning where the plant's input answers the injected signal otherwise than without feedback."""
    if not s.feedback or loop.controller is None:
        return ()
    t = transform(recording, [s.u], s.instrument, Settings())
    rows = np.flatnonzero(t.excited & (t.frequency_hz < 0.45 * recording.rate_hz))
    f = t.frequency_hz[rows]
    alone = np.ones(f.size) if recording.info.injection == "plant_input" else loop.controller.response(f)
    change = db(against_instrument(t)[rows, 0] / alone)
    worst = int(np.argmax(np.abs(change)))
    if abs(change[worst]) < 1.0:
        return ()
    return (
        f"direct estimator with feedback: the injected signal reaches the plant changed by {change[worst]:+.1f} dB"
        f" at {f[worst]:.3g} Hz; the estimate is biased towards -1/C where noise outweighs the excitation",
    )
