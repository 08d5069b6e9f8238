"""Loop, margins and requirements -> detuning margin: how far resonances may move before something breaks.

Shifts are searched outward from zero, and where something breaks by bisection: what lies between 0 and the margin
holds at every shift that was looked at, not at its ends alone. Readings at a shift are bias-corrected, as
those of the nominal loop are.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np

from loopshape.core.kernels.loops import margins as kernel
from loopshape.core.outcomes import ClosedLoop
from loopshape.core.units import Array
from loopshape.data.requirement.requirements import LIMITS, Requirements
from loopshape.data.result.detuning import (
    SEARCHED_PERCENT,
    STABILITY,
    WARNED_PERCENT,
    Detuning,
    Lost,
    MovedResonance,
    Reach,
)
from loopshape.data.result.margins import Margins, Reading
from loopshape.identify.smooth.resonances import Resonance
from loopshape.loop.loop import Loop
from loopshape.loop.margin.margins import COLUMN_OF, Reader
from loopshape.loop.shifted import Plant, ShiftedColumns, plant_of, read, scatter_of, seen_resonances
from loopshape.loop.tolerances import TOL

#: steps between shifts, in per cent: up to what is required, and farther out
COARSE, FINE, FINEST = 0.5, 0.25, 0.05
OUTER = (3.0, 4.0, 5.0, 6.5, 8.0, 10.0, 12.0, 14.0, 17.0, SEARCHED_PERCENT)
FEWER = (3.5, 6.0, 10.0, SEARCHED_PERCENT)
#: steps at most from where something breaks to where it begins, and the step that is close enough, in per cent
STEPS, FINEST_STEP = 6, 0.02
#: what is missed by less is met
ROUNDING = 1e-9
#: a resonance belongs to what breaks at a frequency so near, relatively, or within so many half widths
BESIDE, WIDTHS = 0.1, 3.0


def detuning(loop: Loop, margins: Margins, requirements: Requirements) -> Detuning | None:
    """Detuning margin of a loop whose margins are known; None where its stability is not decided.

    Of the whole frequency axis; of single resonances too where `detuning_percent` is required. With that requirement
    shifts are looked at closer, and intervals come from draws of the FRF's error; else the intervals of the unmoved
    loop are carried along: too short where a moved resonance is known worse than what sets the margin now. Where
    nothing else is required it is the shift that makes the loop unstable.
    """
    if margins.stable is ClosedLoop.UNDECIDED or loop.frequency_hz.size < 2:
        return None
    seen, required = seen_resonances(loop), requirements.detuning_percent
    plant = plant_of(loop, seen)
    shifts = _shifts(required, seen, loop)
    dense = plant.dense()
    unmoved = read(loop, plant, Reader.of(requirements))
    if unmoved.poles is None:  # the first line alone does not tell how L starts: a shift cannot be counted
        return None
    whole = _Search(loop, margins, requirements, unmoved, dense.stretched, shifts)
    found = Detuning(*whole.both(), drawn=whole.drawn)
    if required is None:
        lost = whole.lost()
        return found if lost is None else replace(found, lost=_explained(whole, lost, plant, seen))
    alone = [_Search(loop, margins, requirements, unmoved, partial(plant.with_moved, one), shifts) for one in seen]
    moved = [MovedResonance(x.frequency_hz, x.damping, *search.both()) for x, search in zip(seen, alone, strict=True)]
    return replace(found, resonances=tuple(moved))


def with_detuning(loop: Loop, margins: Margins, requirements: Requirements) -> Margins:
    """The margins with their detuning margin and its interval, nan and none where stability is not decided."""
    found = detuning(loop, margins, requirements)
    if found is None:
        return margins
    reading = Reading(found.worst.percent, found.interval_percent if margins.intervals else None)
    return replace(margins.with_readings(detuning_percent=reading), detuning=found)


def worst_shift(
    loop: Loop, margins: Margins, requirements: Requirements, within: float
) -> tuple[float, dict[str, float]]:
    """The shift in per cent, up to `within` either way, where the bad end of the least slack is least.

    And what to ask for instead of each limit that is missed there, to hold it by half of the miss.
    """
    seen = seen_resonances(loop)
    plant = plant_of(loop, seen)
    unmoved = read(loop, plant, Reader.of(requirements))
    shifts = _shifts(within, seen, loop)
    whole = _Search(loop, margins, requirements, unmoved, plant.dense().stretched, shifts)
    every = [way * x for x in shifts[shifts <= within].tolist() for way in (1.0, -1.0)]
    worst = min(every, key=lambda x: (whole.stable(x, -1.0), float(np.min(whole.slacks(x, -1.0), initial=np.inf))))
    slacks = whole.slacks(worst, -1.0)
    # a limit that is missed at a shift is asked closer by so many times the miss
    closer = whole.required - whole.signs * 1.5 * np.minimum(slacks, 0.0)
    missed = np.flatnonzero((slacks < 0.0) & np.isfinite(closer))
    return worst, {whole.limits[k].name: float(whole.limits[k].value(closer[k])) for k in missed}


def _shifts(required: float | None, seen: tuple[Resonance, ...], loop: Loop) -> Array:
    """Shifts in per cent that are looked at, all positive."""
    if required is None:
        near = np.arange(COARSE, WARNED_PERCENT + 1e-9, COARSE)
    else:
        sharpest = min([x.damping for x in seen] + [_sharpest(loop)])
        step = float(np.clip(50.0 * sharpest, FINEST, FINE))
        last = max(required, WARNED_PERCENT)
        near = np.linspace(0.0, last, int(np.ceil(last / step)) + 1)[1:]
        near = np.union1d(near, [required])
    farther = FEWER if required is None else OUTER
    return np.concatenate([near, [x for x in farther if x > near[-1] + 1e-9]])


def _sharpest(loop: Loop) -> float:
    """Least damping of the controller's sections, of numerators and denominators; 1 without."""
    parts = [polynomial for block in loop.controller.blocks for polynomial in block.section()]
    found = [abs(p[1]) / (2.0 * np.sqrt(p[0] * p[2])) for p in parts if p[0] * p[2] > 0.0]
    return min([float(x) for x in found if x > 0.0], default=1.0)


