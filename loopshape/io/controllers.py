"""Controllers in a file of their own: what `tune` writes, `check` reads and a rig loads."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from loopshape import __version__
from loopshape.core.errors import WrongUseError
from loopshape.data.controller import Controller
from loopshape.io.files import write_toml
from loopshape.io.run_tables import CONTROLLER_KEYS, controller_table, read_controller
from loopshape.io.words import Words, read_words, refuse_doubles

FORMAT = "loopshape-controllers/1"


def read_controllers(path: Path) -> tuple[Controller, ...]:
    """Controllers of a file, one a loop; its `[notes]` are for people.

    Refuses another format, missing and unknown keys, unknown blocks, and two controllers of one loop.
    """
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


def _read(words: Words, rate_hz: float) -> Controller:
    words.only("name", *CONTROLLER_KEYS)
    words.need("name", "controller")
    return read_controller(words, rate_hz)


def write_controllers(path: Path, controllers: Sequence[Controller], notes: Mapping[str, Any] | None = None) -> None:
    """Write controllers whole; `notes` is any table worth keeping (where they come from, what was asked).

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
    loops = [{"name": controller.loop, **controller_table(controller)} for controller in controllers]
    write_toml(
        path,
        {"format": FORMAT, "rate_hz": rates[0], "notes": {"loopshape": __version__, **(notes or {})}, "loop": loops},
    )
