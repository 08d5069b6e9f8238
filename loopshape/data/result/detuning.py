"""How far a plant's resonances may move before a loop misses a requirement or its stability.

A shift d moves every frequency of the plant to (1 + d) times itself: P'(f) = P(f/(1 + d)). It is given in per cent.
"""

from __future__ import annotations

from dataclasses import dataclass

#: shifts are searched up to this, up and down, in per cent
SEARCHED_PERCENT = 20.0
#: where nothing is required, a limit that breaks within this is warned of, in per cent
WARNED_PERCENT = 2.0
#: what breaks where no requirement does
STABILITY = "stability"


@dataclass(frozen=True)
class Reach:
    """The largest shift one way, in per cent (positive), below which every requirement holds and the loop is stable.

    `breaks` is what breaks there: a field of `Margins`, "stability", or nothing where `beyond` says that nothing does
    up to `percent`, which is a bound then. `interval_percent` holds the 95 % interval, its high end a bound where it is
    the largest shift searched.
    """

    percent: float
    beyond: bool
    breaks: str
    interval_percent: tuple[float, float]


@dataclass(frozen=True)
class MovedResonance:
    """What one resonance of the plant, moved alone, leaves; its pole pair is taken from a local fit."""

    frequency_hz: float
    damping: float
    up: Reach
    down: Reach

    @property
    def percent(self) -> float:
        """The lesser of both."""
        return min(self.up.percent, self.down.percent)


@dataclass(frozen=True)
class Lost:
    """The worst miss within +-2 %: at `shift_percent`, `quantity` falls from `nominal` to `left` of `required`.

    `quantity` "stability" has no numbers (nan). `resonance_hz` is the resonance (of the unmoved plant) whose move alone
    costs most, `block` the controller's block that depends most on frequency there (from 1), `block_kind` its kind;
    None, 0 and "" where no resonance is seen near `at_hz`.
    """

    shift_percent: float
    quantity: str
    unit: str
    nominal: float
    left: float
    required: float
    at_hz: float
    resonance_hz: float | None = None
    block: int = 0
    block_kind: str = ""


@dataclass(frozen=True)
class Detuning:
    """Detuning margin of a loop at one operating point: of the whole frequency axis, and of single resonances.

    `drawn` tells where intervals come from: draws of the FRF's error at each shift, else the intervals of the unmoved
    loop carried along. `lost` is what to warn of, None where nothing is.
    """

    up: Reach
    down: Reach
    resonances: tuple[MovedResonance, ...] = ()
    drawn: bool = False
    lost: Lost | None = None

    @property
    def worst(self) -> Reach:
        """The lesser of up and down."""
        return min(self.up, self.down, key=lambda one: (one.percent, one.interval_percent[0]))

    @property
    def interval_percent(self) -> tuple[float, float]:
        """95 % interval of the lesser: least of both low ends, least of both high ends."""
        ends = self.up.interval_percent, self.down.interval_percent
        return min(ends[0][0], ends[1][0]), min(ends[0][1], ends[1][1])
