"""Controllers in a file of their own: what `tune` writes, `check` reads and a rig loads."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from loopshape import __version__
from loopshape.core.errors import WrongUseError
from loopshape.data.control.controller import Controller
from loopshape.data.control.gain_scheduled import GainScheduled
from loopshape.io.config_table import ConfigTable, read_words, refuse_doubles
from loopshape.io.files import write_toml
from loopshape.io.run.run_tables import (
    CONTROLLER_KEYS,
    SCHEDULE_KEYS,
    controller_table,
    read_controller,
    read_schedule,
    schedule_table,
)

FORMAT = "loopshape-controllers/1"


def read_controllers(path: Path) -> tuple[Controller, ...]:
    """Controllers of a file, one a loop; its `[notes]` are for people.

    Refuses another format, missing and unknown keys, unknown blocks, two controllers of one loop, and a schedule.
    """
    found = read_loop_controllers(path)
    plain = tuple(one for one in found if isinstance(one, Controller))
    if scheduled := [one.loop for one in found if isinstance(one, GainScheduled)]:
        raise WrongUseError(
            f"{path.name} holds a schedule, and one controller for each loop is needed here",
            ", ".join(scheduled),
            "take the controller of one operating point: ls.schedules.read_gain_scheduled(file)[0].at(point)",
        )
    return plain


def read_gain_scheduled(path: Path) -> tuple[GainScheduled, ...]:
    """The schedules of a controller file; refuses a file without any, and what `read_loop_controllers` refuses."""
    found = tuple(one for one in read_loop_controllers(path) if isinstance(one, GainScheduled))
    if not found:
        raise WrongUseError(f"{path.name} holds no schedule", "plain controllers", "read them as controllers")
    return found


def read_loop_controllers(path: Path) -> tuple[Controller | GainScheduled, ...]:
    """What a controller file holds, one controller or schedule for each loop."""
    words = read_words(path, FORMAT)
    words.only("format", "rate_hz", "notes", "loop")
    words.need("rate_hz", "loop")
    rate_hz = words.positive("rate_hz")
    controllers = tuple(_read(table, rate_hz) for table in words.tables("loop"))
    if not controllers:
        raise WrongUseError(f"{path.name} holds no controller", "an empty list", "write a [[loop]]")
    if not all(controller.loop for controller in controllers):
        raise WrongUseError("a controller in a file has the name of its loop", "''", 'give it: loop = "..."')
    refuse_doubles((controller.loop for controller in controllers), path.name, "controllers")
    return controllers


def _read(words: ConfigTable, rate_hz: float) -> Controller | GainScheduled:
    if "nodes" in words.table:
        words.only("name", *CONTROLLER_KEYS[:-1], *SCHEDULE_KEYS)
        words.need("name")
        return read_schedule(words, rate_hz)
    words.only("name", *CONTROLLER_KEYS)
    words.need("name", "controller")
    return read_controller(words, rate_hz)


def write_controllers(
    path: Path, controllers: Sequence[Controller | GainScheduled], notes: Mapping[str, Any] | None = None
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


def _table(one: Controller | GainScheduled) -> dict[str, Any]:
    return schedule_table(one) if isinstance(one, GainScheduled) else controller_table(one)
