"""A rig without a model, as its study describes it: its loops, their columns and controllers. It can only be driven."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import NoReturn

from loopshape.core.errors import WrongUseError
from loopshape.core.units import UNITS
from loopshape.data.control.controller import Block, Controller
from loopshape.data.signal.channel import Channel, sum_terms
from loopshape.data.signal.experiment import Experiment, LoopSetup
from loopshape.toolbox.gap.nouns.plant import ParameterTable


class DescribedRig:
    """A machine behind a target. An operating point names each loop with a unit: `{ axis_deg = 10.0 }`."""

    name = "described by its study"
    solvers: tuple[str, ...] = ("edges",)
    parameters = ParameterTable(())

    def __init__(self, loops: Sequence[LoopSetup]) -> None:
        if not loops or any(loop.controller is None and loop.schedule is None for loop in loops):
            raise WrongUseError(
                "a study without a plant describes its loops",
                ", ".join(loop.name for loop in loops) or "no [[loop]]",
                "write [[loop]] with name, output, control and controller, or name a plant",
            )
        self._loops = tuple(_completed(loop) for loop in loops)
        self.loops: tuple[str, ...] = tuple(loop.name for loop in loops)
        columns = [c for loop in self._loops for c in (*sum_terms(loop.output), loop.control)]
        self.channels: tuple[Channel, ...] = tuple(Channel.from_column(column) for column in dict.fromkeys(columns))

    def default_controllers(self, rate_hz: float) -> tuple[Controller, ...]:
        """The study's own."""
        return tuple(Controller(loop.name, _blocks(loop), rate_hz) for loop in self._loops)

    def loop_setups(self, controllers: Sequence[Controller], injection: str) -> tuple[LoopSetup, ...]:
        """The loops with these controllers alone; what enters at the plant's input is in the control's unit."""
        by_name = {c.loop: c for c in controllers}
        return tuple(
            replace(
                loop,
                controller=by_name[loop.name],
                schedule=None,
                injected=_injected(loop, injection == "plant_input"),
            )
            for loop in self._loops
        )

    def setpoint(self, operating_point: Mapping[str, float]) -> tuple[float, ...]:
        """The references of all loops in stored units."""
        given = {self._loop_of(key): _stored(key, value) for key, value in operating_point.items()}
        return tuple(given[name] for name in self.loops)

    def _loop_of(self, key: str) -> str:
        return next((name for name in self.loops if key.startswith(name + "_")), key)

    def check_operating_point(
        self, operating_point: Mapping[str, float], changes: Mapping[str, float] | None = None
    ) -> None:
        """Refuse a point that does not name each loop once, in a unit of its output."""
        named = [self._loop_of(key) for key in operating_point]
        if sorted(named) != sorted(self.loops):
            raise WrongUseError(
                "an operating point names each loop once, with a unit",
                ", ".join(operating_point) or "nothing",
                f"loops are {', '.join(self.loops)}",
            )
        for loop in self._loops:
            key = next(k for k in operating_point if self._loop_of(k) == loop.name)
            if _unit(key)[0] != loop.output_unit:
                raise WrongUseError(f"{key} has another unit than the loop's output", loop.output)

    def check_settings(self, rate_hz: float, changes: Mapping[str, float]) -> None:
        """Refuse changes of parameters: this machine has none that are known."""
        if other := [name for name in changes if not name.startswith("pwm_")]:
            raise WrongUseError("a rig without a plant has no parameters", ", ".join(other), "name a plant")

    def simulate(
        self,
        experiments: Sequence[Experiment],
        *,
        solver: str = "edges",
        changes: Mapping[str, float] | None = None,
        threads: int | None = None,
        states: bool = False,
    ) -> NoReturn:
        """There is no model to simulate."""
        raise WrongUseError("a study without a plant cannot be simulated", self.name, "name a plant")


def _completed(loop: LoopSetup) -> LoopSetup:
    return replace(loop, reference=loop.reference or f"r_{loop.name}_{loop.output_unit}", injected=None)


def _injected(loop: LoopSetup, at_plant: bool) -> str:
    unit = Channel.from_column(loop.control).unit if at_plant else loop.output_unit
    return f"n_{loop.name}_{unit}"


def _blocks(loop: LoopSetup) -> tuple[Block, ...]:
    """Of its controller, or of a schedule's first node: the study puts its schedules in place afterwards."""
    one = loop.controller or (loop.schedule and loop.schedule.controllers[0])
    return one.blocks if one else ()


def _unit(key: str) -> tuple[str, float]:
    """Suffix and factor of the unit that a key ends in, such as `_deg`; refuses one that is not known."""
    word = key.rpartition("_")[2]
    found = {name.lower(): unit for name, unit in UNITS.items()}.get(word)
    if found is None:
        raise WrongUseError("an operating point says its unit", repr(key), "end it in _deg, _rad, _bar, _mm, ...")
    return found


def _stored(key: str, value: float) -> float:
    return value * _unit(key)[1]
