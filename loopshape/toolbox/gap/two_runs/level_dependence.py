"""How the response of one machine depends on the level of its excitation."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum

from loopshape.core.json_ready import Plain, keys
from loopshape.core.units import SUFFIXES


class Bend(StrEnum):
    """What a response does from small to large excitation."""

    HARDENING = "hardening"
    SOFTENING = "softening"
    DROPS_WHEN_SMALL = "drops_when_small"
    DROPS_WHEN_LARGE = "drops_when_large"
    LINEAR = "linear"


WORDS = {
    Bend.HARDENING: "rises with the level (hardening or play)",
    Bend.SOFTENING: "falls with the level (softening, or friction that sticks)",
    Bend.DROPS_WHEN_SMALL: "drops at small amplitude (friction, play or softening)",
    Bend.DROPS_WHEN_LARGE: "drops at large amplitude (saturation or hardening)",
}


@dataclass(frozen=True)
class Change:
    """One quantity at the smallest and the largest level, their relative difference with its 95 % interval.

    A resonance in Hz, whose `change` is large over small minus one; or a gain in dB, whose `change` is small less
    large, and of a mean over a band `large` is 0. `band_hz` is where it was taken from.
    """

    bend: Bend
    small: float
    large: float
    change: float
    interval: tuple[float, float]
    band_hz: tuple[float, float]


@dataclass(frozen=True)
class LevelDependence(Plain):
    """Of one loop at one operating point: the two levels (rms of what was injected, in `unit`) and what changed.

    `resonance` (frequency) and `peak` (its height) are None where the recordings show none at both levels, `gain`
    (below the resonance) where they share too few frequencies. `frequencies` known at both levels were compared; where
    they are too few, `decidable` is False and nothing is known of a dependence.
    """

    ALSO = keys("sentence")

    loop: str
    operating_point: Mapping[str, float]
    recordings: tuple[str, str]
    levels: tuple[float, float]
    unit: str
    resonance: Change | None = None
    peak: Change | None = None
    gain: Change | None = None
    frequencies: int = 0
    decidable: bool = True

    @property
    def linear(self) -> bool:
        """Whether it was judged and nothing changed beyond noise."""
        return self.decidable and not {c.bend for c in (self.resonance, self.peak, self.gain) if c} - {Bend.LINEAR}

    @property
    def sentence(self) -> str:
        """What changed from the smallest to the largest level, in one sentence; no cause beyond its kind."""
        unit = "" if self.unit == "1" else f" {SUFFIXES.get(self.unit, self.unit)}"
        between = f"{self.loop}, injected {self.levels[0]:.3g} to {self.levels[1]:.3g}{unit} rms"
        if not self.decidable:
            return (
                f"{between}: whether the response depends on the level was not judged, for only {self.frequencies}"
                " frequencies are known at both levels; excite the same band at each."
            )
        parts = [_resonance(self.resonance), _gain("the resonance's peak", self.peak), _below(self.gain)]
        return f"{between}: {'; '.join(p for p in parts if p) or 'no dependence on the level beyond noise'}."


def _resonance(c: Change | None) -> str:
    if c is None or c.bend is Bend.LINEAR:
        return ""
    low, high = (100.0 * x for x in c.interval)
    return f"the resonance {WORDS[c.bend]}, {c.small:.4g} to {c.large:.4g} Hz ({low:+.2g} to {high:+.2g} %)"


def _gain(what: str, c: Change | None) -> str:
    if c is None or c.bend is Bend.LINEAR:
        return ""
    return f"{what} {WORDS[c.bend]}, by {abs(c.change):.2g} dB ({c.interval[0]:+.2g} to {c.interval[1]:+.2g} dB)"


def _below(c: Change | None) -> str:
    """The gain with the band that it was taken from."""
    return "" if c is None else _gain(f"the gain from {c.band_hz[0]:.3g} to {c.band_hz[1]:.3g} Hz", c)
