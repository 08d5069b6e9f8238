"""What MuJoCo makes of a model under given parameters: masses, places, inertias, joints, gravity, as arrays.

MuJoCo compiles a changed copy of the specification for every set of parameters; point masses and the lean of the base
are added to what it gives.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from threading import Lock
from typing import Any

import numpy as np

from loopshape.core.units import Array
from loopshape.toolbox.gap.nouns.machine import LAW, Mechanism

MASS, PAYLOAD, PLACE, LENGTH = "mass", "payload", "place", "length"
DAMPING, ARMATURE, TILT, DRY = "damping", "armature", "tilt", "frictionloss"
GAIN, LIMIT, PROPORTIONAL = "gain", "limit", "kp"
STEP_S = 0.002  # longest step of the integration (`following`)
HINGE, SLIDE = 3, 2  # mjJNT_HINGE, mjJNT_SLIDE


@dataclass(frozen=True, eq=False)
class Numbers:
    """A mechanism, and the numbers that MuJoCo makes of it under given parameters."""

    of: Mechanism

    @cached_property
    def nominal(self) -> Any:
        """The compiled model."""
        return self.spec.compile()

    @cached_property
    def spec(self) -> Any:
        """A copy of the specification in which everything has a name, with motors at joints that have a column."""
        import mujoco

        spec = self.of.spec.copy()
        for kind, own in (("body", spec.bodies), ("joint", spec.joints), ("actuator", spec.actuators)):
            free = (name for k in itertools.count() if (name := f"{kind}{k}") not in {one.name for one in own})
            for one in own:
                one.name = one.name or next(free)
        known, joints = [a.name for a in spec.actuators], [j.name for j in spec.joints]
        for name in self.of.actuators:
            if name in joints and name not in known and name not in self.of.motors:
                spec.add_actuator(name=name, target=name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
        return spec

    @cached_property
    def _light(self) -> Any:
        """The specification without meshes that no inertia is made of: it compiles ten times as fast."""
        import mujoco

        spec, m = self.spec.copy(), self.nominal
        if spec.compiler.inertiafromgeom == mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_TRUE:
            return spec
        stated = [b for b in spec.bodies if b.explicitinertial or m.body_weldid[m.body(b.name).id] == 0]
        drawn = [g for body in stated for g in body.geoms if g.meshname]
        used = {g.meshname for body in spec.bodies if body not in stated for g in body.geoms}
        unused = [mesh for mesh in spec.meshes if (mesh.name or Path(mesh.file).stem) not in used]
        for one in (*drawn, *unused):
            spec.delete(one) if hasattr(spec, "delete") else one.delete()
        return spec

    @cached_property
    def gravity(self) -> Array:
        """Gravity (3,), none where a flag switches it off."""
        import mujoco

        is_off = self.nominal.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_GRAVITY
        return np.array(self.nominal.opt.gravity) * (0.0 if is_off else 1.0)

    @cached_property
    def driven(self) -> int:
        """How many actuators MuJoCo has."""
        return len(self.spec.actuators)

    @cached_property
    def _lock(self) -> Lock:
        return Lock()

    @cached_property
    def joints(self) -> list[str]:
        """Names in the order of the states."""
        return [self.nominal.joint(k).name for k in range(self.nominal.njnt)]

    @cached_property
    def bodies(self) -> list[str]:
        """Names of the bodies that have a joint."""
        return [self.nominal.body(int(b)).name for b in dict.fromkeys(self.nominal.jnt_bodyid)]

    def unit(self, joint: str) -> tuple[str, str]:
        """Unit of its position and of its effort."""
        hinge = self.nominal.joint(joint).type[0] == HINGE
        return ("rad", "N m") if hinge else ("m", "N")

    def far(self, body: str) -> Array:
        """The farthest end of a body (3,) from its origin, where its geoms end or another body hangs; 0 if nowhere."""
        own = self.spec.body(body)
        ends = [np.array(g.fromto[3 * k : 3 * k + 3]) for g in own.geoms for k in (0, 1)]
        ends = [e for e in ends if np.all(np.isfinite(e))]
        ends += [np.array(child.pos) for child in own.bodies] or [np.zeros(3)]
        return np.asarray(max(ends, key=lambda e: float(np.linalg.norm(e))), dtype=float)

    def at(self, p: Mapping[str, float]) -> dict[str, Any]:
        """Arrays by name under parameters, as MuJoCo compiles them; payloads and tilt are added to what it gives."""
        with self._lock:
            m = self.changed(p, whole=False).compile()
        out: dict[str, Any] = {}
        for b in range(1, m.nbody):
            name = m.body(b).name
            at = self.payload_at(name, p) if name else np.zeros(3)
            mass, centre, inertia = with_point(*carried_by(m, b), p.get(f"{PAYLOAD}_{name}", 0.0), at)
            out |= {f"m{b}": mass, f"c{b}": centre, f"i{b}": inertia, f"o{b}": np.array(m.body_pos[b])}
            out[f"r{b}"] = _matrix(m.body_quat[b])
        out |= {
            "damping": np.ravel(m.dof_damping), "armature": np.array(m.dof_armature),
            "stiffness": np.ravel(m.jnt_stiffness), "rest": np.array(m.qpos_spring), "zero": np.array(m.qpos0),
            "axis": np.array(m.jnt_axis), "anchor": np.array(m.jnt_pos),
        }  # fmt: skip
        out |= self._driving(m, p)
        out[DRY] = np.array([p.get(f"{DRY}_{j}", 0.0) for j in self.joints])
        out["gravity"] = about(self.tilt_axis, -p.get(TILT, 0.0)) @ self.gravity
        return out

    def _driving(self, m: Any, p: Mapping[str, float]) -> dict[str, Array]:
        """Numbers of actuators under parameters; a motor's limit is one of its voltage, and goes with its constant."""
        out = self.efforts(m)
        names = [*(m.actuator(k).name for k in range(self.driven)), *self.of.motors]
        share = np.array([p.get(f"{GAIN}_{a}", 1.0) for a in names])
        largest = np.array([p.get(f"{LIMIT}_{a}", self.most(row)) / (self.most(row) or 1.0)
                            for row, a in enumerate(names)])  # fmt: skip
        largest[self.driven :] *= share[self.driven :]
        proportional = np.array([p.get(f"{PROPORTIONAL}_{a}", 1.0) for a in names])
        for name in ("gain", "bias", "integral", "back"):
            out[name] = (out[name].T * share).T
        for part in (out["gain"], out["bias"][:, :2], out["integral"]):
            part.T[...] *= proportional
        out["force"] = (out["force"].T * largest).T
        return out

    def efforts(self, m: Any) -> dict[str, Array]:
        """Numbers of MuJoCo's actuators and of the motors behind them (n, ...), on the joint's side."""
        n, gear = self.driven, np.array(m.actuator_gear[:, :1])
        sides = gear * np.hstack([np.ones_like(gear), gear, gear])
        gain, bias = np.array(m.actuator_gainprm[:, :3]), np.array(m.actuator_biasprm[:, :3])
        gain[m.actuator_gaintype == 0, 1:] = 0.0  # mjGAIN_FIXED
        bias[m.actuator_biastype == 0] = 0.0  # mjBIAS_NONE
        force = np.sort(gear * m.actuator_forcerange, axis=1)
        force[~np.array(m.actuator_forcelimited, dtype=bool)] = 0.0
        rows = [motor(numbers) for numbers in self.of.motors.values()]
        own = {name: np.array([row[name] for row in rows]) for name in (rows[0] if rows else {})}
        out = {"gain": gain * sides, "bias": bias * sides, "force": force,
               "integral": np.zeros(n), "back": np.zeros(n)}  # fmt: skip
        out = {name: np.concatenate([value, own[name]]) if rows else value for name, value in out.items()}
        tau = np.maximum(m.actuator_dynprm[:, 0], 1e-15)
        return out | {"tau": np.array(tau), "together": np.array(m.jnt_actfrcrange)}

    def most(self, row: int) -> float:
        """The largest effort of an actuator, 0 where nothing clamps it."""
        return float(np.max(np.abs(self._nominal_efforts["force"][row])))

    @cached_property
    def _nominal_efforts(self) -> dict[str, Array]:
        return self.efforts(self.nominal)

    @cached_property
    def creep(self) -> list[float]:
        """Speed per dry friction below which a joint creeps in MuJoCo, where friction is a soft constraint.

        R/b of the constraint (MuJoCo's documentation, Computation, Constraint model), no less than the longest step of
        the integration allows.
        """
        import mujoco

        m = self.nominal
        data = mujoco.MjData(m)
        mujoco.mj_forward(m, data)
        out = STEP_S * np.array(m.dof_invweight0)
        for k in np.flatnonzero(data.efc_type == mujoco.mjtConstraint.mjCNSTR_FRICTION_DOF):
            joint = int(data.efc_id[k])
            out[joint] = max(out[joint], data.efc_R[k] / data.efc_KBIP[k, 1])
        return [float(c) for c in out]

    def _longer(self, body: str, p: Mapping[str, float]) -> float:
        """Its length over the nominal one."""
        return 1.0 + p.get(f"{LENGTH}_{body}", 0.0) / max(float(np.linalg.norm(self.far(body))), 1e-12)

    def payload_at(self, body: str, p: Mapping[str, float]) -> Array:
        """Where its payload sits (3,)."""
        return p.get(f"{PLACE}_{body}", 1.0) * self._longer(body, p) * self.far(body)

    @cached_property
    def tilt_axis(self) -> Array:
        """Axis of the first hinge: the base leans about it."""
        hinges = [k for k, t in enumerate(self.nominal.jnt_type) if t == HINGE]
        return np.array(self.nominal.jnt_axis[hinges[0]]) if hinges else np.array([0.0, 1.0, 0.0])

    def changed(self, p: Mapping[str, float], *, whole: bool = True) -> Any:
        """A copy of the specification with masses, lengths, damping and rotors of the parameters.

        Not `whole`, it lacks meshes that no inertia is made of.
        """
        spec = (self.spec if whole else self._light).copy()
        for body in self.bodies:
            own, share = spec.body(body), p[f"{MASS}_{body}"]
            longer = self._longer(body, p)
            _stretched(own, self.far(body), longer)
            for g in own.geoms:
                factor = share * (longer if np.isfinite(g.mass) and np.all(np.isfinite(g.fromto)) else 1.0)
                g.mass, g.density = g.mass * factor, g.density * factor
            own.mass, own.inertia = own.mass * share, own.inertia * share
            own.fullinertia = own.fullinertia * share
        for joint in self.joints:
            own = spec.joint(joint)
            own.damping = led_by(own.damping, p[f"{DAMPING}_{joint}"])
            own.armature = p[f"{ARMATURE}_{joint}"]
        return spec


