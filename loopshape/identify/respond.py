"""What a recording's signals answer to its instruments, by the method that suits the record."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from loopshape.core.errors import BadSignalError, WrongUseError
from loopshape.core.stretches import LongSignal, Signal
from loopshape.core.units import Array, db
from loopshape.data.signal.recording import Recording
from loopshape.identify.answers import Answers
from loopshape.identify.local.local import by_local_fits, compared
from loopshape.identify.local.long_sweeps import by_sweep_in_parts
from loopshape.identify.settings import Settings
from loopshape.identify.spectra.periods import by_periods
from loopshape.identify.spectra.welch import by_welch


def respond(
    recording: Recording,
    signals: Sequence[Signal],
    instruments: Sequence[Signal],
    outputs: int,
    settings: Settings,
) -> Answers:
    """Answers of signals (n,), the first `outputs` of them plant outputs, to instruments (n,) of one recording.

    By whole periods where the excitation repeats; else by local fits or Welch's segments as `settings` say. One sweep
    has local fits of its own, and a long one in parts (`by_sweep_in_parts`); of several at once, and of noise with a
    resolution asked for, `auto` takes Welch's segments, and of other noise whichever of both predicts best what it has
    not seen. Of a long recording's noise `auto` takes Welch's segments, which are read a stretch at a time; of a sweep
    both ways one signal after the other is taken whole, of others all.
    """
    sweep = recording.info.kind == "sweep"
    long = any(isinstance(x, LongSignal) for x in (*signals, *instruments))
    chosen = sweep or long or settings.resolution_hz is not None or settings.recipe
    once = sweep and len(instruments) == 1 and settings.method != "welch" and not settings.recipe
    welch = settings.method == "welch" or (settings.method == "auto" and chosen and not once)
    if recording.info.period_s is None and welch:
        return by_welch(recording, signals, instruments, settings)
    if recording.info.period_s is None and once:
        return by_sweep_in_parts(recording, signals, instruments[0], outputs, settings)
    whole, moved = [np.asarray(x) for x in signals], [np.asarray(x) for x in instruments]
    if recording.info.period_s is not None:
        if settings.method != "auto" or settings.recipe:
            raise WrongUseError(
                "a method, a window and segments are for records without a period",
                f"{settings.method!r} for {recording.info.file} with period {recording.info.period_s:g} s",
                "leave it out, or take period_s out of run.toml",
            )
        return by_periods([(recording, whole, moved, 0)], settings)
    if settings.method == "local":
        return by_local_fits(recording, whole, moved, outputs, settings)[0]
    return _better(recording, whole, moved, outputs, settings)


def _better(
    recording: Recording, signals: Sequence[Array], instruments: Sequence[Array], outputs: int, settings: Settings
) -> Answers:
    """Local fits or Welch's segments, whichever predicts better; the one that can be made, where one cannot."""
    try:
        local, choice, lines = by_local_fits(recording, signals, instruments, outputs, settings)
    except BadSignalError:
        return by_welch(recording, signals, instruments, settings)
    try:
        welch = by_welch(recording, signals, instruments, settings)
    except BadSignalError:
        return local
    behind_db = float(db(np.exp(0.5 * compared(choice, lines, welch))))
    if behind_db < 0.0:
        return replace(welch, method=f"{welch.method} (local fits predict {-behind_db:.2g} dB worse)")
    return replace(local, method=f"{local.method} (Welch's segments predict {behind_db:.2g} dB worse)")
