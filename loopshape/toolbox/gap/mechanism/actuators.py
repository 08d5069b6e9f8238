"""Actuators of a mechanism: efforts at joints in proportion to command, position and speed, clamped, behind a state.

effort = clip((g0 + g1 q + g2 v) c + b0 + b1 q + b2 v + i a) + d v at a joint of position q and speed v: c is the
command, or the state a that it moves (MuJoCo's documentation, Computation, Actuation model), i the gain of a firmware's
integral of the error, d the back-EMF of a motor, which no clamp of its voltage holds. Numbers are on the joint's side.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum, auto
from functools import cached_property
from typing import Any

import numpy as np

from loopshape.core.errors import WrongUseError
from loopshape.toolbox.gap.mechanism.numbers import ARMATURE, DAMPING, GAIN, LIMIT, PROPORTIONAL, Numbers, first
from loopshape.toolbox.gap.mechanism.tracing import Row, Scalar, Tape
from loopshape.toolbox.gap.nouns.machine import LAW, Input, ModelParameter, Port

SPEED, ACTIVATION, EFFORT = "_speed", "_activation", "_effort"
_NOT_OF_A_COMMAND = ("actuator_saturation", "dead_zone")  # a voltage has them; a position to go to has not
_JOINT, _AFFINE = (0, 1), (0, 1)  # mjTRN_JOINT and its twin; kinds of gain and bias up to affine


class Dynamics(Enum):
    """What moves the state of an actuator."""

    NONE = auto()
    INTEGRATOR = auto()
    FILTER = auto()
    ERROR = auto()


_DYNAMICS = {0: Dynamics.NONE, 1: Dynamics.INTEGRATOR, 2: Dynamics.FILTER, 3: Dynamics.FILTER}


@dataclass(frozen=True)
class Actuator:
    """An actuator at a joint, the `row` of its numbers; `is_direct` where its effort is a gain times the command."""

    name: str
    joint: str
    row: int
    dynamics: Dynamics
    is_direct: bool
    unit: str
    limits: tuple[float, float] | None = None
    bounds: tuple[float, float] | None = None


@dataclass(frozen=True, eq=False)
class Actuators:
    """The actuators of a mechanism as inputs, ports, parameters and terms of the equations of motion."""

    numbers: Numbers

    def check(self) -> None:
        """Refuse by name what acts otherwise than at a joint, or by other than affine gains."""
        m = self.numbers.nominal
        for k in range(self.numbers.driven):
            name, way = m.actuator(k).name, "log its effort and replace it by <motor joint=...>"
            what = f"actuator {name} of {self.numbers.of.name} acts at a joint in proportion to command and motion"
            if m.actuator_trntype[k] not in _JOINT:
                kind = word("Trn", m.actuator_trntype[k])
                raise WrongUseError(what, f"one at a {kind}{self._target(k, kind)}", way)
            for key, known in (("Dyn", _DYNAMICS), ("Gain", _AFFINE), ("Bias", _AFFINE)):
                value = int(getattr(m, f"actuator_{key.lower()}type")[k])
                if value not in known:
                    numbers = " (numbers of a DC motor may stand in model.toml)" * (word(key, value) == "dcmotor")
                    raise WrongUseError(what, f"{key.lower()}type {word(key, value)}", way + numbers)
            if m.actuator_plugin[k] >= 0:
                raise WrongUseError(what, "a plugin", way)
            for key in ("armature", "damping", "delay"):  # of MuJoCo 4
                if np.max(getattr(m, f"actuator_{key}", np.zeros(k + 1))[k]) > 0.0:
                    raise WrongUseError(what, f"{key} of its own", f"give the {key} to the joint, or leave it out")

    def _target(self, k: int, kind: str) -> str:
        m, at = self.numbers.nominal, int(self.numbers.nominal.actuator_trnid[k, 0])
        return f" {getattr(m, kind)(at).name}" if kind in ("tendon", "site", "body") else ""

    @cached_property
    def all(self) -> list[Actuator]:
        """In the order of MuJoCo's, motors by numbers behind."""
        m, own = self.numbers.nominal, self.numbers
        joints = [m.joint(int(m.actuator_trnid[k, 0])).name for k in range(own.driven)]
        of_mujoco = [self._of_mujoco(k, [*joints, *own.of.motors]) for k in range(own.driven)]
        return [*of_mujoco, *(self._of_numbers(row, joint) for row, joint in enumerate(own.of.motors, own.driven))]

    def _of_numbers(self, row: int, joint: str) -> Actuator:
        """A motor that stands in model.toml: its command is a voltage, or with a PID law a position."""
        n = self.numbers.of.motors[joint]
        ki, volts = n.get("ki", 0.0), n.get("voltage", 0.0)
        ends = (-volts, volts) if volts else None
        if not any(key in n for key in LAW):
            return Actuator(joint, joint, row, Dynamics.NONE, False, "V", ends)
        bounds = (-volts / abs(ki), volts / abs(ki)) if ki and volts else None
        dynamics = Dynamics.ERROR if ki else Dynamics.NONE
        return Actuator(joint, joint, row, dynamics, False, self.numbers.unit(joint)[0], None, bounds)

    def _of_mujoco(self, k: int, joints: list[str]) -> Actuator:
        m, joint = self.numbers.nominal, joints[k]
        gain, bias = (self.numbers.efforts(m)[name][k] for name in ("gain", "bias"))
        dynamics = _DYNAMICS[int(m.actuator_dyntype[k])]
        is_plain = dynamics is Dynamics.NONE and not np.any(gain[1:]) and not np.any(bias)
        is_alone = not m.jnt_actfrclimited[m.joint(joint).id] or joints.count(joint) == 1
        limits = tuple(m.actuator_ctrlrange[k].tolist()) if self._is_clamped(k) else None
        if is_plain and is_alone:
            limits = self._effort_limits(k, joint, gain[0], limits)
            return Actuator(m.actuator(k).name, joint, k, dynamics, True, self.numbers.unit(joint)[1], limits)
        position, effort = self.numbers.unit(joint)
        unit = position if bias[1] else f"{position}/s" if bias[2] else effort if gain[0] == 1.0 else ""
        unit += "/s" * (dynamics is Dynamics.INTEGRATOR)
        bounds = tuple(m.actuator_actrange[k].tolist()) if m.actuator_actlimited[k] else None
        return Actuator(m.actuator(k).name, joint, k, dynamics, False, unit, limits, bounds)

    def _is_clamped(self, k: int) -> bool:
        import mujoco

        m = self.numbers.nominal
        return bool(m.actuator_ctrllimited[k]) and not m.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_CLAMPCTRL

    def _effort_limits(self, k: int, joint: str, gain: float, command: Any) -> tuple[float, float] | None:
        """Ends of the effort of a motor from every clamp that it has."""
        m, numbers = self.numbers.nominal, self.numbers.efforts(self.numbers.nominal)
        ends = [np.sort(gain * np.array(command))] if command else []
        ends += [numbers["force"][k]] if m.actuator_forcelimited[k] else []
        ends += [numbers["together"][m.joint(joint).id]] if m.jnt_actfrclimited[m.joint(joint).id] else []
        return (float(max(e[0] for e in ends)), float(min(e[1] for e in ends))) if ends else None

    @cached_property
    def servos(self) -> list[Actuator]:
        """Those whose command is no effort."""
        return [a for a in self.all if not a.is_direct]

    @cached_property
    def states(self) -> dict[str, str]:
        """State by actuator that has one."""
        return {a.name: a.name + ACTIVATION for a in self.servos if a.dynamics is not Dynamics.NONE}

    def parameters(self) -> list[ModelParameter]:
        """Of actuators whose command is no effort: shares of the whole gain and of kp beside kv, the largest effort."""
        out, bias = [], self.numbers.efforts(self.numbers.nominal)["bias"]
        # shares by which a limit may be lower: one that is not met moves nothing
        lower = (0.2, 0.4, 0.6, 0.8)
        for a in self.servos:
            share, most = self._tolerance(a), self.numbers.most(a.row)
            effect = f"actuator_gain_error@{a.name}"
            out.append(ModelParameter(f"{GAIN}_{a.name}", 1.0, "1", share, effect))
            if bias[a.row, 1] and bias[a.row, 2]:
                out.append(ModelParameter(f"{PROPORTIONAL}_{a.name}", 1.0, "1", 0.0, effect))
            if most > 0.0:
                starts = tuple(-share * most for share in lower)
                out.append(ModelParameter(
                    f"{LIMIT}_{a.name}", most, self.numbers.unit(a.joint)[1], 0.0, f"actuator_saturation@{a.name}",
                    (-0.95 * most, most), starts=starts,
                ))  # fmt: skip
        return out

    def _tolerance(self, a: Actuator) -> float:
        return self.numbers.of.spread.get("motor_constant", {}).get(a.name, 0.0)

    def inputs(self) -> tuple[Input, ...]:
        """One an actuator, and one a joint without a motor whose command is an effort: there effects alone act."""
        own, numbers = self.numbers.of, self.numbers.efforts(self.numbers.nominal)
        out = []
        for a in self.all:
            column, factor = own.actuators.get(a.name, (None, 1.0))
            if a.is_direct:
                gain = float(numbers["gain"][a.row, 0]) * factor
                out.append(Input(a.name, column, gain, self._tolerance(a), a.unit, limits=a.limits))
            else:
                lacks = _NOT_OF_A_COMMAND if np.any(numbers["bias"][a.row]) else ()
                out.append(Input(a.name, column, factor, 0.0, a.unit, limits=a.limits, without=lacks))
        out += [Input(name, unit=self.numbers.unit(j)[1]) for j, name in self._idle.items()]
        return tuple(out)

    @cached_property
    def _idle(self) -> dict[str, str]:
        """Input of the effort at each joint without a motor whose command is one."""
        driven, direct = {a.joint for a in self.all}, {a.joint for a in self.all if a.is_direct}
        return {j: j + EFFORT if j in driven else j for j in self.numbers.joints if j not in direct}

    def acting(self, joint: str) -> list[str]:
        """Inputs that are efforts at a joint."""
        return [a.name for a in self.all if a.is_direct and a.joint == joint] or [self._idle[joint]]

    def ports(self) -> tuple[Port, ...]:
        """One a joint: a coupling between motor and link where actuators with a rotor drive it.

        Not beside a motor whose effort is an input of its own, nor where a firmware integrates the error: at the load.
        """
        out = []
        for joint in self.numbers.joints:
            drives = {a.is_direct for a in self.all if a.joint == joint and a.dynamics is not Dynamics.ERROR}
            alike = len(drives) == 1 and all(a.dynamics is not Dynamics.ERROR for a in self.all if a.joint == joint)
            rotor = first(self.numbers.nominal.joint(joint).armature) > 0.0 and alike
            inertia, damping = (f"{ARMATURE}_{joint}", f"{DAMPING}_{joint}") if rotor else (None, None)
            unit = self.numbers.unit(joint)[1]
            out.append(Port(joint, self.acting(joint)[0], joint, joint + SPEED, inertia, unit, damping))
        return tuple(out)

    def written(self, n: Mapping[str, Any], tape: Tape) -> tuple[Row, Row]:
        """Effort at each joint, and the derivative of each actuator's state, as terms of states and inputs."""
        joints, (u, state) = self.numbers.joints, self._known(tape)
        q, v = ({j: tape.name(f"x[{k + first}]") for k, j in enumerate(joints)} for first in (0, len(joints)))
        efforts: Row = [
            sum([*(u[name] for name in self.acting(j)), self._law(j, n, (q[j], v[j]), tape)], 0.0) for j in joints
        ]
        stated = [a for a in self.servos if a.name in state]
        return efforts, [_rate(a, n, q[a.joint], u[a.name], state[a.name], tape) for a in stated]

    def laws(self, n: Mapping[str, Any], tape: Tape) -> dict[int, Scalar]:
        """Effort that laws give at each joint that they drive, at a position q and a speed v."""
        at, driven = (tape.name("q"), tape.name("v")), {a.joint for a in self.servos}
        return {k: self._law(j, n, at, tape) for k, j in enumerate(self.numbers.joints) if j in driven}

    def _known(self, tape: Tape) -> tuple[dict[str, Scalar], dict[str, Scalar]]:
        """Inputs, and states of actuators, by name."""
        first = 2 * len(self.numbers.joints)
        u = {i.name: tape.name(f"u[{k}]") for k, i in enumerate(self.inputs())}
        return u, {name: tape.name(f"x[{first + k}]") for k, name in enumerate(self.states)}

    def _law(self, joint: str, n: Mapping[str, Any], at: tuple[Scalar, Scalar], tape: Tape) -> Scalar:
        """Effort of the actuators at a joint whose command is none."""
        (u, state), k = self._known(tape), self.numbers.joints.index(joint)
        own = [self._effort(a, n, at, u[a.name], state.get(a.name), tape) for a in self.servos if a.joint == joint]
        if own and self.numbers.nominal.jnt_actfrclimited[k]:
            return _clamped(tape, sum(own, 0.0), *n["together"][k])
        return sum(own, 0.0)

    def _effort(
        self, a: Actuator, n: Mapping[str, Any], at: tuple[Scalar, Scalar], command: Scalar, state: Scalar, tape: Tape
    ) -> Scalar:
        gain, bias = (row[0] + row[1] * at[0] + row[2] * at[1] for row in (n["gain"][a.row], n["bias"][a.row]))
        c = command if state is None or a.dynamics is Dynamics.ERROR else state
        force = gain * c + bias
        if a.dynamics is Dynamics.ERROR:
            force = force + n["integral"][a.row] * state
        if self.numbers.most(a.row) > 0.0:
            force = _clamped(tape, force, *n["force"][a.row])
        return force + n["back"][a.row] * at[1]


def _rate(a: Actuator, n: Mapping[str, Any], q: Scalar, command: Scalar, state: Scalar, tape: Tape) -> Scalar:
    """Derivative of an actuator's state; none that leads out of its bounds."""
    if a.dynamics is Dynamics.INTEGRATOR:
        rate = command
    elif a.dynamics is Dynamics.ERROR:
        rate = command - q
    else:
        rate = (command - state) / n["tau"][a.row]
    if a.bounds is None:
        return rate
    s, r, (low, high) = state.text, rate.text, a.bounds
    return tape.value(f"0.0 if ({s} <= {low!r} and {r} < 0.0) or ({s} >= {high!r} and {r} > 0.0) else {r}")


def _clamped(tape: Tape, force: Scalar, low: Scalar, high: Scalar) -> Scalar:
    low, high, force = (getattr(v, "text", repr(v)) for v in (low, high, force))
    return tape.value(f"min(max({force}, {low}), {high})")


def word(kind: str, value: int) -> str:
    """What MuJoCo calls a value of one of its kinds (Trn, Dyn, Gain, Bias, Eq)."""
    import mujoco

    return str(getattr(mujoco, f"mjt{kind}")(int(value)).name).split("_")[1].lower()
