"""Effect sheets: one study done with and without each effect, through the project's own estimators."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace

import numpy as np

from loopshape.core.units import Array, db
from loopshape.data.response.frf import FRF
from loopshape.data.signal.experiment import LoopSetup
from loopshape.data.signal.recording import Recording
from loopshape.identify.frequency_response import estimate_frf
from loopshape.toolbox.gap.nouns.effect import EffectForm
from loopshape.toolbox.gap.nouns.effect_sheet import EffectSheet, FrfChange, TimeChange
from loopshape.toolbox.rig.distortion import distortion
from loopshape.toolbox.rig.effects import forms_of
from loopshape.toolbox.rig.simulated import Rig, measure
from loopshape.toolbox.rig.study import Study

Signals = Callable[[Recording], Mapping[str, Array]]
Paths = Mapping[str, tuple[str, str]]
#: lines whose relative standard deviation is above this in either recording are left out
KNOWN = 0.2
#: distortion is looked at below this frequency
LOW_HZ = 1.5


def sheets(
    plant: Rig,
    study: Study,
    asked: Mapping[str, float],
    signals: Signals,
    paths: Callable[[Recording], Paths],
    *,
    threads: int | None = None,
) -> Iterator[EffectSheet]:
    """One sheet for each effect NAME or NAME:FORM at a magnitude, in order.

    The study is done without effects and with each; same seeds, so noise of the sensors is the same in both.
    `signals` gives the named signals of a recording, `paths` their pairs between which FRFs are wanted.
    """
    nominal = _seen(plant, study, signals, paths, threads)
    for key, magnitude in asked.items():
        name, _, number = key.partition(":")
        form = forms_of(plant, name)[int(number or 1) - 1]
        changed = _seen(plant, replace(study, effects={key: magnitude}), signals, paths, threads)
        yield _sheet(form, magnitude, nominal, changed)


class _Seen:
    """What is looked at in one recording."""

    def __init__(self, recording: Recording, signals: Mapping[str, Array], paths: Paths) -> None:
        self.recording, self.signals = recording, signals
        info, excites = recording.info, recording.info.excites is not None and recording.info.ended_early is None
        self.ended = info.ended_early
        self.frfs = {name: _frf(recording, signals, ends) for name, ends in paths.items()} if excites else {}
        self.distortion = (
            {name: _distortion(recording, signals, ends) for name, ends in paths.items()} if excites else {}
        )


def _seen(
    plant: Rig, study: Study, signals: Signals, paths: Callable[[Recording], Paths], threads: int | None
) -> dict[str, _Seen]:
    return {r.info.name: _Seen(r, signals(r), paths(r)) for r in measure(study, plant, threads=threads)}


def _along(recording: Recording, signals: Mapping[str, Array], ends: tuple[str, str]) -> tuple[Recording, LoopSetup]:
    """A recording with the path's ends as a loop's control and output; what was injected stays the instrument."""
    injected = next(v for k in recording.columns if k.startswith("n_") and np.any(v := recording.column(k)))
    columns = {"moved_1": injected, "start_1": signals[ends[0]], "end_1": signals[ends[1]]}
    info = replace(recording.info, injection="controller_input", closed_loop=True)
    return Recording(info, recording.rate_hz, columns), LoopSetup("path", None, "moved_1", "start_1", "end_1", None)


def _frf(recording: Recording, signals: Mapping[str, Array], ends: tuple[str, str]) -> FRF:
    return estimate_frf(*_along(recording, signals, ends))


def _distortion(
    recording: Recording, signals: Mapping[str, Array], ends: tuple[str, str]
) -> tuple[float | None, float | None]:
    """Odd and even distortion at low frequency in dB re the linear response there; None where there are no lines."""
    d = distortion(*_along(recording, signals, ends))
    linear = None if d.excited is None else d.excited.between(0.0, LOW_HZ).rms
    found = (None if lines is None else lines.between(0.0, LOW_HZ).rms for lines in (d.odd, d.even))
    odd, even = (float(db(x / linear)) if x and linear else None for x in found)
    return odd, even


def _sheet(
    form: EffectForm, magnitude: float, nominal: Mapping[str, _Seen], changed: Mapping[str, _Seen]
) -> EffectSheet:
    frfs: dict[tuple[str, str], FrfChange] = {}
    times: dict[tuple[str, str], TimeChange] = {}
    levels: dict[tuple[str, str, str], tuple[float, float]] = {}
    for name, one in nominal.items():
        two = changed[name]
        times |= {(name, s): _time_change(one, two, s) for s in one.signals}
        for path in one.frfs.keys() & two.frfs.keys():
            frfs[name, path] = frf_change(one.frfs[path], two.frfs[path])
            pairs = zip(("odd", "even"), one.distortion[path], two.distortion[path], strict=True)
            levels |= {(name, path, k): (a, b) for k, a, b in pairs if a is not None and b is not None}
    ended = tuple(f"{name}: {x.ended}" for name, x in changed.items() if x.ended)
    return EffectSheet(form, magnitude, frfs, times, levels, ended)


def frf_change(without: FRF, changed: FRF) -> FrfChange:
    """Two FRFs (1 x 1) on the lines that both know well."""
    shared = np.intersect1d(without.frequency_hz, changed.frequency_hz)
    one, two = (x.select(np.isin(x.frequency_hz, shared)) for x in (without, changed))
    noise = [x.relative_std[:, 0, 0] for x in (one, two)]
    known = (noise[0] < KNOWN) & (noise[1] < KNOWN)
    return FrfChange(one.frequency_hz[known], one.siso[known], two.siso[known], np.hypot(*noise)[known])


def _time_change(one: _Seen, two: _Seen, signal: str) -> TimeChange:
    block_s = 0.02  # values of a time response are means over this many seconds, so that pulses do not show
    rows = max(1, round(block_s * one.recording.rate_hz))
    a, b = (_blocks(x.signals[signal], rows) for x in (one, two))
    n = min(a.size, b.size)
    return TimeChange(np.asarray((np.arange(n) + 0.5) * rows / one.recording.rate_hz), a[:n], b[:n])


def _blocks(values: Array, rows: int) -> Array:
    n = values.size // rows * rows
    return np.asarray(values[:n].reshape(-1, rows).mean(axis=1))
