"""Does the response depend on the level of the excitation? Told from FRFs of one machine at several levels, no model.

A linear machine answers alike at every level. A spring that hardens moves its resonance up with the level, one that
softens moves it down; friction and play lower the gain at small amplitude, saturation and hardening at large amplitude.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import uniform_filter1d
from scipy.special import ndtri

from loopshape.core.errors import BadSignalError, WrongUseError
from loopshape.core.units import db
from loopshape.data.response.frf import FRF
from loopshape.data.result.estimates import Remark
from loopshape.data.signal.channel import Channel
from loopshape.data.signal.experiment import LoopSetup
from loopshape.data.signal.recording import Recording
from loopshape.data.signal.run import Run
from loopshape.identify.signals import moved_signal
from loopshape.identify.smooth.resonances import Resonance, resonances
from loopshape.identify.spectra.averages import pooled_variance
from loopshape.toolbox.gap.tolerances import TOL
from loopshape.toolbox.gap.two_runs.level_dependence import Bend, Change, LevelDependence
from loopshape.toolbox.gap.two_runs.table_paths import known_lines, on_common_lines

APART = 1.25  # ratio of levels, below which two recordings are of one level
FEWEST = 8  # frequencies for a mean gain
NEAR = 0.3  # a resonance that moves further is another
_NEPER_DB = 8.685889638
LEAST_GAIN_DB, LEAST_SHIFT = 0.02, 2e-4  # what estimators may bias an FRF by


@dataclass(frozen=True, eq=False)
class AtLevel:
    """An FRF and the rms of what was injected for it, in `unit`."""

    frf: FRF
    level: float
    unit: str


def level_dependences(run: Run, frfs: Iterable[FRF]) -> tuple[LevelDependence, ...]:
    """One for each loop and operating point that a run excited at several levels, as far as the excitation is known."""
    known = {r.info.name: r for r in run.recordings}
    found = []
    for f in frfs:
        recording = known.get(f.recordings[0] if f.recordings else f.recording)
        with suppress(BadSignalError):  # no excitation was recorded: the estimator went without
            found += [at_level(run, recording, f)] if recording else []
    return dependences(found)


def remarks(run: Run, recordings: Sequence[Recording], frfs: Sequence[FRF]) -> list[Remark]:
    """Level dependences as what `loopshape frf` tells."""
    return [Remark("levels", one.sentence, data=one) for one in level_dependences(run, frfs)]


def at_level(run: Run, recording: Recording, frf: FRF) -> AtLevel:
    """A recording's FRF with the level of its excitation."""
    return AtLevel(frf, *level_of(recording, run.loop(frf.loop)))


def level_of(recording: Recording, loop: LoopSetup) -> tuple[float, str]:
    """Rms of what was injected while anything was, and the suffix of its unit."""
    injected = np.asarray(moved_signal(recording, loop))
    moving = np.flatnonzero(injected != injected[0])
    part = injected[moving[0] : moving[-1] + 1] if moving.size else injected
    opened = recording.info.injection == "control" or not recording.info.closed_loop
    column = loop.control if opened else loop.reference if recording.info.injection == "reference" else loop.injected
    return float(np.std(part)), Channel.from_column(str(column)).unit


def dependences(many: Sequence[AtLevel]) -> tuple[LevelDependence, ...]:
    """The smallest level against the largest, for each loop and operating point with levels that are apart."""
    groups: dict[object, list[AtLevel]] = {}
    for one in many:
        f = one.frf
        point = tuple(sorted(f.operating_point.items())), tuple(sorted(f.parameters.items()))
        groups.setdefault((f.loop, f.rate_hz, one.unit, point), []).append(one)
    found = []
    for group in groups.values():
        small, large = (pick(group, key=lambda one: one.level) for pick in (min, max))
        if small.level > 0.0 and large.level > APART * small.level:
            found.append(_dependence(small, large))
    return tuple(found)


def _dependence(small: AtLevel, large: AtLevel) -> LevelDependence:
    """What changed between two levels; not judged where too few frequencies are known at both."""
    both = _on_one_grid(small.frf, large.frf)
    known = known_lines(*both) if both else np.zeros(0, dtype=bool)
    common = int(np.count_nonzero(known))
    found = LevelDependence(
        loop=small.frf.loop,
        operating_point=dict(small.frf.operating_point),
        recordings=(small.frf.recording, large.frf.recording),
        levels=(small.level, large.level),
        unit=large.unit,
        frequencies=common,
        decidable=common >= FEWEST,
    )
    if both is None or not found.decidable:
        return found
    one, two = (x.select(known) for x in both)
    pair = _same_resonance(resonances(one), resonances(two))
    if pair is None:
        return replace(found, gain=_gain(one, two, None))
    return replace(found, resonance=_moved(*pair, one), peak=_peak(*pair, one), gain=_gain(one, two, pair))


def _on_one_grid(one: FRF, two: FRF) -> tuple[FRF, FRF] | None:
    """Both FRFs on the lines of the coarser one within the other's band, or on those that both have; None without any.

    Lines of noise and sweeps may be drawn between, lines of a periodic excitation may not: nothing was measured there.
    """
    spacing = [float(np.median(np.diff(x.frequency_hz))) if x.frequency_hz.size > 8 else 0.0 for x in (one, two)]
    fine = int(np.argmin(spacing)) if one.power_per == two.power_per else int(two.power_per == "Hz")
    if (one, two)[fine].power_per != "Hz" or min(spacing) == 0.0:
        with suppress(WrongUseError):
            return on_common_lines(one, two)
        return None
    if fine == 0:
        both = _interpolated(two, one)
        return None if both is None else (both[1], both[0])
    return _interpolated(one, two)


