"""What watches a recording while it runs: guards inside the limits, sensors that stand still, and what is enough."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from threading import Thread

import numpy as np

from loopshape.core.units import Array
from loopshape.data.signal.experiment import Experiment
from loopshape.data.signal.recording import Recording, RecordingInfo
from loopshape.toolbox.rig.settings import Limit
from loopshape.toolbox.rig.steps.enough import NORMAL, Look, State, Until, boundary, look, looks_s
from loopshape.toolbox.rig.steps.escalation import Trip, stuck

Report = Callable[[Look], None]


@dataclass(frozen=True, eq=False)
class Expected:
    """A column's motion (samples,) as a step before showed it (nan: not known), and its `middle` at rest.

    A sensor that stands still while it should move by `least` is stuck. Farther from the middle than `far`, where
    friction that lets go no longer explains it, it may go `off` beyond what is expected.
    """

    motion: Array
    middle: float
    least: float
    far: float
    off: float

    def left_by(self, x: Array, first: int) -> np.ndarray:
        """Whether values (k,) from row `first` on are farther out than expected."""
        out = np.abs(x - self.middle)
        return np.asarray(
            (out > self.far) & (out - np.abs(self.motion[first : first + x.size] - self.middle) > self.off)
        )


@dataclass(eq=False)
class Supervisor:
    """Watches one experiment; `trip` says what ended it, None while nothing did.

    `guards` and `limits` are by column; `still_ticks` by column how long a sensor may stand still,
    `expected` its motion. With `until` it
    looks at what came after `times_s`. `report` hears of each look.
    """

    e: Experiment
    guards: Mapping[str, Limit] = field(default_factory=dict)
    limits: Mapping[str, Limit] = field(default_factory=dict)
    still_ticks: Mapping[str, int] = field(default_factory=dict)
    expected: Mapping[str, Expected] = field(default_factory=dict)
    until: Until | None = None
    report: Report = lambda found: None
    trip: Trip | None = None
    column: str | None = None
    last: Look | None = None

    def __post_init__(self) -> None:
        band = self._lowest_hz()
        whole_s = self.e.samples / self.e.rate_hz
        self.times_s = looks_s((self.e.period_s, self.e.periodic_from_s), band, whole_s) if self.until else ()
        from_s = self.e.periodic_from_s or 0.0
        measured = [t - from_s for t in self.times_s]
        self.widened = boundary(measured) / NORMAL if len(measured) > 1 else 1.0
        self._next, self._rows = 0, 0
        self._still: dict[str, tuple[float, int]] = {}
        self._thread: Thread | None = None

    def _lowest_hz(self) -> float:
        return 1.0 / self.e.period_s if self.e.period_s else 50.0 * self.e.rate_hz / max(self.e.samples, 1)

    @property
    def why(self) -> str | None:
        """Why the recording is shorter than asked, None where it is enough or nothing ended it."""
        if self.trip in (None, Trip.ENOUGH):
            return None
        words = {
            Trip.GUARD: "came near to its limit and the excitation stopped",
            Trip.LIMIT: "passed its limit",
            Trip.STUCK: "stands still",
            Trip.UNEXPECTED: "did not do what the step before predicted",
        }
        return f"{self.column} {words[self.trip]}"

    def first_trip(self, block: Mapping[str, Array]) -> int | None:
        """Place in a block of rows (k,) by column of the first that ends the recording; `trip` then says what."""
        found: list[tuple[int, Trip, str]] = []
        for trip, ends in ((Trip.LIMIT, self.limits), (Trip.GUARD, self.guards)):
            for column, limit in ends.items():
                if column in block:
                    over = np.flatnonzero(~((block[column] >= limit.low) & (block[column] <= limit.high)))
                    found += [(int(over[0]), trip, column)] if over.size else []
        rows = 0
        for column in self.still_ticks.keys() | self.expected.keys():
            if column in block and (rows := block[column].size):
                x = np.asarray(block[column])
                place = self._stands_still(column, x)
                found += [] if place is None else [(place, Trip.STUCK, column)]
                if (one := self.expected.get(column)) is not None:
                    off = np.flatnonzero(one.left_by(x, self._rows))
                    found += [(int(off[0]), Trip.UNEXPECTED, column)] if off.size else []
        self._rows += rows
        if not found or self.trip is not None:
            return None
        place, self.trip, self.column = min(found, key=lambda one: one[0])
        return place

    def _stands_still(self, column: str, x: Array) -> int | None:
        """The first row (n,) at which a column has not changed for too long, or should have moved since it did."""
        value, count = self._still.get(column, (np.nan, 0))
        change = np.concatenate([[x[0] != value], np.diff(x) != 0.0])
        place = np.arange(x.size)
        since = place - np.maximum.accumulate(np.where(change, place, -1 - count))
        self._still[column] = (float(x[-1]), int(since[-1]))
        late = since > self.still_ticks.get(column, np.inf)
        if column in self.expected:
            late |= stuck(self.expected[column].motion, self._rows + place, since, self.expected[column].least)
        first = np.flatnonzero(late)
        return int(first[0]) if first.size else None

    def due(self, rows: int) -> int | None:
        """Rows that the next look is at, where they are there; None without a look."""
        if self.until is None or self._next >= len(self.times_s):
            return None
        n = round(self.times_s[self._next] * self.e.rate_hz)
        return n if rows >= n else None

    def looked(self, columns: Mapping[str, Array]) -> Look:
        """Look at what is there; with enough of it `trip` says so."""
        assert self.until is not None
        self._next += 1
        info = replace(RecordingInfo.of(self.e), role="estimation")
        loop = next(one for one in self.e.loops if one.name == self.e.excites)
        ends = self._next >= len(self.times_s)
        found = look(Recording(info, self.e.rate_hz, columns), loop, self.until, self.widened)
        self.last = found
        self.report(found)
        if found.state is not State.MORE and not ends and self.trip is None:
            self.trip = Trip.ENOUGH
        return found

    def look_beside(self, columns: Callable[[int], Mapping[str, Array]], rows: int) -> None:
        """As `looked`, in a thread: whoever keeps a target alive must not wait. One look at a time."""
        if self.trip is not None or (self._thread is not None and self._thread.is_alive()):
            return
        n = self.due(rows)
        if n is not None and n < self.e.samples:
            self._thread = Thread(target=self.looked, args=(columns(n),), daemon=True)
            self._thread.start()


def within(recording: Recording, limits: Mapping[str, Limit]) -> Recording:
    """A recording up to where the first limit is passed, as a target ends it."""
    found: list[tuple[int, str]] = []
    for column in limits.keys() & recording.columns.keys():
        x = np.asarray(recording.columns[column])
        over = np.flatnonzero(~((x >= limits[column].low) & (x <= limits[column].high)))
        found += [(int(over[0]), column)] if over.size else []
    if not found:
        return recording
    place, column = min(found)
    return cut(recording, place + 1, f"{column} passed its limit")


def cut(recording: Recording, n: int, why: str | None) -> Recording:
    """The first n rows; `why` says that the recording ended early."""
    info = (
        recording.info
        if why is None
        else replace(recording.info, ended_early=f"{why} at {n / recording.rate_hz:.3f} s")
    )
    return Recording(info, recording.rate_hz, {name: np.asarray(x)[:n] for name, x in recording.columns.items()})
