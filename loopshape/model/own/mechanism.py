"""A MuJoCo model as a machine: its equations of motion written out, its bodies, joints and gravity as parameters.

MuJoCo compiles the model anew for every set of parameters; what its numbers say is put into equations of motion
(`tree`) that numba compiles, ten times as fast as a step of MuJoCo. The two are compared at random states when the
model is read, so that contacts, tendons and whatever else is no tree of hinges and slides is refused.
"""

from __future__ import annotations

import math
from collections import namedtuple
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from loopshape.core.errors import WrongUseError
from loopshape.data.machine import Input, Mechanism, Model, ModelParameter, Output, Port
from loopshape.model.own.numbers import (
    ARMATURE,
    DAMPING,
    HINGE,
    LENGTH,
    MASS,
    PAYLOAD,
    PLACE,
    SLIDE,
    TILT,
    Numbers,
    first,
)  # fmt: skip
from loopshape.model.own.tracing import Scalar, Tape, snapped
from loopshape.model.own.tree import Joint, Link, source

SPEED = "_speed"
STATES, SEED, NEAR = 5, 3, 1e-7  # states at which MuJoCo is asked as well, and how far off the equations may be


def machine(mechanism: Mechanism) -> Model:
    """The machine of a MuJoCo model; refuses what is no tree of hinges and slides driven by motors."""
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

    def model(self) -> Model:
        self._tree_of_joints()
        self._names()
        parameters = self._parameters()
        fields, motion = self._equations(parameters)
        derived = _Derived(self.numbers, tuple(p.name for p in parameters), fields)
        inputs, ports = self._inputs(), self._ports()
        out = Model(
            self.of.name, motion, (*self.numbers.joints, *(j + SPEED for j in self.numbers.joints)), parameters, inputs,
            self._outputs(), ports, self.of.window_s, self.of.without, derived,
        )  # fmt: skip
        self._agrees(out)
        return out

    def _tree_of_joints(self) -> None:
        types = {int(t) for t in self.nominal.jnt_type}
        if not types <= {HINGE, SLIDE} or not types:
            raise WrongUseError(
                f"the joints of {self.of.name} are hinges and slides", "a free joint, a ball joint, or none at all",
                "describe the machine by a right-hand side in Python",
            )  # fmt: skip

    def _names(self) -> None:
        """Refuse tolerances and columns of what the model does not have."""
        m = self.nominal
        known = {
            MASS: self.numbers.bodies, DAMPING: self.numbers.joints, ARMATURE: self.numbers.joints,
            "motor_constant": [m.actuator(k).name for k in range(m.nu)],
        }  # fmt: skip
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
                words = f"{unit[1]} s/{unit[0]}" if kind == DAMPING else "inertia"
                out.append(ModelParameter(f"{kind}_{joint}", value, words, self._spread(kind, joint), "none"))
        tilt = ModelParameter(TILT, 0.0, "rad", effect="base_tilt@base", range=(-0.35, 0.35))
        return (*out, tilt) if np.any(self.nominal.opt.gravity) else tuple(out)

    def _spread(self, kind: str, name: str) -> float:
        return self.of.spread.get(kind, {}).get(name, 0.0)

    def _equations(self, parameters: tuple[ModelParameter, ...]) -> tuple[tuple[tuple[str, int], ...], Any]:
        """Which numbers depend on parameters (name, place), and the compiled-to-be right-hand side."""
        base = {p.name: p.value for p in parameters}
        nominal = self.numbers.at(base)
        varies = {name: np.zeros(np.size(value), dtype=bool) for name, value in nominal.items()}
        for p in parameters:
            step = 0.01 * (p.value or (p.range[1] if p.range else 1.0)) or 1e-3
            other = self.numbers.at(base | {p.name: p.value + step})  # a place moves nothing that its payload does not
            for name, value in other.items():
                varies[name] |= np.abs(np.ravel(value) - np.ravel(nominal[name])) > 1e-12
        fields = tuple((name, int(k)) for name, which in varies.items() for k in np.flatnonzero(which))
        tape = Tape()
        known = {field: tape.name(f"p.{_field(field)}") for field in fields}
        shaped = {name: _filled(name, value, known) for name, value in nominal.items()}
        links = _links(self.nominal, shaped)
        text = source(links, shaped["gravity"], self._efforts(), tape)
        space: dict[str, Any] = {"math": math}
        exec(compile(text, f"<equations of {self.of.name}>", "exec"), space)  # the project's own text, made of numbers
        return fields, space["motion"]

    def _driving(self) -> list[tuple[str, str, float]]:
        """Actuator, joint, effort per command; refuses what is no motor at a joint."""
        out = []
        m = self.nominal
        for k in range(m.nu):
            name = m.actuator(k).name
            plain = m.actuator_trntype[k] == 0 and m.actuator_gaintype[k] == 0 and m.actuator_biastype[k] == 0
            if not plain or m.actuator_dyntype[k] != 0:
                raise WrongUseError(
                    f"actuator {name} of {self.of.name} is a motor at a joint", "another kind of actuator",
                    "log its effort, and replace it by <motor joint=...>",
                )  # fmt: skip
            joint = m.joint(int(m.actuator_trnid[k, 0])).name
            out.append((name, joint, float(m.actuator_gainprm[k, 0] * m.actuator_gear[k, 0])))
        return out

    def _inputs(self) -> tuple[Input, ...]:
        """One an actuator, and one a joint without: there effects alone act."""
        driving = self._driving()
        columns = self.of.actuators
        own = [
            Input(a, columns.get(a, (None, 1.0))[0], gain * columns.get(a, (None, 1.0))[1],
                  self._spread("motor_constant", a), self.numbers.unit(j)[1])
            for a, j, gain in driving
        ]  # fmt: skip
        idle = [j for j in self.numbers.joints if j not in [joint for _, joint, _ in driving]]
        return (*own, *(Input(j, unit=self.numbers.unit(j)[1]) for j in idle))

    def _efforts(self) -> list[list[int]]:
        """Inputs that act on each joint."""
        names = [i.name for i in self._inputs()]
        acting: dict[str, list[int]] = {j: [names.index(j)] if j in names else [] for j in self.numbers.joints}
        for actuator, joint, _ in self._driving():
            acting[joint].append(names.index(actuator))
        return [acting[j] for j in self.numbers.joints]

    def _ports(self) -> tuple[Port, ...]:
        """One a joint: a coupling between motor and link where a motor with a rotor drives it."""
        names, out = [i.name for i in self._inputs()], []
        driven = {j for _, j, _ in self._driving()}
        for joint, acting in zip(self.numbers.joints, self._efforts(), strict=True):
            rotor = first(self.nominal.joint(joint).armature) > 0.0 and joint in driven
            inertia = f"{ARMATURE}_{joint}" if rotor else None
            damping = f"{DAMPING}_{joint}" if rotor else None
            unit = self.numbers.unit(joint)[1]
            out.append(Port(joint, names[acting[0]], joint, joint + SPEED, inertia, unit, damping))
        return tuple(out)

    def _outputs(self) -> tuple[Output, ...]:
        """Sensors that have a column; refuses those that read no position or speed of a joint."""
        out = []
        for name, (column, factor) in self.of.sensors.items():
            if name not in [s.name for s in self.of.spec.sensors]:
                raise WrongUseError(f"sensor {name} stands in {self.of.name}", "no such sensor", "correct its name")
            sensor = self.of.spec.sensor(name)
            ending = {"mjSENS_JOINTPOS": "", "mjSENS_JOINTVEL": SPEED}.get(sensor.type.name)
            if ending is None:
                raise WrongUseError(
                    f"sensor {name} reads the position or the speed of a joint", sensor.type.name,
                    "leave it out, or describe the machine by a right-hand side in Python",
                )  # fmt: skip
            unit = self.numbers.unit(sensor.objname)[0] + ("/s" if ending else "")
            out.append(Output(name, sensor.objname + ending, column, factor, unit))
        return tuple(out)

    def _agrees(self, model: Model) -> None:
        """Refuse a model whose accelerations in MuJoCo are others: it has more than joints and bodies."""
        import mujoco

        m, rng = self.nominal, np.random.default_rng(SEED)
        data, p = mujoco.MjData(m), model.derived(tuple(model.values().values())) if model.derived else None
        gains = {i.name: g for i in model.inputs for a, _, g in self._driving() if a == i.name}
        for _ in range(STATES):
            data.qpos[:], data.qvel[:] = rng.normal(0.0, 0.3, m.nq), rng.normal(0.0, 1.0, m.nv)
            data.ctrl[:] = rng.uniform(-0.1, 0.1, m.nu)
            mujoco.mj_forward(m, data)
            u = [gains[i.name] * data.ctrl[k] if i.name in gains else 0.0 for k, i in enumerate(model.inputs)]
            mine = model.motion(0.0, [*data.qpos, *data.qvel], u, p)[m.nq :]
            if np.max(np.abs(mine - data.qacc)) > NEAR * (1.0 + np.max(np.abs(data.qacc))):
                raise WrongUseError(
                    f"{self.of.name} is a tree of hinges and slides",
                    "accelerations in MuJoCo that joints, bodies and motors do not explain (contacts, tendons, "
                    "equalities, dry friction)",
                    "switch contacts off (contype and conaffinity 0), and leave the rest out",
                )  # fmt: skip


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
            if len(self._known) > _REMEMBERED:
                self._known.clear()
            self._known[values] = self._tuple(*own)
        return self._known[values]


