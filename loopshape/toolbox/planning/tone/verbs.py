"""What a recording holds by itself: rms of each channel, and tones that the excitation does not explain."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from loopshape.core.errors import BadSignalError, WrongUseError
from loopshape.core.stretches import LongSignal, Signal
from loopshape.data.arrays import rate, real_array
from loopshape.data.response.frf import FRF
from loopshape.data.result.estimates import Remark
from loopshape.data.signal.channel import Channel, sum_terms
from loopshape.data.signal.excitation_kind import is_sweep, rows_of_a_period
from loopshape.data.signal.recording import Recording
from loopshape.data.signal.run import Run
from loopshape.identify.signals import has_instrument, moved_signal
from loopshape.identify.spectra.transforms import measured_period
from loopshape.toolbox.planning.tone.nouns import Tones
from loopshape.toolbox.planning.tone.tones import CHANCE, SHORTEST, Excitation, Period, tones_of, without_periods
from loopshape.verbs.files import read


def tones(
    signals: Run | str | Path | Mapping[str, ArrayLike] | ArrayLike,
    rate_hz: float | None = None,
    *,
    channels: Sequence[str] = (),
    chance: float = CHANCE,
) -> tuple[Tones, ...]:
    """Rms of each channel with 95 % interval, and its tones: frequency, amplitude, growth, with intervals.

    `signals` is a run, its folder, one signal (n,) or signals (n,) by name; arrays need `rate_hz`. Of a run every
    recording's loops are looked at: the error, where the setpoint was recorded, the output and the control; `channels`
    names columns instead. `chance` is that of any tone being reported in a channel of noise alone. What a periodic
    excitation causes, and what injected signals and setpoints hold themselves, is not reported. A resonance narrower
    than four lines (4/duration in half width) is not told from a tone. Raises BadSignalError below 512 samples.

    Examples
    --------
    >>> import numpy as np, loopshape as ls
    >>> t = np.arange(10_000) / 1000.0
    >>> y = np.random.default_rng(1).standard_normal(t.size) + np.exp(0.2 * t) * np.sin(2 * np.pi * 58.8 * t)
    >>> (found,) = ls.planning.tones(y, rate_hz=1000.0)
    >>> [(round(tone.frequency_hz, 1), tone.growth.value) for tone in found.tones]
    [(58.8, 'grows')]
    """
    if not 0.0 < chance < 1.0:
        raise WrongUseError("the chance of a false alarm lies between 0 and 1", f"{chance:g}", "ask for 0.01")
    if isinstance(signals, Run | str | Path):
        run = signals if isinstance(signals, Run) else read(signals)
        return tuple(one for recording in run.recordings for one in tones_in(run, recording, channels, chance))
    rate_hz = rate(rate_hz, "rate_hz of the signals")
    named = signals if isinstance(signals, Mapping) else {"signal": signals}
    return tuple(
        tones_of(_checked(name, values), rate_hz, chance=chance, channel=name) for name, values in named.items()
    )


def tones_in(run: Run, recording: Recording, channels: Sequence[str] = (), chance: float = CHANCE) -> list[Tones]:
    """Those of one recording: errors, outputs and controls of its loops, or the columns that are named."""
    known = [recording.signal(c) for c in dict.fromkeys(_moved(run, recording)) if c in recording.columns]
    signals = {c: (recording.signal(c), c) for c in channels} or _channels(run, recording)
    period = _period(run, recording)
    swept = recording.info.kind == "sweep" or (period is None and any(is_sweep(x) for x in known))
    excitation = Excitation(known, period, swept)
    return [
        tones_of(
            signal, recording.rate_hz, excitation=excitation, chance=chance, recording=recording.info.name,
            closed_loop=recording.info.closed_loop, **_named(name, column),
        )
        for name, (signal, column) in signals.items()
    ]  # fmt: skip


def growing(run: Run, recordings: Sequence[Recording], frfs: Sequence[FRF]) -> Iterator[Remark]:
    """Warnings of tones in the excited loops' outputs that grow and that the excitation does not explain.

    Recordings that are not held whole are left to `loopshape tones`: the look would take longer than their estimate.
    """
    for recording in recordings:
        columns = dict.fromkeys(c for name in recording.info.excited for c in sum_terms(run.loop(name).output))
        with suppress(BadSignalError):  # a column that the FRF does without may hold what is no number
            stored = recording.stored(next(iter(columns)))
            if stored.size >= SHORTEST and not isinstance(stored, LongSignal):
                for found in tones_in(run, recording, list(columns)):
                    yield from (Remark("growth", words, warning=True) for words in found.warnings)


def signal_of(run: Run, recording: Recording, found: Tones) -> np.ndarray:
    """The signal (n,) of which `found` tells, without its periodic part."""
    for name, (signal, column) in _channels(run, recording).items():
        if _named(name, column)["channel"] == found.channel:
            return without_periods(np.asarray(signal), _period(run, recording))
    column = next(c for c in recording.columns if _named(c, c)["channel"] == found.channel)
    return without_periods(recording.column(column), _period(run, recording))


def _named(name: str, column: str) -> dict[str, str]:
    channel = Channel.from_column(column)
    return {"channel": channel.name if name == column else name, "unit": channel.unit}


def _moved(run: Run, recording: Recording) -> list[str]:
    """Columns that only we moved: what is injected, setpoints, and in open loop the control."""
    opened = recording.info.injection == "control" or not recording.info.closed_loop
    controls = [loop.control for loop in run.loops if opened]
    return [*(c for loop in run.loops for c in (loop.injected, loop.reference) if c is not None), *controls]


def _channels(run: Run, recording: Recording) -> dict[str, tuple[Signal, str]]:
    """Signals by name with a column that has their unit: errors of loops, then the columns themselves."""
    found: dict[str, tuple[Signal, str]] = {}
    for loop in run.loops:
        if loop.reference in recording.columns and recording.info.closed_loop:
            first = sum_terms(loop.output)[0]
            reference, output = recording.signal(str(loop.reference)), recording.signal(loop.output)
            found[f"error of {loop.name}"] = (_difference(reference, output), first)
    for loop in run.loops:
        for column in (*sum_terms(loop.output), loop.control):
            if column in recording.columns:
                found[column] = (recording.signal(column), column)
    return found


def _difference(reference: Signal, output: Signal) -> Signal:
    if isinstance(reference, LongSignal) or isinstance(output, LongSignal):
        return LongSignal(reference.size, lambda start, stop: np.asarray(reference[start:stop] - output[start:stop]))
    return np.asarray(reference - output)


def _period(run: Run, recording: Recording) -> Period | None:
    """The period as the excitation shows it: near the stated one, or found where none was stated."""
    info = recording.info
    if info.excites is None or not has_instrument(recording, run.loop(info.excites)):
        return None if info.period_s is None else Period(*_stated(recording))
    moved = moved_signal(recording, run.loop(info.excites))
    if info.period_s is not None:
        samples, first = _stated(recording)
        return Period(measured_period(moved[first:], samples), first)
    if isinstance(moved, LongSignal):
        return None
    samples, first = rows_of_a_period(moved)
    return Period(samples, first) if samples else None


def _stated(recording: Recording) -> tuple[int, int]:
    info, rate = recording.info, recording.rate_hz
    return round((info.period_s or 0.0) * rate), round((info.periodic_from_s or 0.0) * rate)


def _checked(name: str, values: ArrayLike) -> np.ndarray:
    return real_array(values, f"signal {name}", ndim=1)
