"""A schedule's table in files, to the noun and back."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import product
from typing import Any, ClassVar

from loopshape.core.errors import WrongUseError
from loopshape.data.control.controller import Controller
from loopshape.io.run.run_tables import CONTROLLER_KEYS, controller_table
from loopshape.io.schema import table_of
from loopshape.toolbox.schedules.gain_scheduled import LAG_S, GainScheduled, Variable


@dataclass(frozen=True)
class Node:
    """A node of a schedule: where it lies, and the controller there."""

    at: tuple[float, ...]
    controller: Controller


@dataclass(frozen=True)
class ScheduleTable:
    """A schedule's table: a controller in each node of a grid, in any order; their other keys stand once."""

    name: str
    over: tuple[Variable, ...]
    nodes: tuple[Node, ...]
    lag_s: float = LAG_S
    ALSO_READ: ClassVar = tuple(key for key in CONTROLLER_KEYS if key != "controller")

    @classmethod
    def unfolded(cls, table: Mapping[str, Any]) -> dict[str, Any]:
        """The table with whole controllers in its nodes."""
        own = dict(table)
        shared = {key: own.pop(key) for key in (*cls.ALSO_READ, "rate_hz") if key in own}
        shared |= {"name": own.get("name")}
        if isinstance(own["nodes"], list):
            own["nodes"] = [_whole(node, shared) for node in own["nodes"]]
        return own

    def made(self) -> GainScheduled:
        """The schedule, its controllers in the order of the grid."""
        placed = {node.at: node.controller for node in self.nodes}
        wanted = list(product(*(v.knots for v in self.over)))
        if set(placed) != set(wanted):
            odd = sorted(set(placed) ^ set(wanted))[0]
            raise WrongUseError(
                "the nodes of a schedule are all that its knots make, and no other",
                f"{'none' if odd in wanted else 'one'} at {', '.join(f'{x:g}' for x in odd)}",
                "write one controller for each",
            )
        return GainScheduled(self.name, self.over, tuple(placed[x] for x in wanted), self.lag_s)


def _whole(node: Any, shared: Mapping[str, Any]) -> Any:
    has = isinstance(node, dict) and "controller" in node
    return node | {"controller": {**shared, "controller": node["controller"]}} if has else node


def schedule_table(schedule: GainScheduled) -> dict[str, Any]:
    """The keys of a schedule beside the name of its loop."""
    shared = controller_table(schedule.controllers[0])
    del shared["controller"]
    nodes = zip(schedule.nodes, schedule.controllers, strict=True)
    return shared | {
        "lag_s": schedule.lag_s,
        "over": [table_of(v) for v in schedule.variables],
        "nodes": [
            {"at": list(at.values()), "controller": [block.to_table() for block in one.blocks]} for at, one in nodes
        ],
    }
