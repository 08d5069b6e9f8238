"""A user's machine: a simulator with named parameters, inputs, outputs and places where forces act.

The simulator is an ODE right-hand side `motion(t, x, u, p)`: time in s, states x (nx,), inputs u (nu,), parameters p by
name (`p.mass`), to the nx derivatives. Effects are composed around it and never inside it.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any, ClassVar

from loopshape.core.errors import WrongUseError, refuse_unknown
from loopshape.core.gate import Positive, pass_fields
from loopshape.data.signal.channel import unit_of

NO_EFFECT = "none"
#: an effect that moves the outputs by less than this share of their motion within a window does not matter
MATTERS = 0.01
LAW = ("kp", "ki", "kd")  # of a motor's firmware: with one of them its command is a position


@dataclass(frozen=True)
class ModelParameter:
    """One number of the simulator: `tolerance` is its manufacturing tolerance, as a share of the value.

    `effect` names what a value beyond the tolerance means, as `kind@place` ("payload@arm"); "none" makes it no
    hypothesis. A parameter whose nominal value is 0 (a payload, a tilt) needs the `range` in which to look for it;
    `range` is of changes. `shaped_by` names a parameter that may change with it (where on the arm the payload sits).
    `starts` are changes from which to look, where near the nominal value nothing depends on it.
    """

    name: str
    value: float
    unit: str = "1"
    tolerance: float = 0.0
    effect: str = ""
    range: tuple[float, float] | None = None
    shaped_by: str = ""
    starts: tuple[float, ...] = ()
    READS: ClassVar = ("name", "value", "unit", "tolerance", "effect", "range", "shaped_by")

    def __post_init__(self) -> None:
        pass_fields(self)
        if self.range is not None and not self.range[0] < self.range[1]:
            raise WrongUseError(f"the range of {self.name} is two rising numbers", f"{list(self.range)}")
        if not self.effect:
            object.__setattr__(self, "effect", f"parameter_error@{self.name}")
        if not 0.0 <= self.tolerance < 1.0:
            raise WrongUseError(f"the tolerance of {self.name} is a share from 0 to 1", f"{self.tolerance:g}")
        if self.effect != NO_EFFECT and self.value == 0.0 and self.range is None:
            raise WrongUseError(
                f"parameter {self.name} is 0, so nothing tells how far it may be off", "no range",
                'give range = [low, high], or effect = "none"',
            )  # fmt: skip


@dataclass(frozen=True)
class Input:
    """What drives the simulator, and the recorded column: input = `factor` * column; `tolerance` is that of its gain.

    Without a column it is 0 in every recording: a place where effects alone act. One that `schedules` is a setting of
    the machine (a gain, a payload, a mode): it has no actuator, so no delay, no limit and no sign of its own. A column
    that is constant in every recording, where no port acts, is taken for one. Beyond `limits` it is the limit.
    `without` names kinds of effects that it cannot have, as a position to go to has no dead zone.
    """

    name: str
    column: str | None = None
    factor: float = 1.0
    tolerance: float = 0.0
    unit: str = ""
    schedules: bool = False
    limits: tuple[float, float] | None = None
    without: tuple[str, ...] = ()
    READS: ClassVar = ("name", "column", "factor", "tolerance", "unit", "schedules")

    def __post_init__(self) -> None:
        pass_fields(self)
        if self.schedules and self.column is None:
            raise WrongUseError(f"input {self.name} schedules, so its values are recorded", "no column", "name it")

    @property
    def acts(self) -> bool:
        """Whether an actuator gives what is recorded."""
        return self.column is not None and not self.schedules


@dataclass(frozen=True)
class Output:
    """A state that a sensor reads, and the recorded column: output = `factor` * column + `offset`.

    `leaves` is the rms, in the output's unit and within a window, that a good model of this machine leaves; None where
    that is not known.
    """

    name: str
    state: str
    column: str
    factor: float = 1.0
    unit: str = ""
    offset: float = 0.0
    leaves: Positive | None = None

    def __post_init__(self) -> None:
        pass_fields(self)
        if self.leaves is not None and not 0.0 < self.leaves < math.inf:
            raise WrongUseError(
                f"leaves of output {self.name} is the rms that a good model leaves, a finite number above 0",
                f"{self.leaves:g}", "give it in the unit of the output, or leave it out",
            )  # fmt: skip


def is_angle(output: Output) -> bool:
    """Whether an output is an angle in rad, by its unit or its column's name."""
    return output.unit == "rad" or unit_of(output.column) in ("rad", "deg")


