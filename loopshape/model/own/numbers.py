"""What MuJoCo makes of a model under given parameters: masses, places, inertias, joints, gravity, as arrays.

MuJoCo compiles a changed copy of the specification for every set of parameters; point masses and the lean of the base
are added to what it gives.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from threading import Lock
from typing import Any

import numpy as np

from loopshape.core.units import Array
from loopshape.data.machine import Mechanism

MASS, PAYLOAD, PLACE, LENGTH = "mass", "payload", "place", "length"
DAMPING, ARMATURE, TILT = "damping", "armature", "tilt"
HINGE, SLIDE = 3, 2  # mjJNT_HINGE, mjJNT_SLIDE


@dataclass(frozen=True, eq=False)
class Numbers:
    """A mechanism, and the numbers that MuJoCo makes of it under given parameters."""

    of: Mechanism

    @cached_property
    def nominal(self) -> Any:
        """The compiled model."""
        return self.of.spec.compile()

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
        own = self.of.spec.body(body)
        ends = [np.array(g.fromto[3 * k : 3 * k + 3]) for g in own.geoms for k in (0, 1)]
        ends = [e for e in ends if np.all(np.isfinite(e))]
        ends += [np.array(child.pos) for child in own.bodies] or [np.zeros(3)]
        return np.asarray(max(ends, key=lambda e: float(np.linalg.norm(e))), dtype=float)

    def at(self, p: Mapping[str, float]) -> dict[str, Any]:
        """Arrays by name under parameters, as MuJoCo compiles them; payloads and tilt are added to what it gives."""
        with self._lock:
            m = self._changed(p).compile()
        out: dict[str, Any] = {}
        for b in range(1, m.nbody):
            turn = _matrix(m.body_iquat[b])
            name = m.body(b).name
            mass, centre, inertia = _with_point(
                float(m.body_mass[b]), np.array(m.body_ipos[b]), turn @ np.diag(m.body_inertia[b]) @ turn.T,
                p.get(f"{PAYLOAD}_{name}", 0.0), self._at(name, p) if name else np.zeros(3),
            )  # fmt: skip
            out |= {f"m{b}": mass, f"c{b}": centre, f"i{b}": inertia, f"o{b}": np.array(m.body_pos[b])}
            out[f"r{b}"] = _matrix(m.body_quat[b])
        out |= {
            "damping": np.ravel(m.dof_damping), "armature": np.array(m.dof_armature),
            "stiffness": np.ravel(m.jnt_stiffness), "rest": np.array(m.qpos_spring), "zero": np.array(m.qpos0),
            "axis": np.array(m.jnt_axis), "anchor": np.array(m.jnt_pos),
        }  # fmt: skip
        out["gravity"] = _about(self.tilt_axis, -p.get(TILT, 0.0)) @ np.array(m.opt.gravity)
        return out

    def _longer(self, body: str, p: Mapping[str, float]) -> float:
        """Its length over the nominal one."""
        return 1.0 + p.get(f"{LENGTH}_{body}", 0.0) / max(float(np.linalg.norm(self.far(body))), 1e-12)

    def _at(self, body: str, p: Mapping[str, float]) -> Array:
        """Where its payload sits (3,)."""
        return p.get(f"{PLACE}_{body}", 1.0) * self._longer(body, p) * self.far(body)

    @cached_property
    def tilt_axis(self) -> Array:
        """Axis of the first hinge: the base leans about it."""
        hinges = [k for k, t in enumerate(self.nominal.jnt_type) if t == HINGE]
        return np.array(self.nominal.jnt_axis[hinges[0]]) if hinges else np.array([0.0, 1.0, 0.0])

    def _changed(self, p: Mapping[str, float]) -> Any:
        """A copy of the specification with masses, lengths, damping and rotors of the parameters."""
        spec = self.of.spec.copy()
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
            own.damping = _led_by(own.damping, p[f"{DAMPING}_{joint}"])
            own.armature = p[f"{ARMATURE}_{joint}"]
        return spec


def first(value: Any) -> float:
    """The value, or the first of it: MuJoCo 4 has coefficients of polynomials."""
    return float(np.ravel(value)[0])


def _led_by(old: Any, value: float) -> Any:
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


def _with_point(mass: float, centre: Array, inertia: Array, more: float, at: Array) -> tuple[float, Array, Array]:
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


def _about(axis: Array, angle: float) -> Array:
    return _matrix(np.concatenate([[math.cos(0.5 * angle)], math.sin(0.5 * angle) * axis]))
