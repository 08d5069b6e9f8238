"""An experiment: everything that must be done to a rig to get one recording, and nothing about the rig."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from typing import Any

from loopshape.core.errors import WrongUseError, refuse_unknown
from loopshape.core.units import Array
from loopshape.data.control.controller import Controller
from loopshape.data.control.scheduled import Scheduled
from loopshape.data.signal.channel import Channel, sum_terms

KINDS = ("sweep", "multisine", "prbs", "noise", "staircase", "profile", "open_loop", "none")
INJECTIONS = ("controller_input", "plant_input", "reference", "control")
ROLES = ("estimation", "validation")


def refuse_unknown_words(whose: str, kind: str, injection: str, role: str) -> None:
    """Refuse a kind, an injection or a role that is none."""
    for what, word, known in (("kind", kind, KINDS), ("injection", injection, INJECTIONS), ("role", role, ROLES)):
        refuse_unknown(f"the {what} of {whose} is not known", word, known)


def shared_unit(expression: str, what: str) -> str:
    """Suffix of the unit of a column or a sum of columns; refuses columns without a known unit, or of several."""
    units = {Channel.from_column(column).unit for column in sum_terms(expression)}
    if len(units) != 1:
        raise WrongUseError(f"{what} adds different units", f"{expression!r}", "add columns of one unit")
    return units.pop()


@dataclass(frozen=True, eq=False)
class LoopSetup:
    """One loop of a rig: the columns of its signals, and the controller that closes it.

    Columns as in a run folder; `output` may be a sum of columns. Signs and places as drawn in
    `loop.loop`. Columns that a rig does not log are None. A `schedule` stands in place of the controller.
    `decoupling` are weights, by loop, of the controllers' outputs in what enters the plant here; empty for this loop's
    own alone, with weight 1. It counts as part of the plant: z is logged in front of it.
    """

    name: str
    reference: str | None
    injected: str | None
    control: str
    output: str
    controller: Controller | None
    schedule: Scheduled | None = None
    decoupling: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for column in (self.reference, self.injected, self.control, *sum_terms(self.output)):
            if column is not None:
                Channel.from_column(column)

    @property
    def output_unit(self) -> str:
        """Suffix of the output's unit; the terms of a sum must share it."""
        return shared_unit(self.output, f"the output of loop {self.name!r}")


@dataclass(frozen=True, eq=False, kw_only=True)
class ExperimentSettings:
    """What goes unchanged from a study's experiment to the experiment that is done and to what `run.toml` says of it.

    `parameters` are settings of the rig that hold for this one alone (a supply pressure, a load), in the plant's names.
    """

    parameters: Mapping[str, float] = field(default_factory=dict)

    def settings(self) -> dict[str, Any]:
        """These fields by name, as the next noun takes them."""
        return {f.name: getattr(self, f.name) for f in fields(ExperimentSettings)}


@dataclass(frozen=True, eq=False)
class Experiment(ExperimentSettings):
    """Setpoints and injected signals (n, loops) at `rate_hz`, in the unit of the place they act at.

    `injection` says where `injected` enters: the controller's input, the plant's input, or (`control`) as
    z itself with the loops open; with `reference` it is zero and the setpoints move. `start` is the
    operating point at which the plant rests at t = 0.
    `excites_also` are further loops excited at once with `excites`; refused without it, doubled, or no loops.
    """

    name: str
    kind: str
    loops: tuple[LoopSetup, ...]
    rate_hz: float
    references: Array
    injected: Array
    injection: str
    operating_point: Mapping[str, float]
    excites: str | None = None
    role: str = "estimation"
    closed_loop: bool = True
    period_s: float | None = None
    periodic_from_s: float | None = None
    seed: int = 0
    pwm: Mapping[str, float] = field(default_factory=dict)
    excites_also: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        refuse_unknown_words(f"experiment {self.name!r}", self.kind, self.injection, self.role)
        excited = [self.excites, *self.excites_also]
        known_loops = [loop.name for loop in self.loops]
        if self.excites_also and (len(set(excited)) < len(excited) or not set(excited) <= set(known_loops)):
            raise WrongUseError(
                f"experiment {self.name!r} excites each of its loops once at most, a first one and others",
                f"excites = {self.excites!r} and excites_also = {', '.join(self.excites_also)}",
                f"its loops are {', '.join(known_loops)}",
            )
        for name in ("references", "injected"):
            values = getattr(self, name)
            if values.ndim != 2 or values.shape[1] != len(self.loops):
                raise WrongUseError(
                    f"{name} of experiment {self.name!r} must be (samples, {len(self.loops)})",
                    f"{values.shape}",
                )
            if values.flags.writeable:
                values = values.copy()
                values.setflags(write=False)
                object.__setattr__(self, name, values)

    @property
    def samples(self) -> int:
        """Number of samples."""
        return int(self.references.shape[0])

    @property
    def duration_s(self) -> float:
        """Length in s."""
        return self.samples / self.rate_hz
