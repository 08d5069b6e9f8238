"""A fix to take home: the diagnosed effect as a patched copy of the user's MJCF, and as a Python function.

What MJCF has an attribute for is written into the copy by MuJoCo's own `MjSpec`; the rest, and whatever a model in
Python or an FMU needs, becomes a function (`standalone`).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from loopshape.toolbox.gap.mechanism.numbers import (
    DRY,
    GAIN,
    HINGE,
    LIMIT,
    PAYLOAD,
    PROPORTIONAL,
    TILT,
    Numbers,
    about,
    carried_by,
    first,
    led_by,
    with_point,
)
from loopshape.toolbox.gap.mechanism.standalone import function_file, numbers_of
from loopshape.toolbox.gap.nouns.effect import AttributeChange, Fix, LeftToYou, NotWritten, NumberChange
from loopshape.toolbox.gap.nouns.machine import Mechanism, Model, Port
from loopshape.toolbox.gap.own.composed import CHANGE, INPUT, OUTPUT, PORT

MODEL_FILE, FUNCTION_FILE = "gap_fixed.xml", "gap_fix.py"
NEAR = 1e-5  # relative, between a patched model's masses and places and those that were fitted


def in_files(fix: Fix, model: Model, mechanism: Mechanism | None) -> Fix:
    """The fix with a patched copy of a MuJoCo model and a function of what is not in it, without one of everything."""
    fix = replace(fix, parameters=_merged(fix.parameters, model))
    left = {c.parameter: NotWritten.NO_ATTRIBUTE for c in fix.parameters}
    if mechanism is not None:
        patch = _Patch(mechanism, model, {c.parameter: c.new for c in fix.parameters})
        exact = patch.is_exact()
        left = patch.left if exact else dict.fromkeys(left, NotWritten.REFUSED)
        if patch.written and exact:
            fix = replace(fix, file=MODEL_FILE, texts={MODEL_FILE: patch.xml()}, assets=patch.assets,
                          attributes=tuple(patch.attributes()))  # fmt: skip
        fix = replace(fix, left_to_you=tuple(LeftToYou(name, reason) for name, reason in left.items()))
    own = {name for name, reason in left.items() if reason != NotWritten.SHARPER}
    if not own:
        return fix
    return replace(fix, function=FUNCTION_FILE, texts={**fix.texts, FUNCTION_FILE: function_file(fix, model, own)})


def _merged(changes: Iterable[NumberChange], model: Model) -> tuple[NumberChange, ...]:
    """A parameter's own value and the change beside it as one number."""
    given, nominal = {c.parameter: c for c in changes}, model.values()
    rows = []
    for name, c in given.items():
        own = name.removeprefix(f"{CHANGE}.")
        if own != name:
            base = given[own].new if own in given else nominal[own]
            rows.append(replace(c, parameter=own, old=nominal[own], new=base + c.new))
        elif f"{CHANGE}.{name}" not in given:
            rows.append(c)
    return tuple(rows)


@dataclass(frozen=True)
class _Edit:
    """How MJCF says the number `key` of a port, an input or a sensor, and those in `also`.

    Not beside `unless`: there the whole is left. Of `sharper` MJCF has the effect without the number. `change` works on
    a specification, a name, the numbers there.
    """

    at: str
    key: str
    change: Callable[[Any, str, Mapping[str, float]], None]
    also: tuple[str, ...] = ()
    unless: tuple[str, ...] = ()
    sharper: tuple[str, ...] = ()


