"""Equations of motion of a tree of hinges and slides, written out as Python source (Newton-Euler, Featherstone 2008).

Every number of the tree is a float, or a name where it depends on the model's parameters. What vanishes is left out:
a planar arm of two joints has some fifty operations.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from loopshape.toolbox.gap.mechanism.tracing import (
    Row,
    Scalar,
    Tape,
    Term,
    add,
    cross,
    dot,
    product,
    solved,
    times,
    transposed,
    turned,
)  # fmt: skip

_HINGE = 3  # mjJNT_HINGE


@dataclass(frozen=True)
class Joint:
    """A hinge or a slide along a unit axis (3,): its passive forces and the rotor's inertia.

    Dry friction is `dry` * tanh(speed / (`creep` * `dry`)).
    """

    is_hinge: bool
    axis: Row
    damping: Scalar
    stiffness: Scalar
    rest: Scalar
    armature: Scalar
    zero: Scalar
    dry: Scalar = 0.0
    creep: float = 1.0


@dataclass(frozen=True)
class Link:
    """A rigid body on one joint, or on none.

    `parent` is a place in the list, -1 the ground; `origin` (3,) and `rotation` (3, 3) place it in its parent's frame;
    mass in kg, centre of mass (3,) in m from its own origin, inertia (3, 3) about it in kg m2.
    """

    parent: int
    origin: Row
    rotation: list[Row]
    joint: Joint | None
    mass: Scalar
    centre: Row
    inertia: list[Row]


def chained(m: Any, n: Mapping[str, Any], creep: list[float]) -> list[Link]:
    """Bodies of a compiled model as links: one a joint, its origin at the anchor; a body's last joint has its mass."""
    links: list[Link] = []
    last, anchor_of = {0: -1}, {0: [0.0, 0.0, 0.0]}
    nothing, straight = [[0.0] * 3] * 3, [[float(i == k) for k in range(3)] for i in range(3)]
    for b in range(1, m.nbody):
        parent, count = int(m.body_parentid[b]), int(m.body_jntnum[b])
        above, shift, rotation = last[parent], anchor_of[parent], n[f"r{b}"]
        origin = [o - s for o, s in zip(n[f"o{b}"], shift, strict=True)]
        anchor = [0.0, 0.0, 0.0]
        for j in range(int(m.body_jntadr[b]), int(m.body_jntadr[b]) + count):
            new = n["anchor"][j] if m.jnt_type[j] == _HINGE else [0.0, 0.0, 0.0]
            step = [a - s for a, s in zip(new, anchor, strict=True)]
            origin = [o + sum((r * s for r, s in zip(row, step, strict=True)), 0.0)
                      for o, row in zip(origin, rotation, strict=True)]  # fmt: skip
            links.append(Link(above, origin, rotation, _joint(m, n, j, creep[j]), 0.0, [0.0] * 3, nothing))
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


def _joint(m: Any, n: Mapping[str, Any], j: int, creep: float) -> Joint:
    numbers = [n[name][j] for name in ("damping", "stiffness", "rest", "armature", "zero", "frictionloss")] + [creep]
    return Joint(bool(m.jnt_type[j] == _HINGE), n["axis"][j], *numbers)


def source(links: Sequence[Link], gravity: Sequence[Scalar], efforts: Row, rates: Row, tape: Tape) -> str:
    """Source of `motion(t, x, u, p)`: positions, speeds, then states of actuators.

    `efforts` act on each joint; `rates` are the derivatives of the actuators' states.
    """
    joints = [k.joint for k in links if k.joint is not None]
    n = len(joints)
    q = [tape.name(f"x[{k}]") - j.zero for k, j in enumerate(joints)]
    v: Row = [tape.name(f"x[{n + k}]") for k in range(n)]
    still, down = [0.0] * n, times(-1.0, gravity)
    bias = _efforts(links, _turns(links, q, tape), v, still, down, q)
    columns = [
        _efforts(links, _turns(links, q, tape), still, [float(i == k) for i in range(n)], [0.0] * 3, q)
        for k in range(n)
    ]
    matrix = [[columns[k][i] + (joints[i].armature if i == k else 0.0) for k in range(n)] for i in range(n)]
    acting = []
    for k, j in enumerate(joints):
        spring = j.stiffness * (tape.name(f"x[{k}]") - j.rest)
        acting.append(efforts[k] - j.damping * v[k] - spring - bias[k] - _dry(j, v[k], tape))
    found = solved(matrix, acting)
    returned = ", ".join(getattr(value, "text", repr(value)) for value in (*v, *found, *rates))
    return "\n    ".join(["def motion(t, x, u, p):", *tape.lines, f"return ({returned},)\n"])