_REMEMBERED = 256


def _named(fields: tuple[tuple[str, int], ...]) -> Any:
    return namedtuple("Numbers", [_field(f) for f in fields] or ["none"])


def _field(field: tuple[str, int]) -> str:
    return f"{field[0]}_{field[1]}"


def _filled(name: str, value: Any, known: Mapping[tuple[str, int], Scalar]) -> Any:
    """An array as nested lists, numbers that vary as names."""
    flat: list[Scalar] = list(np.ravel(snapped(value)))
    for k in range(len(flat)):
        flat[k] = known.get((name, k), float(flat[k]))
    shape = np.shape(value)
    if not shape:
        return flat[0]
    return flat if len(shape) == 1 else [flat[k * shape[1] : (k + 1) * shape[1]] for k in range(shape[0])]


def _links(m: Any, n: Mapping[str, Any]) -> list[Link]:
    """Bodies as links: one a joint, each origin at its joint's anchor; the last joint of a body carries its mass."""
    links: list[Link] = []
    last, anchor_of = {0: -1}, {0: [0.0, 0.0, 0.0]}
    nothing, straight = [[0.0] * 3] * 3, [[float(i == k) for k in range(3)] for i in range(3)]
    for b in range(1, m.nbody):
        parent, count = int(m.body_parentid[b]), int(m.body_jntnum[b])
        above, shift, rotation = last[parent], anchor_of[parent], n[f"r{b}"]
        origin = [o - s for o, s in zip(n[f"o{b}"], shift, strict=True)]
        anchor = [0.0, 0.0, 0.0]
        for j in range(int(m.body_jntadr[b]), int(m.body_jntadr[b]) + count):
            new = n["anchor"][j] if m.jnt_type[j] == HINGE else [0.0, 0.0, 0.0]
            step = [a - s for a, s in zip(new, anchor, strict=True)]
            origin = [o + sum((r * s for r, s in zip(row, step, strict=True)), 0.0)
                      for o, row in zip(origin, rotation, strict=True)]  # fmt: skip
            links.append(Link(above, origin, rotation, _joint(m, n, j), 0.0, [0.0] * 3, nothing))
            above, anchor, origin, rotation = len(links) - 1, new, [0.0] * 3, straight
        centre = [c - a for c, a in zip(n[f"c{b}"], anchor, strict=True)]
        body = (n[f"m{b}"], centre, n[f"i{b}"])
        if count:
            top = links[-1]
            links[-1] = Link(top.parent, top.origin, top.rotation, top.joint, *body)
        else:
            links.append(Link(above, origin, rotation, None, *body))
        last[b], anchor_of[b] = len(links) - 1, anchor
    return links


def _joint(m: Any, n: Mapping[str, Any], j: int) -> Joint:
    numbers = [n[name][j] for name in ("damping", "stiffness", "rest", "armature", "zero")]
    return Joint(bool(m.jnt_type[j] == HINGE), n["axis"][j], *numbers)
