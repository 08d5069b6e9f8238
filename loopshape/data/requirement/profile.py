"""A profile: the limits of a standard or of a trade's practice, with clause, edition, and who has to confirm them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from itertools import pairwise
from math import erf, inf, sqrt
from typing import Any

from loopshape.core.errors import WrongUseError
from loopshape.data.requirement.requirements import LIMIT_OF, LIMITS, Requirements
from loopshape.data.result.verdict import Verdict


@dataclass(frozen=True)
class Zone:
    """A range of peak |S| up to `up_to_db`, which the standard names; of the last one inf."""

    name: str
    means: str
    up_to_db: float = inf


@dataclass(frozen=True)
class Profile:
    """Limits by the name of a quantity in `Requirements`, and the words that go with them.

    `unread` names the limits that were not read in the standard's own text: `source` says where they come from.
    `confirm` is a sentence that says who has to confirm them. `zones` are those of peak |S|, in rising order.
    """

    name: str
    title: str
    standard: str
    edition: str
    clause: str
    source: str
    confirm: str
    limits: Mapping[str, float]
    unread: tuple[str, ...] = ()
    remarks: tuple[str, ...] = ()
    zones: tuple[Zone, ...] = field(default=())

    def __post_init__(self) -> None:
        if strange := sorted(set(self.unread) - set(self.limits)):
            raise WrongUseError("unread names what is no limit", ", ".join(strange), "name limits of it")
        if unknown := sorted(set(self.limits) - {limit.name for limit in LIMITS}):
            raise WrongUseError(
                f"profile {self.name!r} limits quantities that are not known", ", ".join(unknown),
                f"use {', '.join(limit.name for limit in LIMITS)}",
            )  # fmt: skip
        limits: dict[str, Any] = dict(self.limits)
        Requirements(**limits)
        edges = [zone.up_to_db for zone in self.zones]
        if edges and not (all(a < b for a, b in pairwise(edges)) and edges[-1] == inf):
            raise WrongUseError(f"the zones of profile {self.name!r} rise, and the last has no end", f"{edges}")

    def __repr__(self) -> str:
        """One line: its name, standard and limits."""
        asked = ", ".join(f"{name} {LIMIT_OF[name].sense.replace('_', ' ')} {v:g}" for name, v in self.limits.items())
        return f"Profile {self.name} ({self.standard}): {asked}"

    def joined(self, requirements: Requirements) -> Requirements:
        """Requirements under which both hold: of each quantity the stricter limit."""
        return requirements.stricter(self.limits)

    def sentences(self) -> tuple[str, ...]:
        """What a verdict under this profile has to carry: standard and clause, what was not read, who confirms."""
        notes = [f"Profile {self.name}: {self.standard}, {self.edition}, {self.clause}."]
        if self.unread:
            notes.append(
                f"Not read in the standard's own text: {', '.join(self.unread)} (taken from {self.source})."
            )  # fmt: skip
        return (*notes, *self.remarks, self.confirm)


def zone_shares(verdict: Verdict, profile: Profile) -> dict[str, float]:
    """Probability of each zone of a profile for the largest peak |S| over all operating points.

    From each point's 95 % interval, taken as that of a normal error in dB, independent between points; without an
    interval the estimate is taken as exact. Empty for a profile without zones and for a loop that is not surely stable:
    there peak |S| says nothing. Misleads as far as the intervals leave out what was not measured.
    """
    if not profile.zones or verdict.unstable or not verdict.margins:
        return {}
    below = [1.0 if zone.up_to_db == inf else _all_below(verdict, zone.up_to_db) for zone in profile.zones]
    return {
        zone.name: up - low for zone, up, low in zip(profile.zones, below, [0.0, *below[:-1]], strict=True)
    }  # fmt: skip


def _all_below(verdict: Verdict, limit_db: float) -> float:
    share = 1.0
    width = 2.0 * 1.959963984540054  # of a 95 % interval, in standard deviations
    for found in verdict.margins.values():
        read = found["sensitivity_peak_db"]
        std, room = (read.ends[1] - read.ends[0]) / width, limit_db - read.value
        share *= 0.5 * (1.0 + erf(room / (std * sqrt(2.0)))) if std > 0.0 else float(room >= 0.0)
    return share