@dataclass(frozen=True)
class Port:
    """A place where a force acts: it is added to `input`, and depends on the states `position` and `speed`.

    With the name of the parameter that is the inertia on the motor's side (`motor_inertia`), a flexible coupling and
    play between motor and load can be tried here as well; `motor_damping` is the damping that may be on that side.
    """

    name: str
    input: str
    position: str
    speed: str
    motor_inertia: str | None = None
    unit: str = ""
    motor_damping: str | None = None


@dataclass(frozen=True, eq=False)
class Kind:
    """A user's own kind of effect at a port: `force(q, v, n)` acts against the motion, n in the order of `numbers`.

    The first number is the magnitude, 0 where there is no effect, with the range in which to look for it; the second
    may change with it, the others stay as they are.
    """

    name: str
    port: str
    force: Callable[..., Any]
    numbers: tuple[ModelParameter, ...]

    def __post_init__(self) -> None:
        object.__setattr__(self, "numbers", tuple(self.numbers))
        if not self.numbers or self.numbers[0].value != 0.0:
            raise WrongUseError(f"the first number of kind {self.name} is its magnitude, 0 where there is none", "none")


@dataclass(frozen=True, eq=False)
class Model:
    """A simulator, what it is fed with, and what it gives; see `docs/machine.md`.

    `window_s` is how long the simulation is left to itself before it is set to the recording again; None where the
    recordings are to tell. `without` names kinds of effects that this machine cannot have. `derived` makes of the
    parameters' values, in order, what `motion` gets as p; without it p has the parameters by name. `kinds` are effects
    of the user's own. `law(j, q, v, x, u, p)` is the effort that an actuator's law within `motion` gives at port j, at
    a position and speed: what a coupling there moves to the motor. `matters` is the share of the motion within a window
    that an effect has to move, or it is no answer.
    """

    name: str
    motion: Callable[..., Any]
    states: tuple[str, ...]
    parameters: tuple[ModelParameter, ...]
    inputs: tuple[Input, ...]
    outputs: tuple[Output, ...]
    ports: tuple[Port, ...] = ()
    window_s: float | None = None
    without: tuple[str, ...] = field(default=())
    derived: Callable[[tuple[float, ...]], Any] | None = None
    kinds: tuple[Kind, ...] = ()
    matters: float = MATTERS
    law: Callable[..., Any] | None = None

    def __post_init__(self) -> None:
        for name in ("states", "parameters", "inputs", "outputs", "ports", "without"):
            object.__setattr__(self, name, tuple(getattr(self, name)))
        if not (self.states and self.inputs and self.outputs):
            raise WrongUseError("a model has states, inputs and outputs", f"{self.name}: one of them is empty")
        if self.window_s is not None and not self.window_s > 0.0:
            raise WrongUseError("window_s is a time above 0", f"{self.window_s:g}")
        if self.window_s is None and (known := [o.name for o in self.outputs if o.leaves is not None]):
            raise WrongUseError(
                f"leaves of output {known[0]} is what a good model leaves within a window of known length",
                "no window_s", "give window_s",
            )  # fmt: skip
        if not 0.0 <= self.matters < 1.0:
            raise WrongUseError("matters is a share of the motion from 0 to 1", f"{self.matters:g}")
        self._names()
        self._references()

    def _names(self) -> None:
        for what in ("parameters", "inputs", "outputs", "ports"):
            _once([one.name for one in getattr(self, what)], f"{what} of {self.name}")
        _once(self.states, f"states of {self.name}")

    def _references(self) -> None:
        for p in self.parameters:
            _known(p.shaped_by or p.name, [o.name for o in self.parameters], f"parameter that shapes {p.name}")
        for port in self.ports:
            _known(port.input, [i.name for i in self.inputs], f"input of port {port.name}")
            if any(i.schedules for i in self.inputs if i.name == port.input):
                raise WrongUseError(
                    f"a force acts at the input of port {port.name}", f"{port.input} schedules",
                    "give the port an input that is a force, or leave schedules out",
                )  # fmt: skip
            for state in (port.position, port.speed):
                _known(state, self.states, f"state of port {port.name}")
            for key in ("motor_inertia", "motor_damping"):
                if (named := getattr(port, key)) is not None:
                    _known(named, [p.name for p in self.parameters], f"{key} of port {port.name}")
        for output in self.outputs:
            _known(output.state, self.states, f"state of output {output.name}")

    @property
    def columns(self) -> tuple[str, ...]:
        """Columns of a recording that are needed."""
        return tuple(i.column for i in self.inputs if i.column) + tuple(o.column for o in self.outputs)

    def values(self) -> dict[str, float]:
        """Nominal values by name."""
        return {p.name: p.value for p in self.parameters}

    def __repr__(self) -> str:
        """One line: its name and what it has."""
        parts = ", ".join(f"{len(getattr(self, k))} {k}" for k in ("states", "parameters", "inputs", "outputs"))
        return f"Model {self.name}: {parts}, force ports {', '.join(p.name for p in self.ports) or 'none'}"


