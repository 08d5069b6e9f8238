"""A servo axis as a machine: rotary or linear, with a spring, gravity, and perhaps a load with a sensor of its own.

```
 effort -> inertia -- coupling -- load_inertia        each with damping; spring and gravity act on the load,
           position               load_position       without a coupling on the one body
```
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from loopshape.core.errors import WrongUseError, refuse_unknown_keys
from loopshape.toolbox.gap.nouns.machine import NO_EFFECT, Input, Model, ModelParameter, Output, Port

#: unit of a rotary and of a linear axis, manufacturing tolerance, what a value beyond it means; "" is an error of it
NUMBERS: dict[str, tuple[str, str, float, str]] = {
    "inertia": ("kg m2", "kg", 0.05, NO_EFFECT),
    "damping": ("N m s/rad", "N s/m", 0.20, "viscous_error@axis"),
    "spring": ("N m/rad", "N/m", 0.05, ""),
    "gravity": ("N m", "N", 0.05, ""),
    "hangs_at": ("rad", "m", 0.0, NO_EFFECT),
    "motor_inertia": ("kg m2", "kg", 0.05, NO_EFFECT),
    "load_inertia": ("kg m2", "kg", 0.05, NO_EFFECT),
    "load_damping": ("N m s/rad", "N s/m", 0.20, "viscous_error@load"),
    "coupling_stiffness": ("N m/rad", "N/m", 0.05, ""),
    "coupling_damping": ("N m s/rad", "N s/m", 0.30, NO_EFFECT),
}
NEEDED = ("inertia", "damping")
OF_A_LOAD = ("load_inertia", "coupling_stiffness")
Number = float | tuple[float, float]


def axis(
    numbers: Mapping[str, Number],
    effort: str | Input,
    position: str | Output,
    load_position: str | Output | None = None,
    *,
    rotary: bool = True,
    window_s: float | None = None,
    name: str = "axis",
) -> Model:
    """A servo axis for `gap`, from its numbers and the columns of its recordings.

    `numbers` are values, or (value, tolerance as a share), by name: inertia and damping at least; spring; gravity (the
    torque in N m with the arm level, of an arm that hangs down at `hangs_at`; of a linear axis the weight in N);
    motor_inertia, the part of a single body that sits on the motor's side of a coupling that may be flexible;
    load_inertia, load_damping, coupling_stiffness and coupling_damping of a load behind a coupling, in the units of the
    motor's side. SI of rad, or of m where `rotary` is false. `effort`, `position` and `load_position` are columns, or
    an `Input` and an `Output` each, with factors. A payload is looked for in kg m2 (kg of a linear axis) on the last
    body. What else a `Model` states, as `without` and `matters`, is set by `dataclasses.replace`.

    Refuses unknown names, missing ones, and a load's sensor without a load. Misleads where the gear's ratio is not in
    the factors.

    >>> import loopshape as ls
    >>> numbers = {"inertia": 0.02, "damping": (0.05, 0.1), "gravity": 0.3}
    >>> ls.gap.axis(numbers, "torque_nm", "arm_rad")
    Model axis: 2 states, 7 parameters, 1 inputs, 1 outputs, force ports axis
    """
    _suitable(numbers, load_position is not None)
    two = "load_inertia" in numbers
    places = [("axis", "position", "speed")] + [("load", "load_position", "load_speed")] * two
    unit = "N m" if rotary else "N"
    inputs = [_input(effort, unit)] + [Input("load", unit=unit)] * two
    outputs = [_output("encoder", position, "position", rotary)]
    if load_position is not None:
        outputs.append(_output("load_encoder", load_position, "load_position", rotary))
    motor = "motor_inertia" if "motor_inertia" in numbers else None
    ports = [
        Port(at, drive.name, q, v, None if two else motor, unit)
        for (at, q, v), drive in zip(places, inputs, strict=True)
    ]
    return Model(
        name=name,
        motion=_MOTIONS[two, rotary],
        states=tuple(s for _, q, v in places for s in (q, v)),
        parameters=_parameters(numbers, rotary, two),
        inputs=tuple(inputs),
        outputs=tuple(outputs),
        ports=tuple(ports),
        window_s=window_s,
    )


def _suitable(numbers: Mapping[str, Number], has_sensor: bool) -> None:
    refuse_unknown_keys("a number of the axis is not known", numbers, NUMBERS)
    two = has_sensor or any(name.startswith(("load_", "coupling_")) for name in numbers)
    if missing := [name for name in (*NEEDED, *(OF_A_LOAD if two else ())) if name not in numbers]:
        what = "an axis with a load behind a coupling" if two else "an axis"
        raise WrongUseError(f"{what} has {', '.join((*NEEDED, *(OF_A_LOAD if two else ())))}", f"no {missing[0]}")
    if two and "motor_inertia" in numbers:
        raise WrongUseError(
            "motor_inertia is a part of a single body", "an axis with a load", "give it as the axis' inertia"
        )


def _parameters(numbers: Mapping[str, Number], rotary: bool, two: bool) -> tuple[ModelParameter, ...]:
    """Every number that the equations use; one that is not given is 0 and no hypothesis. The payload is the last."""
    own = [n for n in NUMBERS if two or not n.startswith(("load_", "coupling_"))]
    made = [_parameter(n, numbers.get(n, 0.0), NUMBERS[n], rotary) for n in own if not (two and n == "motor_inertia")]
    last = next(p.value for p in made if p.name == ("load_inertia" if two else "inertia"))
    most = last + sum(p.value for p in made if p.name == "motor_inertia")
    at, unit = "load" if two else "axis", "kg m2" if rotary else "kg"
    payload = ModelParameter("payload", 0.0, unit, effect=f"payload@{at}", range=(-0.5 * last, 2.0 * most))
    return (*made, payload)


def _parameter(name: str, given: Number, row: tuple[str, str, float, str], rotary: bool) -> ModelParameter:
    unit, linear, tolerance, effect = row
    value, share = given if isinstance(given, tuple) else (given, tolerance)
    return ModelParameter(name, value, unit if rotary else linear, share, effect if value else NO_EFFECT)


def _input(effort: str | Input, unit: str) -> Input:
    return replace(effort if isinstance(effort, Input) else Input("drive", effort), unit=unit)


def _output(name: str, given: str | Output, state: str, rotary: bool) -> Output:
    own = given if isinstance(given, Output) else Output(name, state, given)
    return replace(own, state=state, unit="rad" if rotary else "m")


def _one_rotary(t, x, u, p):  # type: ignore[no-untyped-def]
    pull = p.spring * x[0] + p.gravity * np.sin(x[0] - p.hangs_at)
    return x[1], (u[0] - p.damping * x[1] - pull) / (p.inertia + p.motor_inertia + p.payload)


def _one_linear(t, x, u, p):  # type: ignore[no-untyped-def]
    pull = p.spring * x[0] + p.gravity
    return x[1], (u[0] - p.damping * x[1] - pull) / (p.inertia + p.motor_inertia + p.payload)


def _two_rotary(t, x, u, p):  # type: ignore[no-untyped-def]
    through = p.coupling_stiffness * (x[0] - x[2]) + p.coupling_damping * (x[1] - x[3])
    pull = p.spring * x[2] + p.gravity * np.sin(x[2] - p.hangs_at)
    motor = (u[0] - p.damping * x[1] - through) / p.inertia
    return x[1], motor, x[3], (u[1] + through - p.load_damping * x[3] - pull) / (p.load_inertia + p.payload)


def _two_linear(t, x, u, p):  # type: ignore[no-untyped-def]
    through = p.coupling_stiffness * (x[0] - x[2]) + p.coupling_damping * (x[1] - x[3])
    pull = p.spring * x[2] + p.gravity
    motor = (u[0] - p.damping * x[1] - through) / p.inertia
    return x[1], motor, x[3], (u[1] + through - p.load_damping * x[3] - pull) / (p.load_inertia + p.payload)


_MOTIONS: dict[tuple[bool, bool], Callable[..., Any]] = {
    (False, True): _one_rotary,
    (False, False): _one_linear,
    (True, True): _two_rotary,
    (True, False): _two_linear,
}