def _interpolated(coarse: FRF, fine: FRF) -> tuple[FRF, FRF] | None:
    """The coarser FRF on its lines within the finer one's band, and the finer one on these, by a cubic.

    What the cubic may miss counts in the variance: a quarter at most of what one over every second line misses.
    """
    from scipy.interpolate import CubicSpline

    f, g, G = coarse.frequency_hz, fine.frequency_hz, fine.siso
    above = np.clip(np.searchsorted(g, f), 1, g.size - 1)
    near = above - (f - g[above - 1] < g[above] - f)
    inside = (f >= g[0]) & (f <= g[-1]) & (np.diff(near, prepend=-1) > 0)
    if not inside.any():
        return None
    coarse, f, near = coarse.select(inside), f[inside], near[inside]
    halves = [np.abs(CubicSpline(g[k::2], G[k::2])(g) - G) ** 2 for k in (0, 1)]
    # squared error of a cubic over every second line, over that of the cubic itself, at the least
    missed = uniform_filter1d(np.sum(halves, axis=0), 3, mode="nearest") / 16.0
    variance = np.interp(f, g, fine.variance[:, 0, 0] + missed)
    thinned = float(np.median(np.diff(f)) / np.median(np.diff(g))) if f.size > 1 else 1.0
    moved = replace(
        fine.select(near),
        frequency_hz=f,
        response=CubicSpline(g, G)(f)[:, None, None],
        covariance=variance[:, None, None].astype(complex),
        noise_covariance=None,
        line_overlap=max(1.0, float(fine.line_overlap) / thinned),
    )
    return coarse, moved


def _same_resonance(one: Sequence[Resonance], two: Sequence[Resonance]) -> tuple[Resonance, Resonance] | None:
    """The most prominent resonance of the second, and the nearest of the first; None where there is none near."""
    for there in sorted(two, key=lambda r: -r.peak):
        near = [r for r in one if abs(r.frequency_hz / there.frequency_hz - 1.0) < NEAR]
        if near:
            return min(near, key=lambda r: abs(r.frequency_hz - there.frequency_hz)), there
    return None


def _moved(small: Resonance, large: Resonance, frf: FRF) -> Change:
    """How far the resonance moved, as a share of where it was; what its form leaves is alike at both levels."""
    std = float(np.hypot(small.frequency_std_hz, large.frequency_std_hz)) / small.frequency_hz
    change = large.frequency_hz / small.frequency_hz - 1.0
    bend = _bend(change, std, LEAST_SHIFT, (Bend.HARDENING, Bend.SOFTENING))
    return Change(
        bend, small.frequency_hz, large.frequency_hz, change, _interval(change, std), _seen(small, large, frf)
    )


def _peak(small: Resonance, large: Resonance, frf: FRF) -> Change:
    """Height of the resonance's peak, small less large, in dB."""
    heights = [float(db(r.peak)) for r in (small, large)]
    std, change = _NEPER_DB * float(np.hypot(small.peak_std, large.peak_std)), heights[0] - heights[1]
    bend = _bend(change, std, LEAST_GAIN_DB, (Bend.DROPS_WHEN_LARGE, Bend.DROPS_WHEN_SMALL))
    return Change(bend, heights[0], heights[1], change, _interval(change, std), _seen(small, large, frf))


def _seen(small: Resonance, large: Resonance, frf: FRF) -> tuple[float, float]:
    """From where to where the resonance was fitted, in Hz."""
    f = frf.frequency_hz
    return float(f[min(small.first, large.first)]), float(f[max(small.last, large.last)])


def _gain(one: FRF, two: FRF, pair: tuple[Resonance, Resonance] | None) -> Change | None:
    """Mean gain of the smaller level over the larger in dB, below the resonance where enough frequencies lie there."""
    f = one.frequency_hz
    lines = np.ones(f.size, dtype=bool)
    tail = 4.0  # half widths about a resonance that are left out of the gain
    for r in pair or ():
        lines &= f < r.frequency_hz - tail * abs(r.pole_hz.imag)
    if np.count_nonzero(lines) < FEWEST:
        return None
    one, two = one.select(lines), two.select(lines)
    variance = sum(pooled_variance(x) / np.abs(x.siso) ** 2 for x in (one, two))
    weight = 1.0 / (variance + (LEAST_GAIN_DB / _NEPER_DB) ** 2)
    ratio = np.asarray(db(np.abs(one.siso / two.siso)))
    change = float(np.sum(weight * ratio) / np.sum(weight))
    std = _NEPER_DB * float(np.sqrt(0.5 * np.sum(weight**2 * variance) * max(one.line_overlap, 1.0)) / np.sum(weight))
    bend = _bend(change, std, LEAST_GAIN_DB, (Bend.DROPS_WHEN_LARGE, Bend.DROPS_WHEN_SMALL))
    return Change(bend, change, 0.0, change, _interval(change, std), (float(f[lines][0]), float(f[lines][-1])))


def _bend(change: float, std: float, least: float, kinds: tuple[Bend, Bend]) -> Bend:
    """The kind for a rise or a fall, linear where chance or an estimator's bias explains it."""
    if abs(change) <= least + float(-ndtri(0.5 * TOL.level_by_chance)) * std:
        return Bend.LINEAR
    return kinds[0] if change > 0.0 else kinds[1]


def _interval(change: float, std: float) -> tuple[float, float]:
    """Of 95 %."""
    half = float(ndtri(0.975) * std)
    return change - half, change + half
