"""What a study file says of a real-time target, with rig = "target".

[target]
port = "/dev/ttyACM0"                 # or tcp://127.0.0.1:4000; --port on the command line wins
baud = 921600
on_limit = "vent"                     # or "hold"
watchdog_ms = 250
soft_start_s = 2.0                    # the loops close, and setpoints move, over at least that long
settle_s = 2.0                        # rest at an operating point before a recording
place = true                          # an emulated machine stands at the operating point at a recording's start

[target.commands]                     # each command as a sum of loops' z
u_a_v = { x = 1.0, p = 1.0 }
u_b_v = { x = -1.0, p = 1.0 }

[limits]                              # of every sensor and command by name without unit; the rate may be left out
x = { low_mm = -40.0, high_mm = 40.0, rate_mm_s = 800.0 }
u_a = { low_v = -4.0, high_v = 4.0 }
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from loopshape.core.errors import WrongUseError
from loopshape.core.units import to_stored
from loopshape.io.config_table import ConfigTable
from loopshape.io.schema import read
from loopshape.toolbox.rig.files.signals import KEY_UNITS
from loopshape.toolbox.rig.settings import Limit, TargetSettings
from loopshape.toolbox.rig.steps.escalation import Escalation


def read_target(words: ConfigTable) -> TargetSettings | None:
    """The settings, or None for a rig that is no target. Refuses unknown keys, units, and a target without limits."""
    if words.text("rig") != "target":
        if "target" in words.table:
            raise WrongUseError(f'{words.where}: only rig = "target" has target', words.text("rig"))
        return None
    words.need("target", "limits")
    inner = words.inner("target")
    limits = _limits(words, "limits")
    return read(TargetSettings, inner.table, inner.where, limits={one["column"]: one for one in limits})


def read_limits(words: ConfigTable) -> dict[str, Limit]:
    """The limits of a study by column; empty without."""
    return {one["column"]: Limit(**one) for one in _limits(words, "limits")}


def read_escalation(words: ConfigTable) -> Escalation | None:
    """The table `[escalate]` of a study, None without; its windows `travel` are written as limits are."""
    if "escalate" not in words.table:
        return None
    inner = words.inner("escalate")
    own = {key: value for key, value in inner.table.items() if key != "travel"}
    travel = {one["column"]: Limit(**one) for one in _limits(inner, "travel")}
    return replace(read(Escalation, own, inner.where), travel=travel)


def _limits(words: ConfigTable, key: str) -> list[dict[str, Any]]:
    inner = words.inner(key)
    return [_limit(name, inner.inner(name)) for name in inner.table]


def _limit(name: str, words: ConfigTable) -> dict[str, Any]:
    """Limits of one column: low_<unit>, high_<unit> and, if required, rate_<unit>_s, all in one unit."""
    unit = next((key.removeprefix("low_") for key in words.table if key.startswith("low_")), "")
    if unit not in KEY_UNITS:
        raise WrongUseError(
            f"{words.where}: a limit says low_ and high_ with their unit",
            ", ".join(words.table) or "nothing",
            f"units are {', '.join(KEY_UNITS)}",
        )
    low, high, rate = f"low_{unit}", f"high_{unit}", f"rate_{unit}_s"
    words.only(low, high, rate)
    suffix, factor = to_stored(KEY_UNITS[unit])
    made = {"low": factor * words.number(low), "high": factor * words.number(high)}
    return {"column": f"{name}_{suffix}", **made} | (
        {"rate": factor * words.number(rate)} if rate in words.table else {}
    )