class _Search:
    """Slacks of one loop over shifts of its plant, each read once."""

    def __init__(
        self,
        loop: Loop,
        margins: Margins,
        requirements: Requirements,
        unmoved: ShiftedColumns,
        moved: Callable[[float], Plant],
        shifts: Array,
    ) -> None:
        self.loop, self.margins, self.moved, self.shifts = loop, margins, moved, shifts
        self.reader = Reader.of(requirements)
        self.closely = requirements.detuning_percent is not None
        self.drawn = self.closely and loop.scatter is not None
        self.limits = [x for x in LIMITS if x.name in COLUMN_OF and getattr(requirements, x.name) is not None]
        self.columns = np.array([COLUMN_OF[x.name] for x in self.limits], dtype=int)
        self.signs = np.array([x.column_sign for x in self.limits])
        self.required = np.array([x.on_column(float(getattr(requirements, x.name))) for x in self.limits])
        self.readings: dict[float, ShiftedColumns] = {}
        self.scatters: dict[float, tuple[Array, Array]] = {}
        self.poles = self.reading(0.0).poles
        now = np.array([x.on_column(margins[x.name].value) for x in self.limits])
        with np.errstate(invalid="ignore"):
            bias = unmoved.values[self.columns] - now
        self.now = self.signs * (now - self.required)
        self.known = {end: self._known_reach(end, now) for end in (-1.0, 1.0)}
        self.bias = np.where(np.isfinite(bias), bias, 0.0)

    def _known_reach(self, end: float, now: Array) -> Array:
        """How far the bad (-1) or good (1) end of the unmoved loop's intervals lies from the estimate `now`."""
        ends = np.array([x.on_column(np.array(self.margins[x.name].ends)) for x in self.limits]).reshape(-1, 2)
        with np.errstate(invalid="ignore"):
            half_width = end * np.max(end * self.signs[:, None] * (ends - now[:, None]), axis=1)
        return np.where(np.isfinite(half_width), half_width, 0.0)

    def reading(self, percent: float) -> ShiftedColumns:
        """The loop at a shift."""
        if percent not in self.readings:
            self.readings[percent] = read(self.loop, self.moved(0.01 * percent), self.reader)
        return self.readings[percent]

    def slacks(self, percent: float, end: float = 0.0) -> Array:
        """What each limit leaves at a shift: of the estimate, or of its interval's bad (-1) or good (1) end."""
        left = self.signs * (self.reading(percent).values[self.columns] - self._bias(percent) - self.required)
        if end == 0.0:
            return left
        there = np.isfinite(left)  # a crossing that is nowhere stays nowhere
        return np.where(there, np.where(there, left, 0.0) + self._searched(percent, end), left)

    def _searched(self, percent: float, end: float) -> Array:
        """How far the ends lie from the estimate: as of the unmoved loop, grown as draws' deviations grow."""
        if not self.drawn or percent == 0.0:
            return self.known[end]
        here, before = self._scatter(percent)[1], self._scatter(0.0)[1]
        with np.errstate(divide="ignore", invalid="ignore"):
            grown = here / before
        usual = np.isfinite(grown) & (before > 0.0)
        return np.where(usual, self.known[end] * np.where(usual, grown, 1.0), self.known[end] + end * here)

    def _bias(self, percent: float) -> Array:
        """What noise adds to a reading: as to that of the unmoved loop, and by what draws say that it differs."""
        if not self.drawn or percent == 0.0:
            return self.bias
        return self.bias + self._scatter(percent)[0] - self._scatter(0.0)[0]

    def _scatter(self, percent: float) -> tuple[Array, Array]:
        if percent not in self.scatters:
            plant, reading = self.moved(0.01 * percent), self.reading(percent)
            bias, half_width = scatter_of(self.loop, plant, self.reader, reading)
            self.scatters[percent] = bias[self.columns], half_width[self.columns]
        return self.scatters[percent]

    def stable(self, percent: float, end: float = 0.0) -> bool:
        """Whether the loop is stable at a shift: by the estimate, surely (-1), or perhaps (1)."""
        x = self.reading(percent)
        balanced, sure = x.poles is not None and x.poles == self.poles, x.clear > TOL.radius_95
        return (balanced and sure) if end < 0.0 else (balanced or not sure) if end > 0.0 else balanced

    def holds(self, percent: float, end: float = 0.0) -> bool:
        """Whether every requirement holds and the loop is stable at a shift."""
        return self.stable(percent, end) and bool(np.all(self.slacks(percent, end) >= -ROUNDING))

    def both(self) -> tuple[Reach, Reach]:
        """Up and down."""
        if self.margins.stable is ClosedLoop.UNSTABLE:
            none = Reach(0.0, False, STABILITY, (0.0, 0.0))
            return none, none
        return self.one_way(1.0), self.one_way(-1.0)

    def one_way(self, way: float) -> Reach:
        """The largest shift one way, with its interval."""
        percent, beyond = self._first_break(way, 0.0)
        low, _ = self._first_break(way, -1.0, percent)
        high, _ = self._first_break(way, 1.0)
        breaks = "" if beyond else self._what(way, percent)
        return Reach(percent, beyond, breaks, (min(low, percent), max(high, percent)))

    def _first_break(self, way: float, end: float, most: float = SEARCHED_PERCENT) -> tuple[float, bool]:
        """The largest shift up to which all holds, and whether that is all there was to search."""
        before = 0.0
        if not self.holds(0.0, end):
            return 0.0, False
        for shift in np.append(self.shifts[self.shifts < most], most).tolist():
            if not self.holds(way * shift, end):
                return self._between(way, end, before, shift), False
            before = shift
        return before, True

    def _between(self, way: float, end: float, good: float, bad: float) -> float:
        """The shift at which something breaks, between one that holds and one that does not.

        Where it is a limit, by the secants of the least slack; by halves where it is stability, or a secant is no help.
        Without draws the ends of an interval are not looked at again.
        """
        if not self.closely and end != 0.0:
            return good + self._share(way, end, good, bad) * (bad - good)
        for k in range(STEPS if self.closely else STEPS // 2):
            share = min(max(self._share(way, end, good, bad), 0.05), 0.95) if k % 2 == 0 else 0.5
            middle = good + share * (bad - good)
            good, bad = (middle, bad) if self.holds(way * middle, end) else (good, middle)
            if bad - good < FINEST_STEP:
                break
        return good if self.closely else good + self._share(way, end, good, bad) * (bad - good)

    def _share(self, way: float, end: float, good: float, bad: float) -> float:
        """Where between two shifts the first slack passes zero, if each runs straight; else halfway."""
        if not self.stable(way * bad, end):
            return 0.5
        before, after = self.slacks(way * good, end), self.slacks(way * bad, end)
        missed = np.isfinite(before) & np.isfinite(after) & (after < 0.0)
        if not missed.any():
            return 0.5
        left = np.maximum(before[missed], 0.0)
        return float(np.min(left / (left - after[missed])))

    def _what(self, way: float, percent: float) -> str:
        """What breaks first beyond a shift, at the nearest one that was looked at."""
        after = min((x for x in self.readings if way * x >= percent and not self.holds(x)), key=abs)
        if not self.stable(after):
            return STABILITY
        return self.limits[int(np.argmin(self.slacks(after)))].name

    def lost(self) -> Lost | None:
        """The worst miss within +-2 %, where it is more than slight and the unmoved loop holds."""
        if self.margins.stable is not ClosedLoop.STABLE or bool(np.any(self.now < 0.0)):
            return None
        near = self.shifts[self.shifts <= WARNED_PERCENT + 1e-9].tolist()
        within = [way * x for way in (1.0, -1.0) for x in near]
        unstable = [x for x in within if not self.stable(x)]
        if unstable:
            return self._unstable(min(unstable, key=abs))
        slight_db, slight_deg = 0.5, 3.0  # a miss is warned of from this on: dB or ln of a ratio as dB, and degrees
        slight = np.array([slight_deg if x.unit == "deg" else x.of_db(slight_db) for x in self.limits])
        if not slight.size:
            return None
        misses = np.array([-self.slacks(x) / slight for x in within])
        k, j = np.unravel_index(int(np.argmax(misses)), misses.shape)
        return None if misses[k, j] < 1.0 else self._lost(within[int(k)], int(j))

    def _unstable(self, percent: float) -> Lost:
        nan = float("nan")
        at_hz = float(self.reading(percent).at_hz[kernel.LN_MODULUS])
        return Lost(percent, STABILITY, "", nan, nan, nan, at_hz)

    def _lost(self, percent: float, j: int) -> Lost:
        limit, x = self.limits[j], self.reading(percent)
        left = float(limit.value(x.values[self.columns[j]] - self.bias[j]))
        required = float(limit.value(self.required[j]))
        nominal = self.margins[limit.name].value
        return Lost(percent, limit.name, limit.unit, nominal, left, required, float(x.at_hz[self.columns[j]]))


def _explained(whole: _Search, lost: Lost, plant: Plant, seen: tuple[Resonance, ...]) -> Lost:
    """With the resonance near what breaks whose move alone brings L nearest to -1, and the block that turns there."""
    loop, shift = whole.loop, 0.01 * lost.shift_percent
    own_hz = lost.at_hz / (1.0 + shift)
    near = [x for x in seen if abs(x.frequency_hz - own_hz) < max(BESIDE, WIDTHS * x.damping) * x.frequency_hz]
    if not near:
        return lost
    alone = [read(loop, plant.with_moved(x, shift), whole.reader).values[kernel.LN_MODULUS] for x in near]
    one = near[int(np.argmin(alone))]
    block = _block_at(loop, one.frequency_hz, shift)
    kind = loop.controller.blocks[block - 1].kind
    return replace(lost, resonance_hz=one.frequency_hz, block=block, block_kind=kind)


def _block_at(loop: Loop, frequency_hz: float, shift: float) -> int:
    """The controller's block, from 1, whose response changes most between a frequency and that frequency shifted."""
    s = loop.controller.s_at(np.array([frequency_hz, frequency_hz * (1.0 + shift)]))
    changes = []
    for block in loop.controller.blocks:
        num, den = (p[0] + s * (p[1] + s * p[2]) for p in block.section())
        value = num / den
        changes.append(
            abs(np.log(abs(value[1]) / max(abs(value[0]), 1e-12))) + abs(np.angle(value[1] * value[0].conj()))
        )
    return int(np.argmax(changes)) + 1