@dataclass(frozen=True, eq=False)
class Mechanism:
    """A MuJoCo model and what belongs to it: an `MjSpec`, tolerances by kind and name, columns and factors by name, of
    sensors offsets, and what a good model leaves, too.

    Kinds of `spread`: mass (of a body), damping, armature and frictionloss (of a joint), motor_constant (of an
    actuator). A joint may stand in `actuators`, an effort then, and in `sensors`, its position, with `_speed` behind it
    its speed. `motors` are DC motors by numbers, by joint: resistance in ohm, torque_constant in N m/A, and back_emf in
    V s/rad, gear, voltage of the supply, kp, ki, kd in V/rad of the joint where they have them.
    """

    name: str
    spec: Any
    spread: Mapping[str, Mapping[str, float]]
    actuators: Mapping[str, tuple[str, float]]
    sensors: Mapping[str, tuple[str, float] | tuple[str, float, float] | tuple[str, float, float, float | None]]
    window_s: float | None = None
    without: tuple[str, ...] = ()
    kinds: tuple[Kind, ...] = ()
    matters: float = MATTERS
    motors: Mapping[str, Mapping[str, float]] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Unit:
    """An FMU for model exchange, unpacked into `folder`, with its `description` as FMPy reads it.

    Inputs, parameters, and the states that outputs and ports name are the FMU's variables.
    """

    name: str
    folder: str
    description: Any
    parameters: tuple[ModelParameter, ...]
    inputs: tuple[Input, ...]
    outputs: tuple[Output, ...]
    ports: tuple[Port, ...] = ()
    window_s: float | None = None
    without: tuple[str, ...] = ()
    kinds: tuple[Kind, ...] = ()
    matters: float = MATTERS


def _once(names: Iterable[str], what: str) -> None:
    if double := [name for name, count in Counter(names).items() if count > 1]:
        raise WrongUseError(f"{what} have different names", f"{double[0]!r} twice")


def _known(name: str, known: Iterable[str], what: str) -> None:
    refuse_unknown(f"the {what} is not known", name, known, "use one of")
