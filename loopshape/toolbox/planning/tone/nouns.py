"""What a recording's channel holds by itself: its rms, and tones with their frequency, amplitude and growth."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from math import exp, log10
from typing import Any

from loopshape.data.signal.channel import Channel

Interval = tuple[float, float]


#: growth in dB over the part that shows a tone, from which on it is one: what the supply's tolerance of 10 % (IEC
#: 60038) makes of a tone that it drives when it moves from one end to the other
LEAST_GROWTH_DB = 20.0 * log10(1.1 / 0.9)


class Growth(Enum):
    """What a tone's amplitude does while it is seen, where that is clearly more than `LEAST_GROWTH_DB`."""

    GROWS = "grows"
    DECAYS = "decays"
    STEADY = "no growth shown"


@dataclass(frozen=True)
class Tone:
    """A tone a exp(g t) cos(2 pi f t + phase) in one channel, with 95 % intervals.

    `amplitude` is that in the middle of `from_s` to `to_s`, the part of the recording that shows the tone most clearly,
    in the channel's unit; `growth_per_s` is g in 1/s. `chance` is that of noise alone showing as much anywhere in the
    channel. `growth` is decided at the chance that was asked for, not by the interval.
    """

    frequency_hz: float
    frequency_interval_hz: Interval
    amplitude: float
    amplitude_interval: Interval
    growth_per_s: float
    growth_interval_per_s: Interval
    growth: Growth
    from_s: float
    to_s: float
    chance: float

    @property
    def seen_s(self) -> float:
        """Length of the part that shows it, in s."""
        return self.to_s - self.from_s

    @property
    def growth_db(self) -> float:
        """Amplitude at the end of that part relative to its start, in dB."""
        return 20.0 * self.growth_per_s * self.seen_s * log10(exp(1.0))

    @property
    def growth_interval_db(self) -> Interval:
        """The same with 95 %."""
        low, high = (20.0 * g * self.seen_s * log10(exp(1.0)) for g in self.growth_interval_per_s)
        return low, high

    def to_dict(self) -> dict[str, Any]:
        """As JSON takes it."""
        return vars(self) | {"growth": self.growth.value, "growth_db": self.growth_db}


@dataclass(frozen=True)
class Tones:
    """A channel of a recording: rms about its mean with 95 % interval, in `unit`, and its tones, the clearest first.

    `chance` is that of any tone being reported in a channel of noise alone; `lowest_hz` and `highest_hz` bound where
    tones are looked for. `closed_loop` tells whether a loop was closed around the channel, None where nothing does.
    """

    recording: str
    channel: str
    unit: str
    rms: float
    rms_interval: Interval
    mean: float
    duration_s: float
    chance: float
    lowest_hz: float
    highest_hz: float
    tones: tuple[Tone, ...]
    closed_loop: bool | None = None

    @property
    def growing(self) -> tuple[Tone, ...]:
        """The tones that grow."""
        return tuple(tone for tone in self.tones if tone.growth is Growth.GROWS)

    @property
    def label(self) -> str:
        """Channel and unit as an axis shows them."""
        return Channel(self.channel, self.unit).label if self.unit else self.channel

    @property
    def warnings(self) -> tuple[str, ...]:
        """A sentence for each tone that grows; of stability where a loop was closed."""
        why = ": the loop may be unstable or close to it" if self.closed_loop else ""
        return tuple(
            f"{self.recording}: {self.channel} holds a tone at {tone.frequency_hz:.4g} Hz that is not the excitation's"
            f" and grows by {tone.growth_db:.3g} dB from {tone.from_s:.3g} to {tone.to_s:.3g} s{why}; look at it with"
            " loopshape tones"
            for tone in self.growing
        )

    def to_dict(self) -> dict[str, Any]:
        """As JSON takes it."""
        return vars(self) | {"tones": [tone.to_dict() for tone in self.tones]}
