"""Controllers in a file of their own: what `tune` writes, `check` reads and a rig loads."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from loopshape import __version__
from loopshape.core.errors import WrongUseError
from loopshape.core.gate import Positive
from loopshape.data.control.controller import Controller
from loopshape.data.control.scheduled import Scheduled
from loopshape.io.config_table import read_file, refuse_doubles
from loopshape.io.files import write_toml
from loopshape.io.run.run_tables import Schedule, controller_table
from loopshape.io.schema import beside

FORMAT = "loopshape-controllers/1"


def read_controllers(path: Path) -> tuple[Controller, ...]:
    """Controllers of a file, one a loop; its `[notes]` are for people.

    Refuses another format, missing and unknown keys, unknown blocks, two controllers of one loop, and a schedule.
    """
    found = read_loop_controllers(path)
    plain = tuple(one for one in found if isinstance(one, Controller))
    if scheduled := [one.loop for one in found if isinstance(one, Scheduled)]:
        raise WrongUseError(
            f"{path.name} holds a schedule, and one controller for each loop is needed here",
            ", ".join(scheduled),
            "take the controller of one operating point: ls.schedules.read_gain_scheduled(file)[0].at(point)",
        )
    return plain


@dataclass(frozen=True)
class ControllersFile:
    """One controller or schedule for each loop, all of one rate."""

    rate_hz: Positive
    loop: tuple[Controller | Schedule, ...]
    notes: Mapping[str, Any] = field(default_factory=dict)

    @classmethod
    def unfolded(cls, table: Mapping[str, Any]) -> dict[str, Any]:
        """The file with its rate in each of its tables."""
        loops = table.get("loop")
        if not isinstance(loops, list):
            return dict(table)
        return {**table, "loop": [beside(one, rate_hz=table.get("rate_hz")) for one in loops]}


def read_loop_controllers(path: Path) -> tuple[Controller | Scheduled, ...]:
    """What a controller file holds, one controller or schedule for each loop."""
    found: Any = read_file(path, ControllersFile, FORMAT).loop
    if not found:
        raise WrongUseError(f"{path.name} holds no controller", "an empty list", "write a [[loop]]")
    refuse_doubles((controller.loop for controller in found), path.name, "controllers")
    return tuple(found)


def write_controllers(
    path: Path, controllers: Sequence[Controller | Scheduled], notes: Mapping[str, Any] | None = None
) -> None:
    """Write controllers and schedules whole; `notes` is any table worth keeping (where they come from, what was asked).

    Refuses no controller, two of one loop, and rates that differ.
    """
    rates = sorted({float(controller.rate_hz) for controller in controllers})
    if len(rates) != 1:
        raise WrongUseError(
            "a file of controllers has one rate",
            ", ".join(f"{rate:g} Hz" for rate in rates) or "no controller",
            "write those of one rate",
        )
    if not all(controller.loop for controller in controllers):
        raise WrongUseError("a controller in a file has the name of its loop", "''", 'give it: loop = "..."')
    refuse_doubles((controller.loop for controller in controllers), path.name, "controllers")
    loops = [{"name": controller.loop, **_table(controller)} for controller in controllers]
    write_toml(
        path,
        {"format": FORMAT, "rate_hz": rates[0], "notes": {"loopshape": __version__, **(notes or {})}, "loop": loops},
    )


def _table(one: Controller | Scheduled) -> dict[str, Any]:
    return one.to_table() if isinstance(one, Scheduled) else controller_table(one)
