"""Margins of a loop, or of several at once: from each limit to what was read of it, and whether the loop is stable."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, fields, replace
from types import MappingProxyType
from typing import Any

import numpy as np

from loopshape.core.errors import meant
from loopshape.core.json_ready import Plain, json_ready
from loopshape.core.outcomes import ClosedLoop
from loopshape.core.units import db, deg
from loopshape.data.requirement.requirements import LIMIT_OF
from loopshape.data.result.detuning import Detuning

Interval = tuple[float, float]
NONE: Mapping[str, Any] = MappingProxyType({})
#: fields that the margins of several loops alone have
_OF_SEVERAL = ("loops", "disk_margin_reached", "worst_changes", "unstable_poles", "notes")


@dataclass(frozen=True)
class Reading:
    """A quantity read off a loop in its limit's unit (nan: nothing was read), its 95 % interval, and where it lies.

    With a `bound` what the plant does outside the measured lines decides it: `value` is the worst that may be, `bound`
    the best.
    """

    value: float = float("nan")
    interval: Interval | None = None
    at_hz: float | None = None
    bound: float | None = None

    @property
    def ends(self) -> Interval:
        """Ends of the interval, or the value twice."""
        return self.interval or (self.value, self.value)

    @property
    def span(self) -> Interval:
        """Ends between which the value lies in 95 %: those of the interval, of a bound on to the best that may be."""
        ends = self.ends if self.bound is None else (*self.ends, self.bound)
        return min(ends), max(ends)


_NOTHING = Reading()
#: limits whose readings every file has, known or not
IN_EVERY_FILE = tuple(LIMIT_OF)[:10]


@dataclass(frozen=True)
class Margins(Mapping[str, Reading], Plain):
    """Margins at one operating point: a mapping from the name of a limit to its `Reading`, by definition from L = C P.

    All limits are its keys; `margins["phase_margin_deg"].interval`, and `margins.phase_margin_deg` is the value alone.
    They are positive for a loop with room, and mean room only where `stable` says "stable"; `inf` where the loop never
    comes to the crossing in question. `detuning_percent` is the lesser of what `detuning` finds up and down, a bound
    where that says `beyond`. Those of masks say how far the worst frequency lies beyond its limit (below 0: room).

    `crossings_hz` are all 0 dB crossings, `phase_crossings_hz` all crossings of the negative real axis, with their
    intervals in the same order. `stability_band_hz` is the band to measure where stability is undecided. `missing_hz`
    are holes between the frequencies, in which a reading is a guess. `last_hz` is the last frequency, `last_gain` |L|
    there and `last_slope` how steeply |L| falls (1: 20 dB a decade).

    Of several `loops` at once they are what each may vary by, all at the same time (`matrix_margins`), and nan is what
    single loops alone have. `disk_margin_reached` is the size of changes known to destabilise: nothing is known between
    the disk margin and it (they are one for three loops or fewer), and its interval goes from one to the other.
    `worst_changes` are the factors (complex, one a loop) that bring the loops to their limit, at the frequency of the
    disk margin.
    """

    readings: Mapping[str, Reading]
    stable: ClosedLoop
    stability_reason: str = ""
    stability_band_hz: Interval | None = None
    crossings_hz: tuple[float, ...] = ()
    phase_crossings_hz: tuple[float, ...] = ()
    crossing_intervals_hz: tuple[Interval, ...] = ()
    phase_crossing_intervals_hz: tuple[Interval, ...] = ()
    missing_hz: tuple[Interval, ...] = ()
    last_hz: float = float("nan")
    last_gain: float = float("nan")
    last_slope: float = float("nan")
    detuning: Detuning | None = None
    loops: tuple[str, ...] = ()
    disk_margin_reached: float = float("nan")
    worst_changes: tuple[complex, ...] = ()
    unstable_poles: int | None = None
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        object.__setattr__(self, "stable", ClosedLoop(self.stable))

    @classmethod
    def of(
        cls, values: Mapping[str, float], stable: str, *, intervals: Mapping[str, Interval] = NONE,
        at_hz: Mapping[str, float] = NONE, bounds: Mapping[str, float] = NONE, **more: Any,
    ) -> Margins:  # fmt: skip
        """Margins of values, intervals, frequencies and bounds by the names of limits; `more` are fields."""
        read = {x: Reading(v, intervals.get(x), at_hz.get(x), bounds.get(x)) for x, v in values.items()}
        return cls(read, ClosedLoop(stable), **more)

    def __repr__(self) -> str:
        """One line: whether the loop is stable, and the margins that are looked at first."""
        main = ("gain_margin_db", "phase_margin_deg", "sensitivity_peak_db", "bandwidth_hz", "disk_margin")
        read = [f"{name} {self[name].value:.4g}" for name in main if self[name].value == self[name].value]
        return f"Margins: {', '.join([str(self.stable), *read])}"

    def __getitem__(self, name: str) -> Reading:
        if name not in LIMIT_OF:
            raise KeyError(f"{name!r} is no limit: {meant(name, LIMIT_OF)}known are {', '.join(LIMIT_OF)}")
        return self.readings.get(name, _NOTHING)

    def __iter__(self) -> Iterator[str]:
        return iter(LIMIT_OF)

    def __len__(self) -> int:
        return len(LIMIT_OF)

    def __getattr__(self, name: str) -> float:
        if name not in LIMIT_OF:
            raise AttributeError(f"Margins have no {name!r}")
        return self[name].value

    @property
    def intervals(self) -> dict[str, Interval]:
        """95 % intervals by name, where there are any."""
        return {name: x.interval for name, x in self.readings.items() if x.interval is not None}

    @property
    def at_hz(self) -> dict[str, float]:
        """Frequencies in Hz by name, of peaks and of the worst margins."""
        return {name: x.at_hz for name, x in self.readings.items() if x.at_hz is not None}

    @property
    def bounds(self) -> dict[str, float]:
        """The best that may be by name, of what is bounded."""
        return {name: x.bound for name, x in self.readings.items() if x.bound is not None}

    def with_readings(self, **found: Reading) -> Margins:
        """The same with other readings of some limits."""
        return replace(self, readings={**self.readings, **found})

    @property
    def changes(self) -> dict[str, dict[str, float]]:
        """`worst_changes` by loop, in gain and phase."""
        found = zip(self.loops, self.worst_changes, strict=True)
        return {name: {"gain_db": float(db(x)), "phase_deg": float(deg(np.angle(x)))} for name, x in found}

    def to_dict(self) -> dict[str, Any]:
        """Values by name, their intervals, frequencies and bounds by the same, and all else; None is not known."""
        return self.table(None)

    def table(self, unknown: str | None = "nan") -> dict[str, Any]:
        """The same for a file, with a word for what is not known."""
        always = [x for x in LIMIT_OF if LIMIT_OF[x].together != "alone"] if unknown is None else IN_EVERY_FILE
        made: dict[str, Any] = {x: self[x].value for x in self if x in self.readings or x in always}
        made |= {"intervals": self.intervals, "at_hz": self.at_hz, "bounds": self.bounds}
        left_out = ("readings", *(() if self.loops else _OF_SEVERAL))
        made |= {f.name: getattr(self, f.name) for f in fields(self) if f.name not in left_out}
        pairs = [(x.real, x.imag) for x in self.worst_changes]  # which a file gives back to the last digit
        changes = {"worst_changes": self.changes if unknown is None else pairs}
        return dict(json_ready(made | (changes if self.loops else {}), unknown))
