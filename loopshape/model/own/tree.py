"""Equations of motion of a tree of hinges and slides, written out as Python source (Newton-Euler, Featherstone 2008).

Every number of the tree is a float, or a name where it depends on the model's parameters. What vanishes is left out:
a planar arm of two joints has some fifty operations.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from loopshape.model.own.tracing import (
    Row,
    Scalar,
    Tape,
    add,
    cross,
    dot,
    product,
    solved,
    times,
    transposed,
    turned,
)  # fmt: skip


@dataclass(frozen=True)
class Joint:
    """A hinge or a slide along a unit axis (3,): its passive forces and the rotor's inertia."""

    is_hinge: bool
    axis: Row
    damping: Scalar
    stiffness: Scalar
    rest: Scalar
    armature: Scalar
    zero: Scalar


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


def source(links: Sequence[Link], gravity: Sequence[Scalar], efforts: Sequence[Sequence[int]], tape: Tape) -> str:
    """Source of `motion(t, x, u, p)`: positions, then speeds; `efforts` are the inputs that act on each joint."""
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
        drive = dot([tape.name(f"u[{i}]") for i in efforts[k]], [1.0] * len(efforts[k]))
        spring = j.stiffness * (tape.name(f"x[{k}]") - j.rest)
        acting.append(drive - j.damping * v[k] - spring - bias[k])
    found = solved(matrix, acting)
    returned = ", ".join(getattr(value, "text", repr(value)) for value in (*v, *found))
    return "\n    ".join(["def motion(t, x, u, p):", *tape.lines, f"return ({returned},)\n"])


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