class _Patch:
    """A copy of a specification into which what moved is written, as far as MJCF has attributes for it."""

    def __init__(self, mechanism: Mechanism, model: Model, moves: Mapping[str, float]) -> None:
        self.of, self.moves = Numbers(mechanism), moves
        self.written: set[str] = set()
        self._not_written: dict[str, NotWritten] = {}
        kinds = {f"{k.name}_{n.name}" for k in mechanism.kinds for n in k.numbers}
        self.p = {n: moves.get(n, v) for n, v in model.values().items() if n not in kinds}
        held = {k: v for port in model.ports for k, v in self._at_the_motor(port).items()}
        self.p |= held
        self.spec = self.of.changed(self.p)
        by_numbers = {f"{kind}_{a}" for kind in (GAIN, PROPORTIONAL, LIMIT) for a in mechanism.motors}
        self._write(self.p.keys() - held - by_numbers, self._loaded)
        places = {PORT: self.of.joints, INPUT: [a.name for a in self.spec.actuators], OUTPUT: [*mechanism.sensors]}
        for edit in _EDITS:
            for name in places[edit.at]:
                self._write_number(edit, name, held)

    def _at_the_motor(self, port: Port) -> dict[str, float]:
        """What a coupling moves from the load to the motor: in MJCF it stays at the joint."""
        n = numbers_of(self.moves, PORT, port.name)
        pairs = ((port.motor_inertia, "inertia"), (port.motor_damping, "motor_damping"))
        return {name: n[key] + self.p[name] for name, key in pairs if name and key in n}

    def _write_number(self, edit: _Edit, name: str, held: Iterable[str]) -> None:
        n = numbers_of(self.moves, edit.at, name)
        if edit.key not in n or n.keys() & {*edit.unless}:
            return
        names = [f"{edit.at}.{name}.{key}" for key in (edit.key, *edit.also)]
        self._write([*names, *(held if edit.key == "inertia" else ())], lambda spec: edit.change(spec, name, n))
        if names[0] in self.written:
            self._not_written |= {f"{edit.at}.{name}.{key}": NotWritten.SHARPER for key in edit.sharper}

    def _write(self, names: Iterable[str], change: Callable[[Any], None]) -> None:
        """Change a copy, and keep it if it compiles; an attribute that this MuJoCo does not have yet is none."""
        trial, moved = self.spec.copy(), [name for name in names if name in self.moves]
        try:
            change(trial)
            trial.compile()
        except AttributeError:
            return
        except ValueError:
            self._not_written |= dict.fromkeys(moved, NotWritten.REFUSED)
            return
        self.spec = trial
        self.written |= {*moved}

    @property
    def left(self) -> dict[str, NotWritten]:
        """Parameters that moved and that the copy does not hold."""
        return {n: self._not_written.get(n, NotWritten.NO_ATTRIBUTE) for n in self.moves if n not in self.written}

    def is_exact(self) -> bool:
        """Whether masses and places are those that were fitted; settotalmass, for one, would scale a payload away."""
        m, fitted = self.spec.compile(), self.of.at(self.p)
        for b in range(1, m.nbody):
            pairs = zip("mcio", (*carried_by(m, b), m.body_pos[b]), strict=True)
            for key, value in pairs:
                size = float(np.max(np.abs(fitted[f"{key}{b}"])))
                if not np.allclose(value, fitted[f"{key}{b}"], rtol=NEAR, atol=NEAR * size):
                    return False
        return True

    def _loaded(self, spec: Any) -> None:
        """Payloads as geoms of the size of a point, or in a body's own inertia where geoms do not give it; the lean."""
        if self.p.get(TILT, 0.0) != 0.0:
            spec.option.gravity = about(self.of.tilt_axis, -self.p[TILT]) @ np.array(spec.option.gravity)
        for body in self.of.bodies:
            if (more := self.p[f"{PAYLOAD}_{body}"]) != 0.0:
                _carrying(spec, body, more, self.of.payload_at(body, self.p))
        for joint in self.of.joints:
            if (dry := self.p.get(f"{DRY}_{joint}")) is not None:
                spec.joint(joint).frictionloss = dry
        for row, actuator in enumerate(spec.actuators):
            share, stiffer = (self.p.get(f"{kind}_{actuator.name}", 1.0) for kind in (GAIN, PROPORTIONAL))
            limit = self.p.get(f"{LIMIT}_{actuator.name}", most := self.of.most(row))
            actuator.gainprm = share * stiffer * np.array(actuator.gainprm)
            actuator.biasprm = share * np.array([*(stiffer * np.array(actuator.biasprm[:2])), *actuator.biasprm[2:]])
            if limit != most:
                actuator.forcerange = limit / most * np.array(actuator.forcerange)

    @property
    def assets(self) -> tuple[str, ...]:
        """Files that the model names, by relative paths: meshes, height fields, textures."""
        held = (*self.spec.meshes, *self.spec.hfields, *self.spec.textures, *self.spec.skins)
        return tuple(dict.fromkeys(one.file for one in held if one.file))

    def xml(self) -> str:
        """The copy as MJCF, in the notation of the original where this MuJoCo can keep it, else with six digits."""
        spec = self.spec.copy()
        for key in ("savecompiled", "savecanonical"):
            if hasattr(spec.compiler, key):
                setattr(spec.compiler, key, False)
        spec.compile()
        return str(spec.to_xml())

    def attributes(self) -> Iterator[AttributeChange]:
        """What the compiled copy has otherwise than the compiled original."""
        old, new = self.of.nominal, self.spec.compile()
        for element, plural, pairs in _ATTRIBUTES:
            known = {one.name for one in getattr(self.of.of.spec, plural)}
            for name in [one.name for one in getattr(self.spec, plural) if one.name]:
                after = getattr(new, element)(name)
                before = getattr(old, element)(name) if name in known else None
                yield from (_attribute(element, name, a, field, before, after) for a, field in pairs
                            if _differs(field, before, after))  # fmt: skip
        if _differs("gravity", old.opt, new.opt):
            yield _attribute("option", "", "gravity", "gravity", old.opt, new.opt)


