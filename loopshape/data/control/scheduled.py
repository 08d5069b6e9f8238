"""What the bench knows of a controller that follows the operating point: what runs where, and how a file has it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Protocol, runtime_checkable

from loopshape.data.control.controller import Controller


@runtime_checkable
class Scheduled(Protocol):
    """A schedule: another controller at each operating point, all of one structure and rate.

    `ls.check` looks at each point by itself. Files of it are read by a toolbox, whose `ls.schedules.GainScheduled` it
    is; its key is `nodes`.
    """

    @property
    def loop(self) -> str:
        """Name of the loop."""

    @property
    def controllers(self) -> tuple[Controller, ...]:
        """Those at its nodes."""

    @property
    def rate_hz(self) -> float:
        """Rate of all of its controllers."""

    def at(self, operating_point: Mapping[str, float]) -> Controller:
        """The controller of a frozen operating point, as it runs there; refuses a point that it does not know."""

    def to_table(self) -> dict[str, Any]:
        """The keys of its table in a file, beside the name of its loop and the rate."""