def motor(n: Mapping[str, float]) -> dict[str, Any]:
    """Numbers of a DC motor at a joint: volts less those of its speed, over its resistance, times its constant.

    With a firmware's law the voltage is kp (command - q) + ki (its integral) - kd v, clamped at the supply's.
    """
    gear, constant = n.get("gear", 1.0), n["torque_constant"]
    per_volt = gear * constant / n["resistance"]
    kp, ki, kd = (n.get(key, 0.0) for key in LAW)
    is_law, most = any(key in n for key in LAW), abs(per_volt) * n.get("voltage", 0.0)
    return {
        "gain": [per_volt * (kp if is_law else 1.0), 0.0, 0.0], "bias": [0.0, -per_volt * kp, -per_volt * kd],
        "force": [-most, most] if is_law else [0.0, 0.0], "integral": per_volt * ki,
        "back": -per_volt * gear * n.get("back_emf", constant),
    }  # fmt: skip


def first(value: Any) -> float:
    """The value, or the first of it: MuJoCo 4 has coefficients of polynomials."""
    return float(np.ravel(value)[0])


def led_by(old: Any, value: float) -> Any:
    """The value; MuJoCo 4 has coefficients of a polynomial, of which it is the first."""
    if np.ndim(old) == 0:
        return value
    new = np.array(old)
    new.flat[0] = value
    return new


