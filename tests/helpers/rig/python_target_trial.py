"""Trials of the target in Python, from docs/protocol.md alone: how a second controller takes over."""

import struct
from dataclasses import dataclass, field

from python_target_blocks import biquad
from python_target_schedule import RefusedError, fields, inside

NOTHING, ERROR_PEAK, CONTROL_RANGE, ERROR_RMS, GROWTH, LEASE, HOST, BY_FAULT = range(8)
NONE, OWN, ON_TRIAL, WENT_BACK, KEPT = range(5)


@dataclass
class Trial:
    """The controller and how far it is."""

    loop: int
    track: float
    sections: list[tuple[float, ...]] = field(default_factory=list)
    age: float | None = None
    """Ticks since BLEND by the clock, where a board as fast as it can goes by that."""

    def take(self, first: int, rows: list[tuple[float, ...]]) -> None:
        """More sections."""
        inside(first == len(self.sections), f"section {first} is out of order")
        self.sections += rows

    def arm(self) -> None:
        """From here on its own controller alone."""
        self.phase, self.why, self.ticks = OWN, NOTHING, 0
        self.share = self.value = self.limit = 0.0
        self.ends = False
        self.rest()

    def rest(self) -> None:
        """All that it remembers is zero."""
        self.states, self.offset = [[0.0, 0.0] for _ in self.sections], 0.0

    def blend(self, payload: bytes) -> None:
        """BLEND, or the refusal that it earns."""
        share, ramp, lease, window, *numbers = fields("dIII5d", payload)
        if self.phase in (WENT_BACK, KEPT):
            raise RefusedError(1, "the trial is over")
        peak, low, high, rms, growth = numbers
        inside(0.0 <= share <= 1.0 and window > 0, f"share {share}, window {window}")
        inside(lease > 0 or share == 1.0, "a part of it does not stay")
        inside(peak > 0.0 and rms > 0.0 and growth > 1.0 and low < high, f"watched {numbers}")
        self.to, self.ramp, self.lease, self.window = share, ramp, lease, window
        self.peak, self.low, self.high, self.rms, self.growth = numbers
        self.start, self.ticks, self.errors, self.before, self.rising = self.share, 0, [], None, 0
        self.phase = ON_TRIAL if lease else KEPT
        if share == 0.0:
            self.back(HOST)

    def back(self, why: int, value: float = 0.0, limit: float = 0.0) -> None:
        """Its own controller, for good."""
        self.phase, self.share = WENT_BACK, 0.0
        self.why, self.value, self.limit = why, value, limit
        self.ends = why not in (HOST, BY_FAULT)

    def fault(self) -> None:
        """A machine that is in fault is not on trial."""
        if self.phase in (ON_TRIAL, KEPT):
            self.back(BY_FAULT)

    def progress(self) -> bytes:
        """PROGRESS's answer."""
        return struct.pack("<BBIddd", self.phase, self.why, self.ticks, self.share, self.value, self.limit)

    def step(self, error: float, x: float, own: float) -> float:
        """The loop's z."""
        for section, state in zip(self.sections, self.states, strict=True):
            x = biquad(section, state, x)
        if self.phase == OWN:
            self.offset += self.track * (x - own - self.offset)
        if self.phase in (OWN, WENT_BACK):
            return own
        self.ticks += 1
        way = (self.to - self.start) * self.ticks / self.ramp if self.ticks < self.ramp else None
        self.share = self.to if way is None else self.start + way
        z = own + self.share * (x - self.offset - own)
        found = self._watched(error, z)
        if found is None:
            return z
        self.back(*found)
        return own

    def _watched(self, error: float, z: float) -> tuple[int, float, float] | None:
        if not abs(error) <= self.peak:
            return ERROR_PEAK, error, self.peak
        if not self.low <= z <= self.high:
            return CONTROL_RANGE, z, self.low if z < self.low else self.high
        self.errors.append(error * error)
        total = sum(self.errors)
        if not total <= self.rms**2 * self.window:
            return ERROR_RMS, total / self.window, self.rms**2
        if len(self.errors) == self.window:
            now, before, self.errors = total / self.window, self.before, []
            self.before = now
            self.rising = self.rising + 1 if before is not None and now > self.growth * before else 0
            if self.rising == 3:
                return GROWTH, now / before, self.growth
        age = float(self.ticks if self.age is None else self.age)
        return (LEASE, age, float(self.lease)) if 0 < self.lease <= age else None
