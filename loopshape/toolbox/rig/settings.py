"""What a study says of a real-time target: where it is, what each command is made of, and what must never be passed."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from math import inf
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from loopshape.core.errors import WrongUseError, refuse_unknown
from loopshape.core.gate import Count
from loopshape.core.units import SUFFIXES, Array, deg
from loopshape.data.signal.channel import Channel

if TYPE_CHECKING:
    from loopshape.data.signal.experiment import Experiment, LoopSetup
    from loopshape.toolbox.rig.simulated import Planned
    from loopshape.toolbox.rig.target.messages import Identity

ON_LIMIT = ("vent", "hold")


@dataclass(frozen=True)
class Limit:
    """Lowest and highest value of a column and its largest rate a second, in the column's unit."""

    column: str
    low: float
    high: float
    rate: float = inf

    def __post_init__(self) -> None:
        Channel.from_column(self.column)
        if not self.low < self.high or not self.rate > 0.0:
            raise WrongUseError(
                f"the limits of {self.column} are a low value, a higher one and a positive rate",
                f"{self.low:g}, {self.high:g} and {self.rate:g}",
            )

    def spoken_value(self, value: float) -> str:
        """A value of this column as people say it: angles in degrees."""
        return spoken(value, Channel.from_column(self.column).unit)

    def __str__(self) -> str:
        low, high = self.spoken_value(self.low).split(" ", 1)[0], self.spoken_value(self.high)
        rate = "" if self.rate == inf else f", at most {self.spoken_value(self.rate)}/s"
        return f"{low} to {high}{rate}"


def spoken(value: float, unit: str) -> str:
    """A value with its unit as people say it: angles in degrees."""
    return f"{deg(value):.4g} deg" if unit == "rad" else f"{value:.4g} {SUFFIXES[unit]}"


@dataclass(frozen=True, eq=False)
class TargetSettings:
    """How a study drives a target.

    `port` is a serial port, a pseudo-terminal or tcp://127.0.0.1:N (None: given on the command line); `commands` by
    column, each a sum of loops' z by factor; `limits` by column, of sensors and commands; `on_limit` vent or hold.
    The loops close over `soft_start_s`, setpoints move for at least that long, and rest for `settle_s` before
    a recording. `place`: an emulated machine stands at rest at the operating point at a recording's start.
    """

    limits: Mapping[str, Limit]
    commands: Mapping[str, Mapping[str, float]]
    port: str | None = None
    baud: Count = 921_600
    on_limit: str = "vent"
    watchdog_ms: Count = 250
    soft_start_s: float = 2.0
    settle_s: float = 2.0
    place: bool = True
    ELSEWHERE: ClassVar = ("limits",)

    def __post_init__(self) -> None:
        refuse_unknown("on_limit is not known", self.on_limit, ON_LIMIT)
        if not 20 <= self.watchdog_ms <= 10_000:
            raise WrongUseError("watchdog_ms lies between 20 and 10000", f"{self.watchdog_ms}")
        if not self.commands:
            raise WrongUseError("a target has commands", "none", "say in [target.commands] what each is made of")
        for column in (*self.commands, *self.limits):
            Channel.from_column(column)


@dataclass(frozen=True, eq=False)
class Motion:
    """What a target is about to do: its identity, where it is, its limits, and the recordings to be made."""

    identity: Identity
    port: str
    settings: TargetSettings
    recordings: Sequence[Planned]
    experiment: Callable[[Planned], Experiment]
    notes: tuple[str, ...] = ()
    """What a person should know before it moves: of verdicts, of what was allowed, of an older target."""

    def experiments(self) -> Iterator[Experiment]:
        """The recordings with their signals, one at a time."""
        return map(self.experiment, self.recordings)


#: whether a motion may begin
Confirm = Callable[[Motion], bool]


def decoupling_matrix(loops: Sequence[LoopSetup]) -> Array:
    """What enters the plant of the controllers' outputs, (loops, loops); the identity where nothing is decoupled."""
    names = [loop.name for loop in loops]
    return np.array([[_weight(loop, name) for name in names] for loop in loops])


def _weight(loop: LoopSetup, name: str) -> float:
    return float(loop.decoupling.get(name, 0.0)) if loop.decoupling else float(loop.name == name)
