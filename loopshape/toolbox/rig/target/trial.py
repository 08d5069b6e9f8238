"""A second controller on a target: TRIAL loads it beside a loop's own, BLEND crosses over, PROGRESS says how far."""

from __future__ import annotations

import struct
from dataclasses import dataclass
from enum import IntEnum
from math import inf, sqrt

import numpy as np

from loopshape.core.errors import UnreadableInputError
from loopshape.core.units import Array
from loopshape.toolbox.rig.target.frames import LONGEST_PAYLOAD

_PROGRESS = struct.Struct("<BBIddd")


class Phase(IntEnum):
    """Where a trial is."""

    NONE = 0
    OWN = 1
    ON_TRIAL = 2
    WENT_BACK = 3
    STAYS = 4


class Why(IntEnum):
    """What took a target back."""

    NOTHING = 0
    ERROR_PEAK = 1
    CONTROL_RANGE = 2
    ERROR_RMS = 3
    GROWTH = 4
    LEASE = 5
    HOST = 6
    FAULT = 7

    @property
    def sentence(self) -> str:
        """The same in words."""
        return (
            "nothing", "an error beyond the predicted interval", "a control signal beyond the predicted interval",
            "an error rms beyond the predicted interval", "an error that grows from window to window",
            "a host that did not go on in time", "the host", "a fault of the machine",
        )[self]  # fmt: skip


@dataclass(frozen=True, eq=False)
class Trial:
    """A controller for the loop at this place: its `sections` (n, 5), computed beside the loop's own from one error.

    With `track` above 0 its output is shifted by the mean difference of both, which follows each tick by that share
    until the first step and stays from there on: what an integrator holds then is the loop's own offset, not its own.
    """

    loop: int
    sections: Array
    track: float = 0.0

    def payloads(self) -> list[bytes]:
        """Payloads of TRIAL."""
        most = (LONGEST_PAYLOAD - 11) // 40
        parts = [(k, self.sections[k : k + most]) for k in range(0, len(self.sections), most)]
        return [
            struct.pack("<BBBd", self.loop, k, len(part), self.track) + np.asarray(part, "<f8").tobytes()
            for k, part in parts
        ]


@dataclass(frozen=True)
class Watch:
    """One step of a trial: the new controller's `share`, reached over `ramp` ticks, and what ends it.

    The target goes back where |r - y| passes `error_peak`, its mean square over `window` ticks `error_rms` squared, or
    grows by `growth` from one window to the next three times in a row, where z leaves `control_low` to
    `control_high`, and after `lease` ticks without another BLEND; 0: it stays, with a share of 1 alone. In the units of
    the loop's output and of z.
    """

    share: float
    ramp: int
    lease: int
    window: int
    error_peak: float = inf
    control_low: float = -inf
    control_high: float = inf
    error_rms: float = inf
    growth: float = inf

    def payload(self) -> bytes:
        """Payload of BLEND."""
        return struct.pack(
            "<dIII5d", self.share, self.ramp, self.lease, self.window, self.error_peak, self.control_low,
            self.control_high, self.error_rms, self.growth,
        )  # fmt: skip


@dataclass(frozen=True)
class Progress:
    """Answer to PROGRESS: `ticks` since BLEND; `value` and `limit` of what took it back (roots of mean squares)."""

    phase: Phase
    why: Why
    ticks: int
    share: float
    value: float
    limit: float

    @classmethod
    def read(cls, payload: bytes) -> Progress:
        """From the payload. Refuses another length, and a phase or reason that there is not."""
        try:
            phase, why, ticks, share, value, limit = _PROGRESS.unpack(payload)
            if why in (Why.ERROR_RMS, Why.GROWTH):
                value, limit = sqrt(value), sqrt(limit)
            return cls(Phase(phase), Why(why), ticks, share, value, limit)
        except (struct.error, ValueError):
            raise UnreadableInputError(
                "the target says of a trial what the protocol does not have",
                payload.hex(),
                "its version may be another",
            ) from None