#: what of compiled models is compared: element, its list in a specification, attribute of MJCF and field of MuJoCo
_ATTRIBUTES = (
    ("body", "bodies", (("mass", "mass"), ("pos", "pos"))),
    ("joint", "joints", (
        ("damping", "damping"), ("damping", "dampingpoly"), ("frictionloss", "frictionloss"), ("armature", "armature"),
        ("stiffness", "stiffness"), ("stiffness", "stiffnesspoly"), ("springref", "qpos_spring"),
    )),
    ("actuator", "actuators", (
        ("gainprm", "gainprm"), ("biasprm", "biasprm"), ("forcerange", "forcerange"), ("delay", "delay"),
        ("dynprm", "dynprm"),
    )),
    ("sensor", "sensors", (("delay", "delay"),)),
)  # fmt: skip


def _field(of: Any, field: str, like: Any) -> tuple[float, ...]:
    return tuple(np.ravel(getattr(of, field, np.zeros_like(like))).tolist())


def _differs(field: str, before: Any, after: Any) -> bool:
    return hasattr(after, field) and _field(before, field, getattr(after, field)) != _field(after, field, 0.0)


def _attribute(element: str, name: str, attribute: str, field: str, before: Any, after: Any) -> AttributeChange:
    """The change of one attribute; what is no list in MJCF, or has zeros behind the first, as one number."""
    new = _field(after, field, 0.0)
    old = _field(before, field, getattr(after, field))
    if not any(new[1:]) and not any(old[1:]):
        return AttributeChange(element, name, attribute, old[0], new[0])
    return AttributeChange(element, name, attribute, old, new)


def _carrying(spec: Any, body: str, more: float, at: Any) -> None:
    import mujoco

    own, geoms_give = spec.body(body), int(spec.compiler.inertiafromgeom)
    if more > 0.0 and geoms_give != 0 and (geoms_give == 1 or not own.explicitinertial):
        taken = {g.name for g in spec.geoms}
        name = f"{PAYLOAD}_{body}"
        while name in taken:
            name += "_more"
        point_m = 1e-4  # radius of a payload's geom: a point, as it was fitted
        own.add_geom(name=name, type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[point_m, 0.0, 0.0], pos=at, mass=more,
                     contype=0, conaffinity=0)  # fmt: skip
        return
    m = spec.compile()
    mass, centre, inertia = with_point(*carried_by(m, m.body(body).id), more, at)
    main, axes = np.linalg.eigh(inertia)
    turn = np.zeros(4)
    mujoco.mju_mat2Quat(turn, np.ravel(axes * np.sign(np.linalg.det(axes))))
    own.mass, own.ipos, own.iquat, own.inertia, own.explicitinertial = mass, centre, turn, main, True
    own.ialt.type, own.fullinertia = mujoco.mjtOrientation.mjORIENTATION_QUAT, [np.nan, 0.0, 0.0, 0.0, 0.0, 0.0]


def _polynomial(old: Any, *values: float) -> Any:
    """Coefficients of a joint's force; only MuJoCo 4 has more than the first."""
    if np.ndim(old) == 0:
        raise AttributeError
    return np.array([*values, *np.zeros(len(old))])[: len(old)]


def _damped(spec: Any, name: str, n: Mapping[str, float]) -> None:
    joint, square = spec.joint(name), n.get("viscous_square", 0.0)
    value = first(joint.damping) + n["viscous"] * (1.0 - square)
    joint.damping = led_by(joint.damping, value)
    if square:
        curved = n["viscous"] * square / n.get("viscous_speed", 1.0)
        joint.damping = _polynomial(joint.damping, value, curved)


def _rubbed(spec: Any, name: str, n: Mapping[str, float]) -> None:
    joint = spec.joint(name)
    joint.frictionloss = float(joint.frictionloss) + n["coulomb"]


def _unit(spec: Any, name: str) -> float:
    """Of a joint's angles in the file, in the model's."""
    return float(np.pi / 180.0) if spec.compiler.degree and int(spec.joint(name).type) == HINGE else 1.0


