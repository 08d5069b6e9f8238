"""A MuJoCo model as a machine: its equations of motion written out, its bodies, joints and gravity as parameters.

MuJoCo compiles the model anew for every set of parameters; what its numbers say is put into equations of motion
(`tree`) that numba compiles, ten times as fast as a step of MuJoCo. What is no tree of hinges and slides with
actuators at joints is refused by its name, and the two are compared at random states when the model is read.
"""

from __future__ import annotations

import copy
import math
from collections import namedtuple
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from loopshape.core.errors import WrongUseError
from loopshape.toolbox.gap.mechanism.actuators import SPEED, Actuators, word
from loopshape.toolbox.gap.mechanism.numbers import (
    ARMATURE,
    DAMPING,
    DRY,
    GAIN,
    HINGE,
    LENGTH,
    MASS,
    PAYLOAD,
    PLACE,
    TILT,
    Numbers,
    first,
)  # fmt: skip
from loopshape.toolbox.gap.mechanism.tracing import Tape, filled
from loopshape.toolbox.gap.mechanism.tree import chained, laws, source
from loopshape.toolbox.gap.nouns.machine import Mechanism, Model, ModelParameter, Output

STATES, SEED, NEAR = 5, 3, 1e-7  # states at which MuJoCo is asked as well, and how far off the equations may be


def machine(mechanism: Mechanism) -> Model:
    """The machine of a MuJoCo model; refuses what is no tree of hinges and slides with actuators at its joints."""
    return _Built(Numbers(mechanism)).model()