def laws(efforts: Mapping[int, Scalar], tape: Tape) -> str:
    """Source of `law(j, q, v, x, u, p)`: efforts that actuators give at joint j, 0 where there is none."""
    each = [f"if j == {j}:\n        return {getattr(value, 'text', repr(value))}" for j, value in efforts.items()]
    return "\n    ".join(["def law(j, q, v, x, u, p):", *tape.lines, *each, "return 0.0\n"])


def _dry(joint: Joint, speed: Scalar, tape: Tape) -> Scalar:
    """Dry friction against the speed, smooth about 0."""
    if not isinstance(joint.dry, Term) and joint.dry == 0.0:
        return 0.0
    slow = speed / (joint.creep * joint.dry + 1e-12)  # speed, so that no friction divides by nothing
    return joint.dry * tape.value(f"math.tanh({slow.text})")


def _turns(links: Sequence[Link], q: Row, tape: Tape) -> list[list[Row]]:
    """Rotation of each link's frame into its parent's."""
    out, k = [], 0
    for link in links:
        rotation = link.rotation
        if link.joint is not None:
            if link.joint.is_hinge:
                angle = getattr(q[k], "text", repr(q[k]))
                rotation = product(rotation, _about(link.joint.axis, f"math.cos({angle})", f"math.sin({angle})", tape))
            k += 1
        out.append(rotation)
    return out


def _about(axis: Row, cosine: str, sine: str, tape: Tape) -> list[Row]:
    """Rotation about an axis (Rodrigues)."""
    c, s = tape.value(cosine), tape.value(sine)
    x, y, z = axis
    skew = [[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]]
    unit = [[float(i == k) for k in range(3)] for i in range(3)]
    return [
        [c * (unit[i][k] - axis[i] * axis[k]) + axis[i] * axis[k] + s * skew[i][k] for k in range(3)] for i in range(3)
    ]


def _efforts(links: Sequence[Link], turns: Sequence[list[Row]], v: Row, a: Row, ground: Row, q: Row) -> Row:
    """Efforts at the joints that speeds v and accelerations a need, from an acceleration of the ground (3,)."""
    moved: list[tuple[Row, Row, Row]] = []
    k = 0
    for link, turn in zip(links, turns, strict=True):
        spin, twist, lift = moved[link.parent] if link.parent >= 0 else ([0.0] * 3, [0.0] * 3, ground)
        own = [0.0, 0.0, 0.0] if link.joint is None else [q[k], v[k], a[k]]
        k += link.joint is not None
        moved.append(_carried(link, transposed(turn), (spin, twist, lift), own))
    forces = [_needed(link, state) for link, state in zip(links, moved, strict=True)]
    for i in reversed(range(len(links))):
        if links[i].parent >= 0:
            forces[links[i].parent] = _handed(links[i], turns[i], forces[i], forces[links[i].parent], q, links, i)
    hands = [(link.joint, f) for link, f in zip(links, forces, strict=True) if link.joint is not None]
    return [dot(j.axis, moment if j.is_hinge else force) for j, (force, moment) in hands]


def _place(link: Link, position: Scalar) -> Row:
    """The link's origin in its parent's frame."""
    if link.joint is None or link.joint.is_hinge:
        return link.origin
    return add(link.origin, turned(link.rotation, times(position, link.joint.axis)))


def _carried(link: Link, into: list[Row], parent: tuple[Row, Row, Row], own: Row) -> tuple[Row, Row, Row]:
    """Spin, its derivative, and acceleration of the link's origin, in the link's frame."""
    spin, twist, lift = parent
    o = _place(link, own[0])
    lift = turned(into, add(lift, cross(twist, o), cross(spin, cross(spin, o))))
    spin, twist = turned(into, spin), turned(into, twist)
    if link.joint is None:
        return spin, twist, lift
    speed, rise = times(own[1], link.joint.axis), times(own[2], link.joint.axis)
    if link.joint.is_hinge:
        return add(spin, speed), add(twist, rise, cross(spin, speed)), lift
    return spin, twist, add(lift, rise, times(2.0, cross(spin, speed)))


def _needed(link: Link, state: tuple[Row, Row, Row]) -> tuple[Row, Row]:
    """Force, and moment about the link's origin, that its own mass needs."""
    spin, twist, lift = state
    c = link.centre
    force = times(link.mass, add(lift, cross(twist, c), cross(spin, cross(spin, c))))
    about = add(turned(link.inertia, twist), cross(spin, turned(link.inertia, spin)))
    return force, add(about, cross(c, force))


def _handed(
    link: Link, turn: list[Row], mine: tuple[Row, Row], theirs: tuple[Row, Row], q: Row, links: Sequence[Link], i: int
) -> tuple[Row, Row]:
    """The parent's force and moment with those of a link that hangs on it."""
    k = sum(other.joint is not None for other in links[:i])
    force = turned(turn, mine[0])
    o = _place(link, q[k] if link.joint is not None else 0.0)
    return add(theirs[0], force), add(theirs[1], turned(turn, mine[1]), cross(o, force))
