"""How a run's rig was driven, so that more of the same kind can be proposed; and signals of such experiments."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import lru_cache

import numpy as np

from loopshape.core.units import Array
from loopshape.data.signal.recording import Recording
from loopshape.data.signal.run import Run
from loopshape.toolbox.rig.excitation.excitation import samples
from loopshape.toolbox.rig.excitation.multisine import Multisine
from loopshape.toolbox.rig.study import ExperimentTemplate


@dataclass(frozen=True, eq=False)
class Habits:
    """By loop: amplitude, place and band of what was injected; by how much references moved; pulses of z (V, s)."""

    injected: Mapping[str, tuple[float, str, tuple[float, float]]] = field(default_factory=dict)
    moved: Mapping[str, float] = field(default_factory=dict)
    driven: Mapping[str, tuple[float, float]] = field(default_factory=dict)


def habits(run: Run) -> Habits:
    """How the run's recordings were made: medians over the recordings of each kind."""
    injected = {loop.name: found for loop in run.loops if (found := _injected(run, loop.name, loop.injected))}
    moved = {loop.name: size for loop in run.loops if (size := _moved(run, loop.reference)) > 0.0}
    if not moved and injected:
        first = next(iter(injected))
        stair_of_amplitude = 0.5  # a reference that the run never moved is moved by so much of the injected amplitude
        moved = {first: stair_of_amplitude * injected[first][0]}
    driven = {loop.name: pulse for loop in run.loops if (pulse := _driven(run, loop.control))}
    return Habits(injected, moved, driven)


def _injected(run: Run, loop: str, column: str | None) -> tuple[float, str, tuple[float, float]] | None:
    """Median peak of the injected signal, where it enters, and its band in Hz; None where nothing was injected."""
    mine = [r for r in run.recordings if column in r.columns and loop in r.info.excited]
    mine = [r for r in mine if r.info.injection in ("controller_input", "plant_input")]
    mine = [r for r in mine if r.info.injection == mine[0].info.injection]
    peaks = [float(np.abs(r.column(str(column))).max()) for r in mine]
    if not peaks or max(peaks) == 0.0:
        return None
    strongest = mine[int(np.argmax(peaks))]
    return float(np.median(peaks)), mine[0].info.injection, band_hz(strongest, str(column))


def band_hz(recording: Recording, column: str) -> tuple[float, float]:
    """The band that holds nearly all of a signal's power."""
    values = recording.column(column)
    power = np.abs(np.fft.rfft(values - values.mean())) ** 2
    share = np.cumsum(power) / power.sum()
    inner = (0.01, 0.99)  # shares of an injected signal's power below its band's ends
    low, high = (np.searchsorted(share, s) * recording.rate_hz / values.size for s in inner)
    return float(np.round(max(low, 0.1), 1)), float(np.round(min(max(high, low + 1.0), 0.4 * recording.rate_hz), 1))


def _moved(run: Run, reference: str | None) -> float:
    """Median of half the travel of a reference where it moved; 0 where it never did."""
    spans = [float(np.ptp(r.column(reference))) for r in run.recordings if reference and reference in r.columns]
    moving = [s for s in spans if s > 1e-9]
    return 0.5 * float(np.median(moving)) if moving else 0.0


def _driven(run: Run, control: str) -> tuple[float, float] | None:
    """Height and width in s of the first pulse of z in the open-loop recordings; None without one."""
    pulse_s = (0.05, 1.0)
    for r in (r for r in run.recordings if not r.info.closed_loop and control in r.columns):
        z = r.column(control)
        on = np.abs(z) > 0.5 * np.abs(z).max()
        if on.any() and not on.all():
            start = int(np.argmax(on))
            width = int(np.argmin(on[start:])) or on.size - start
            return float(np.abs(z).max()), float(np.clip(width / r.rate_hz, *pulse_s))
    return None


def sampled(run: Run, template: ExperimentTemplate, rest: Array) -> tuple[Array, Array]:
    """References and injected signals (n, loops) of a template around setpoints (loops,); one period of a multisine."""
    places = [loop.name for loop in run.loops]
    signal = np.zeros(0)
    if isinstance(template.excitation, Multisine):
        unit = replace(template.excitation, amplitude=1.0, periods=1)
        signal = template.excitation.amplitude * _multisine(unit, run.rate_hz)
    lead = round(template.lead_s * run.rate_hz)
    n = lead + signal.size if template.duration_s is None else samples(template.duration_s, run.rate_hz)
    references, injected = np.tile(rest, (n, 1)), np.zeros((n, len(places)))
    for loop, stairs in template.references.items():
        k = places.index(loop)
        references[:, k] = stairs.sampled(n, run.rate_hz, float(rest[k]))
    for loop, stairs in template.control.items():
        injected[:, places.index(loop)] = stairs.sampled(n, run.rate_hz, 0.0)
    if template.excites is not None:
        injected[lead:, places.index(template.excites)] = signal
    return references, injected


@lru_cache(maxsize=16)
def _multisine(signal: Multisine, rate_hz: float) -> Array:
    return signal.signal(rate_hz)