@dataclass(frozen=True, eq=False)
class _Built:
    """A machine made of a mechanism's numbers."""

    numbers: Numbers

    @property
    def of(self) -> Mechanism:
        return self.numbers.of

    @property
    def nominal(self) -> Any:
        return self.numbers.nominal

    @cached_property
    def actuators(self) -> Actuators:
        return Actuators(self.numbers)

    def model(self) -> Model:
        self.actuators.check()
        self._is_tree()
        self._names()
        parameters = self._parameters()
        fields, motion, law = self._equations(parameters)
        derived = _Derived(self.numbers, tuple(p.name for p in parameters), fields)
        joints = self.numbers.joints
        out = Model(
            self.of.name, motion, (*joints, *(j + SPEED for j in joints), *self.actuators.states.values()), parameters,
            self.actuators.inputs(), self._outputs(), self.actuators.ports(), self.of.window_s, self.of.without,
            derived, matters=self.of.matters, law=law,
        )  # fmt: skip
        self._agrees(out)
        return out

    def _is_tree(self) -> None:
        """Refuse by name what a tree of hinges and slides does not have."""
        m, what = self.nominal, f"{self.of.name} is a tree of hinges and slides"
        if not m.njnt:
            raise WrongUseError(what, "no joint at all", "give the body that moves a joint")
        for k, kind in ((k, _JOINTS.get(int(t))) for k, t in enumerate(m.jnt_type)):
            if kind:
                raise WrongUseError(
                    what, f"{kind} joint {m.joint(k).name}",
                    "replace it by hinges and slides, or describe the machine by a right-hand side in Python",
                )  # fmt: skip
        out = "leave it out of the model file, or describe the machine by a right-hand side in Python"
        if m.ntendon:
            raise WrongUseError(what, f"tendon {m.tendon(0).name or 0}", out)
        for k in range(m.neq):
            raise WrongUseError(what, f"equality {m.equality(k).name or k} ({word('Eq', m.eq_type[k])})", out)
        for b in np.flatnonzero(m.body_gravcomp):
            raise WrongUseError(what, f"gravcomp of body {m.body(int(b)).name}", "set it to 0, log the whole effort")
        for number in ("density", "viscosity"):
            if getattr(m.opt, number) > 0.0:
                raise WrongUseError(what, f"a fluid of {number} {getattr(m.opt, number):g}", "set it to 0 in <option>")

    def _names(self) -> None:
        """Refuse tolerances and columns of what the model does not have."""
        known = {
            MASS: self.numbers.bodies, DAMPING: self.numbers.joints, ARMATURE: self.numbers.joints,
            DRY: [j for j, level in zip(self.numbers.joints, self.nominal.dof_frictionloss, strict=True) if level],
            "motor_constant": [a.name for a in self.actuators.all],
        }  # fmt: skip
        for name in self.of.motors:
            if name not in self.numbers.joints or name in [a.name for a in self.numbers.spec.actuators]:
                raise WrongUseError(
                    "a motor by numbers stands at a joint, under its name, in place of an actuator", f"{name!r}",
                    f"joints are {', '.join(self.numbers.joints)}; take an actuator of this name out of the model file",
                )  # fmt: skip
        for kind, shares in self.of.spread.items():
            for name in shares:
                if name not in known[kind]:
                    raise WrongUseError(
                        "tolerances name what the model has", f"{kind} of {name!r}",
                        f"known are {', '.join(known[kind])}",
                    )  # fmt: skip
        for name in self.of.actuators:
            if name not in known["motor_constant"]:
                raise WrongUseError(
                    f"actuators of {self.of.name}.toml stand in the model", f"{name!r}",
                    f"known are {', '.join(known['motor_constant'])}",
                )  # fmt: skip

    def _parameters(self) -> tuple[ModelParameter, ...]:
        out = []
        for body in self.numbers.bodies:
            mass, far = float(self.nominal.body(body).subtreemass[0]), self.numbers.far(body)
            out.append(ModelParameter(f"{MASS}_{body}", 1.0, "1", self._spread(MASS, body), "none"))
            size, most = float(np.linalg.norm(far)), (-0.5 * mass, mass)
            place = f"{PLACE}_{body}" if size > 0.0 else ""
            out.append(ModelParameter(f"{PAYLOAD}_{body}", 0.0, "kg", 0.0, f"payload@{body}", most, place))
            if size > 0.0:
                ends = (-0.4 * size, 0.4 * size)
                out.append(ModelParameter(place, 1.0, "1", 0.0, "none", (-0.5, 0.3)))
                out.append(ModelParameter(f"{LENGTH}_{body}", 0.0, "m", effect=f"length_error@{body}", range=ends))
        for joint in self.numbers.joints:
            found, unit = self.nominal.joint(joint), self.numbers.unit(joint)
            for kind, value in ((DAMPING, first(found.damping)), (ARMATURE, first(found.armature))):
                words = f"{unit[1]} s/{unit[0]}" if kind == DAMPING else {"rad": "kg m2", "m": "kg"}[unit[0]]
                out.append(ModelParameter(f"{kind}_{joint}", value, words, self._spread(kind, joint), "none"))
            if (level := first(found.frictionloss)) > 0.0:
                ends, effect = (-level, 4.0 * level), f"coulomb_friction@{joint}"
                dry = self._spread(DRY, joint)
                out.append(ModelParameter(f"{DRY}_{joint}", level, unit[1], dry, effect, ends))
        out += self.actuators.parameters()
        tilt = ModelParameter(TILT, 0.0, "rad", effect="base_tilt@base", range=(-0.35, 0.35))
        return (*out, tilt) if np.any(self.numbers.gravity) else tuple(out)

    def _spread(self, kind: str, name: str) -> float:
        return self.of.spread.get(kind, {}).get(name, 0.0)

    def _equations(self, parameters: tuple[ModelParameter, ...]) -> tuple[tuple[tuple[str, int], ...], Any, Any]:
        """Which numbers depend on parameters (name, place), the compiled-to-be right-hand side, laws of actuators."""
        base = {p.name: p.value for p in parameters}
        nominal = self.numbers.at(base)
        varies = {name: np.zeros(np.size(value), dtype=bool) for name, value in nominal.items()}
        for p in parameters:
            step = 0.01 * (p.value or (p.range[1] if p.range else 1.0)) or 1e-3
            other = self.numbers.at(base | {p.name: p.value + step})  # a place moves nothing that its payload does not
            for name, value in other.items():
                varies[name] |= np.abs(np.ravel(value) - np.ravel(nominal[name])) > 1e-12
        fields = tuple((name, int(k)) for name, which in varies.items() for k in np.flatnonzero(which))
        (tape, shaped), (aside, alike) = (_written(nominal, fields) for _ in range(2))
        links = chained(self.nominal, shaped, self.numbers.creep)
        text = source(links, shaped["gravity"], *self.actuators.written(shaped, tape), tape)
        within = self.actuators.laws(alike, aside)
        text += laws(within, aside)
        space: dict[str, Any] = {"math": math}
        exec(compile(text, f"<equations of {self.of.name}>", "exec"), space)  # the project's own text, made of numbers
        return fields, space["motion"], space["law"] if within else None

    def _outputs(self) -> tuple[Output, ...]:
        """Sensors, or joints, that have a column; refuses those that read no position or speed of a joint."""
        out = []
        for name, (column, factor, *offset) in self.of.sensors.items():
            joint = name.removesuffix(SPEED)
            if name in [s.name for s in self.of.spec.sensors]:
                joint, ending = self._sensed(name)
            elif joint in self.numbers.joints:
                ending = name.removeprefix(joint)
            else:
                raise WrongUseError(f"sensor {name} stands in {self.of.name}", "no such sensor", "correct its name")
            unit = self.numbers.unit(joint)[0] + ("/s" if ending else "")
            out.append(Output(name, joint + ending, column, factor, unit, *offset))
        return tuple(out)

    def _sensed(self, name: str) -> tuple[str, str]:
        """Joint of a sensor of the model, and what stands behind it in the name of the state."""
        sensor = self.of.spec.sensor(name)
        ending = {"mjSENS_JOINTPOS": "", "mjSENS_JOINTVEL": SPEED}.get(sensor.type.name)
        if ending is None:
            raise WrongUseError(
                f"sensor {name} reads the position or the speed of a joint", sensor.type.name,
                "leave it out, or describe the machine by a right-hand side in Python",
            )  # fmt: skip
        return sensor.objname, ending

    def _agrees(self, model: Model) -> None:
        """Refuse a model whose accelerations in MuJoCo are others, and name what touches at the states tried.

        Ends of joints and dry friction are constraints there, which are left out: the one is not modelled, the other is
        smooth (`tree`). Motors by numbers are not MuJoCo's.
        """
        import mujoco

        m, rng = copy.copy(self.nominal), np.random.default_rng(SEED)
        m.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_FRICTIONLOSS | mujoco.mjtDisableBit.mjDSBL_LIMIT
        data, held = mujoco.MjData(m), model.values()
        held |= {name: 0.0 for name in held if name.startswith(DRY)} | {f"{GAIN}_{a}": 0.0 for a in self.of.motors}
        p = model.derived(tuple(held.values())) if model.derived else None
        for _ in range(STATES):
            u, states = self._tried(data, m, rng)
            mujoco.mj_forward(m, data)
            self._touches_nothing(data)
            mine = np.array(model.motion(0.0, [*data.qpos, *data.qvel, *states], u, p)[m.nq :])
            theirs = np.concatenate([data.qacc, data.act_dot])
            mine = mine[: theirs.size]
            if np.max(np.abs(mine - theirs)) > NEAR * (1.0 + np.max(np.abs(theirs))):
                raise WrongUseError(
                    f"{self.of.name} is a tree of hinges and slides",
                    "accelerations in MuJoCo that joints, bodies and actuators do not explain",
                    "leave out what is none of them (plugins, flexes, springs that are not linear)",
                )  # fmt: skip

    def _tried(self, data: Any, m: Any, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
        """Fill in a random state and command, beyond clamps at times; the inputs and states of actuators to it."""
        away = np.where(m.jnt_type == HINGE, 0.3, 0.05) * rng.normal(size=m.nq)
        held = np.clip(m.qpos0 + away, *m.jnt_range.T)
        data.qpos[:] = np.where(m.jnt_limited, held, m.qpos0 + away)
        data.qvel[:] = rng.normal(0.0, 1.0, m.nv)
        wide = np.array(m.actuator_ctrlrange[:, 1])
        data.ctrl[:] = np.where(m.actuator_ctrllimited, wide, 0.1) * rng.uniform(-1.5, 1.5, m.nu)
        stated = [a for a in self.actuators.servos if a.name in self.actuators.states]
        states = rng.normal(0.0, 0.3, len(stated))
        for k, a in enumerate(stated):
            states[k] = states[k] if a.bounds is None else rng.uniform(*a.bounds)
        data.act[:] = states[: m.na]
        gains = self.numbers.efforts(m)["gain"][:, 0]
        inputs, command = [], dict(zip([a.name for a in self.actuators.all], data.ctrl, strict=False))
        for a in self.actuators.all:
            value = command.get(a.name, 0.0) * (gains[a.row] if a.is_direct else 1.0)
            inputs.append(value if a.limits is None else np.clip(value, *a.limits))
        idle = len(self.actuators.inputs()) - len(inputs)
        return np.array(inputs + [0.0] * idle), states

    def _touches_nothing(self, data: Any) -> None:
        for contact in data.contact:
            if contact.exclude == 0:
                one, other = (self._geom(int(k)) for k in contact.geom)
                raise WrongUseError(
                    f"nothing of {self.of.name} touches", f"geoms {one} and {other} near the initial position",
                    'switch contacts off (<option><flag contact="disable"/></option>)',
                )  # fmt: skip

    def _geom(self, k: int) -> str:
        found = self.nominal.geom(k)
        return found.name or f"{k} of body {self.nominal.body(int(found.bodyid[0])).name}"


def _written(nominal: Mapping[str, Any], fields: Sequence[tuple[str, int]]) -> tuple[Tape, dict[str, Any]]:
    """A tape, and the numbers on it, those that vary by name."""
    tape = Tape()
    known = {field: tape.name(f"p.{_field(field)}") for field in fields}
    return tape, {name: filled(name, value, known) for name, value in nominal.items()}


class _Derived:
    """Numbers of the equations under parameters (in order), remembered: recordings ask for the same again."""

    def __init__(self, numbers: Numbers, names: tuple[str, ...], fields: tuple[tuple[str, int], ...]) -> None:
        self._numbers, self._names, self._fields = numbers, names, fields
        self._tuple = _named(fields)
        self._known: dict[tuple[float, ...], Any] = {}

    def __call__(self, values: tuple[float, ...]) -> Any:
        """A tuple of numbers by name for the values of the parameters."""
        if values not in self._known:
            found = self._numbers.at(dict(zip(self._names, values, strict=True)))
            own = [float(np.ravel(found[name])[place]) for name, place in self._fields] or [0.0]
            remembered = 256
            if len(self._known) > remembered:
                self._known.clear()
            self._known[values] = self._tuple(*own)
        return self._known[values]


_JOINTS = {0: "free", 1: "ball"}  # mjJNT_FREE, mjJNT_BALL


def _named(fields: tuple[tuple[str, int], ...]) -> Any:
    return namedtuple("Numbers", [_field(f) for f in fields] or ["none"])


def _field(field: tuple[str, int]) -> str:
    return f"{field[0]}_{field[1]}"