def _stiffened(spec: Any, name: str, n: Mapping[str, float]) -> None:
    joint, old = spec.joint(name), first(spec.joint(name).stiffness)
    hard, unit = n.get("hardening", 0.0), _unit(spec, name)
    if hard and old:
        raise AttributeError  # two springs about two places are no polynomial about one
    rest = (old * joint.springref * unit + n["stiffness"] * n.get("rest", 0.0)) / (old + n["stiffness"])
    joint.springref, joint.stiffness = rest / unit, led_by(joint.stiffness, old + n["stiffness"])
    if hard:
        joint.stiffness = _polynomial(joint.stiffness, n["stiffness"], 0.0, n["stiffness"] * hard)


def _shifted(spec: Any, name: str, n: Mapping[str, float]) -> None:
    joint = spec.joint(name)
    if first(joint.stiffness) <= 0.0 or np.any(np.ravel(joint.stiffness)[1:]):
        raise AttributeError  # a constant effort needs a spring to lean on
    joint.springref += n["offset"] / first(joint.stiffness) / _unit(spec, name)


def _sprung(spec: Any, name: str, n: Mapping[str, float]) -> None:
    """A second joint of the body about the same axis, which the link turns by against the rotor at the first.

    What resists at the load cannot stand at either of the two.
    """
    import mujoco

    joint = spec.joint(name)
    at_load = first(joint.damping) > 0.0 and "motor_damping" not in n
    if at_load or np.any(joint.stiffness) or joint.frictionloss > 0.0:
        raise AttributeError
    new = joint.parent.add_joint(name=f"{name}_coupling", type=joint.type, axis=joint.axis, pos=joint.pos)
    new.stiffness = led_by(new.stiffness, n["coupling"])
    new.damping = led_by(new.damping, n.get("coupling_damping", 0.0))
    new.limited = mujoco.mjtLimited.mjLIMITED_FALSE
    if hard := n.get("coupling_hardening", 0.0):
        new.stiffness = _polynomial(new.stiffness, n["coupling"], 0.0, n["coupling"] * hard)


def _scaled(spec: Any, name: str, n: Mapping[str, float]) -> None:
    gains = np.array(spec.actuator(name).gainprm)
    gains[0] *= 1.0 + n["gain"]
    spec.actuator(name).gainprm = gains


def _lagging(spec: Any, name: str, n: Mapping[str, float]) -> None:
    import mujoco

    actuator = spec.actuator(name)
    if actuator.dyntype != mujoco.mjtDyn.mjDYN_NONE:
        raise AttributeError
    numbers = np.array(actuator.dynprm)
    numbers[0] = 1e-3 * n["lag_ms"]
    actuator.dyntype, actuator.dynprm = mujoco.mjtDyn.mjDYN_FILTEREXACT, numbers


def _late(one: Any, delay_ms: float, step_s: float) -> None:
    """A delay of an actuator or a sensor, linear between steps."""
    one.delay, one.interp = one.delay + 1e-3 * delay_ms, 1
    one.nsample = max(int(one.nsample), int(np.ceil(one.delay / step_s)) + 2)


def _limited(spec: Any, name: str, n: Mapping[str, float]) -> None:
    import mujoco

    actuator = spec.actuator(name)
    most = n["limit"] / abs(float(actuator.gear[0]))
    if actuator.forcelimited != mujoco.mjtLimited.mjLIMITED_FALSE and np.any(actuator.forcerange):
        most = min(most, float(np.min(np.abs(actuator.forcerange))))
    actuator.forcerange, actuator.forcelimited = [-most, most], mujoco.mjtLimited.mjLIMITED_TRUE


_EDITS = (
    _Edit(PORT, "viscous", _damped, ("viscous_speed", "viscous_square"), ("viscous_power", "inertia")),
    _Edit(PORT, "coulomb", _rubbed, (),
          ("stribeck", "asymmetry", "load", "driven_back", "load_stribeck", "load_square", "inertia"),
          ("coulomb_speed", "bristle")),
    _Edit(PORT, "stiffness", _stiffened, ("rest", "hardening"), ("inertia",)),
    _Edit(PORT, "offset", _shifted, (), ("inertia",)),
    _Edit(PORT, "inertia", _sprung, ("coupling", "coupling_damping", "motor_damping", "coupling_hardening"), ("play",)),
    _Edit(INPUT, "gain", _scaled, (), ("knee",)),
    _Edit(INPUT, "lag_ms", _lagging, (), ("knee", "lag_order")),
    _Edit(INPUT, "delay_ms", lambda spec, name, n: _late(spec.actuator(name), n["delay_ms"], spec.option.timestep), (),
          ("knee",)),
    _Edit(INPUT, "limit", _limited, (), ("knee",)),
    _Edit(OUTPUT, "delay_ms", lambda spec, name, n: _late(spec.sensor(name), n["delay_ms"], spec.option.timestep)),
)  # fmt: skip