def _stretched(body: Any, far: Array, longer: float) -> None:
    """What a body holds, moved out along the line to its far end; a geom from end to end grows."""
    if longer == 1.0:
        return
    along = far / np.linalg.norm(far)

    def moved(at: Any) -> Array:
        return np.asarray(at + (longer - 1.0) * along * np.dot(along, at))

    for g in body.geoms:
        if np.all(np.isfinite(g.fromto)):
            g.fromto = np.concatenate([moved(g.fromto[:3]), moved(g.fromto[3:])])
        g.pos = moved(g.pos)
    body.ipos = moved(body.ipos)
    for child in body.bodies:
        child.pos = moved(child.pos)


def carried_by(m: Any, b: int) -> tuple[float, Array, Array]:
    """Mass, centre (3,) and inertia about it (3, 3) of a body of a compiled model, in the body's frame."""
    turn = _matrix(m.body_iquat[b])
    return float(m.body_mass[b]), np.array(m.body_ipos[b]), turn @ np.diag(m.body_inertia[b]) @ turn.T


def with_point(mass: float, centre: Array, inertia: Array, more: float, at: Array) -> tuple[float, Array, Array]:
    """Mass, centre and inertia about it of a body with a point mass added."""
    whole = mass + more
    if more == 0.0 or whole <= 0.0:
        return mass, centre, inertia
    off = at - centre
    share = mass * more / whole
    return whole, centre + more / whole * off, inertia + share * (np.dot(off, off) * np.eye(3) - np.outer(off, off))


def _matrix(quaternion: Any) -> Array:
    w, v = float(quaternion[0]), np.array(quaternion[1:], dtype=float)
    skew = np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])
    return np.asarray(np.eye(3) + 2.0 * w * skew + 2.0 * skew @ skew)


def about(axis: Array, angle: float) -> Array:
    """Matrix (3, 3) of a rotation about an axis by an angle in rad."""
    return _matrix(np.concatenate([[math.cos(0.5 * angle)], math.sin(0.5 * angle) * axis]))
