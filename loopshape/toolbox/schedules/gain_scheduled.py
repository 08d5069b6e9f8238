"""A gain-scheduled controller: one structure whose coefficients are interpolated over the operating point.

Interpolated are the coefficients of the blocks' polynomials in s (gains, time constants and their squares), each
linearly in each scheduling variable. Tustin's rule is linear in them too, so the interpolation of the sections as they
run is exactly this, and each operating point between the nodes has a controller of its own (`at`), with stable poles
where the nodes' are stable: positive coefficients stay positive.

It runs in direct form I, gains first: past signals are its state, so a change of coefficients is no step of the state.
Rugh and Shamma, Research on gain scheduling, Automatica 36 (2000), is the survey.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from functools import cached_property
from itertools import pairwise, permutations, product
from typing import TYPE_CHECKING, Any

import numpy as np

from loopshape.core.errors import WrongUseError, refuse_unknown
from loopshape.core.gate import pass_fields
from loopshape.core.units import UNITS, Array
from loopshape.data.control.block import Block, Section
from loopshape.data.control.controller import Controller, tustin

if TYPE_CHECKING:
    from loopshape.toolbox.schedules.kernel import Scheduled

#: time constant in s of the lag behind which the scheduling variables act, where none is given
LAG_S = 0.1
_FACTORS: dict[str, float] = {}
for _unit, (_, _factor) in UNITS.items():
    _FACTORS.setdefault(_unit.lower(), _factor)


class Follows(StrEnum):
    """What of a loop a scheduling variable follows."""

    REFERENCE = "reference"
    OUTPUT = "output"


@dataclass(frozen=True)
class Variable:
    """A scheduling variable: its name in an operating point, its knots, and the loop whose signal it follows.

    A name that ends in a unit (`theta_deg`) is in that unit, the signal in the stored one. Following the reference
    adds no feedback; following the output does, which no frozen operating point shows.
    """

    name: str
    knots: tuple[float, ...]
    loop: str
    follows: Follows = Follows.REFERENCE

    def __post_init__(self) -> None:
        pass_fields(self)
        object.__setattr__(self, "knots", tuple(float(k) for k in self.knots))
        refuse_unknown(f"what {self.name} follows of a loop is not known", self.follows, Follows)
        object.__setattr__(self, "follows", Follows(self.follows))
        if not self.knots or not np.all(np.isfinite(self.knots)) or any(b <= a for a, b in pairwise(self.knots)):
            raise WrongUseError(
                f"knots of {self.name} must be finite and strictly increasing", f"{list(self.knots)}", "sort them"
            )

    @property
    def per_stored(self) -> float:
        """The variable's own unit in the stored one's."""
        return 1.0 / _FACTORS.get(self.name.rpartition("_")[2], 1.0)


@dataclass(frozen=True, eq=False)
class GainScheduled:
    """Controllers of one structure at the nodes of a grid of operating points, interpolated between them.

    `controllers` stand in the order of the nodes, the last variable fastest. Outside the grid the nearest edge holds.
    `lag_s` is the time constant of the lag behind which the scheduling variables act: a step of a reference moves the
    coefficients smoothly. Refuses nodes of other structures, rates or timing, and a gain that changes its sign.

    Misleads: margins of frozen operating points say nothing of how fast the operating point may move; they hold where
    it moves slowly beside the loop.
    """

    loop: str
    variables: tuple[Variable, ...]
    controllers: tuple[Controller, ...]
    lag_s: float = LAG_S

    def __post_init__(self) -> None:
        pass_fields(self)
        object.__setattr__(self, "variables", tuple(self.variables))
        object.__setattr__(self, "controllers", tuple(self.controllers))
        if not 1 <= len(self.variables) <= 3:
            raise WrongUseError("a schedule has one to three variables", f"{len(self.variables)}", "choose those")
        nodes = int(np.prod(self.shape))
        if nodes != len(self.controllers):
            raise WrongUseError(
                "a schedule has one controller for each node of its grid",
                f"{len(self.controllers)} controllers, {nodes} nodes",
                "tune one there, or take the nearest node's",
            )
        if not (np.isfinite(self.lag_s) and self.lag_s >= 0.0):
            raise WrongUseError("lag_s of a schedule must not be negative", f"{self.lag_s!r}", "give it in s")
        _check_alike(self.controllers)

    def __repr__(self) -> str:
        """One line: its loop, its blocks, and the grid."""
        kinds = ", ".join(block.kind for block in self.controllers[0].blocks)
        grid = ", ".join(f"{v.name} {v.knots[0]:g} to {v.knots[-1]:g} ({len(v.knots)})" for v in self.variables)
        return f"GainScheduled {self.loop}: {kinds} over {grid}"

    @property
    def shape(self) -> tuple[int, ...]:
        """Number of knots of each variable."""
        return tuple(len(v.knots) for v in self.variables)

    @property
    def rate_hz(self) -> float:
        """Rate of all of its controllers."""
        return self.controllers[0].rate_hz

    @property
    def nodes(self) -> tuple[dict[str, float], ...]:
        """Operating points of the controllers, in their order."""
        names = [v.name for v in self.variables]
        return tuple(dict(zip(names, at, strict=True)) for at in product(*(v.knots for v in self.variables)))

    def at(self, operating_point: Mapping[str, float]) -> Controller:
        """The controller of a frozen operating point, as it runs there; a node's is the node's own.

        Refuses an operating point without one of the scheduling variables.
        """
        if missing := [v.name for v in self.variables if v.name not in operating_point]:
            raise WrongUseError(
                f"an operating point of the schedule of loop {self.loop!r} names its variables",
                f"no {', '.join(missing)} in {dict(operating_point)}",
                f"give {', '.join(v.name for v in self.variables)}",
            )
        weights = self._weights([float(operating_point[v.name]) for v in self.variables])
        if len(weights) == 1:
            return self.controllers[next(iter(weights))]
        first = self.controllers[0]
        blocks = []
        for k in range(len(first.blocks)):
            num, den = (
                sum(w * self._sections[node, k, side] for node, w in weights.items()) for side in (0, 1)
            )  # fmt: skip
            names = ("n0", "n1", "n2", "d0", "d1", "d2")
            blocks.append(Block("section", dict(zip(names, [*num, *den], strict=True))))
        return Controller(
            self.loop, tuple(blocks), first.rate_hz, prewarp_hz=first.prewarp_hz,
            computation_delay_s=first.computation_delay_s, added_hold=first.added_hold,
        )  # fmt: skip

    def frozen(self, between: int = 0) -> tuple[dict[str, float], ...]:
        """Operating points of a dense grid: the nodes, and so many more between each two neighbouring knots."""
        axes = [_refined(v.knots, between) for v in self.variables]
        names = [v.name for v in self.variables]
        return tuple(dict(zip(names, at, strict=True)) for at in product(*axes))

    def largest_step(self) -> float:
        """Largest change of the output within one tick, per unit of constant error, of a jump between any two nodes.

        Without the lag, which makes it smaller still. Where a section integrates no error is constant but zero, and the
        answer is that of the other sections with the integrator's own output held.
        """
        table = self.tables(())
        most = 0.0
        for before, after in permutations(range(len(self.controllers)), 2):
            most = max(most, _step_of(table, before, after))
        return most

    def tables(self, signals: Sequence[tuple[str, Follows]]) -> Scheduled:
        """Tables for the kernels, from signals (loop, what of it) in stored units; refuses a variable of none of them.

        Without signals for what needs no variable.
        """
        from loopshape.toolbox.schedules.kernel import Scheduled

        known = list(signals)
        picks = np.zeros((len(self.variables), len(known)))
        for k, v in enumerate(self.variables):
            if (v.loop, v.follows) in known:
                picks[k, known.index((v.loop, v.follows))] = v.per_stored
            elif known:
                raise WrongUseError(
                    f"{v.name} of the schedule of loop {self.loop!r} follows a signal that is not there",
                    f"{v.follows} of loop {v.loop!r}",
                    f"loops are {', '.join(dict.fromkeys(loop for loop, _ in known))}",
                )
        most = max(self.shape)
        knots = np.array([[*v.knots, *[np.nan] * (most - len(v.knots))] for v in self.variables])
        n = len(self.controllers[0].blocks)
        return Scheduled(
            knots, np.array(self.shape, dtype=np.int64), self.coefficients, picks, self.share,
            np.full(len(self.variables), np.nan), np.zeros((n, 5)), np.zeros((n + 1, 2)),
        )  # fmt: skip

    def to_table(self) -> dict[str, Any]:
        """The keys of its table in a file, beside the name of its loop and the rate."""
        from loopshape.toolbox.schedules.table import schedule_table

        return schedule_table(self)

    @property
    def share(self) -> float:
        """Of what is left to the variables' values, what the lag takes in a tick."""
        return 1.0 if self.lag_s == 0.0 else float(-np.expm1(-1.0 / (self.rate_hz * self.lag_s)))

    @cached_property
    def coefficients(self) -> Array:
        """b0 b1 b2 a0 a1 a2 (nodes, sections, 6) as they run, gains first: with the smoothing blocks behind them."""
        k = self.controllers[0].tustin_constant
        order = _gains_first(self.controllers[0].blocks)
        rows = [
            [np.concatenate(tustin(_plain(self._sections[node, j]), k)) for j in order]
            for node in range(len(self.controllers))
        ]
        return np.array(rows)

    @cached_property
    def _sections(self) -> Array:
        """Polynomials (nodes, sections, 2, 3) with the denominator's first coefficient that is not zero at 1."""
        out = np.array([[block.section() for block in c.blocks] for c in self.controllers])
        for node, section in product(range(out.shape[0]), range(out.shape[1])):
            den = out[node, section, 1]
            out[node, section] /= den[np.flatnonzero(den)[0]]
        return out

    def _weights(self, at: Sequence[float]) -> dict[int, float]:
        """Weight of each node that counts at a place of the variables."""
        from loopshape.toolbox.schedules.kernel import interval

        sides = []
        for v, value in zip(self.variables, at, strict=True):
            k, share = interval(np.array(v.knots), len(v.knots), value)
            sides.append([(k, 1.0 - share), (min(k + 1, len(v.knots) - 1), share)])
        out: dict[int, float] = {}
        for corner in product(*sides):
            weight = float(np.prod([w for _, w in corner]))
            node = int(np.ravel_multi_index([k for k, _ in corner], self.shape))
            if weight > 0.0:
                out[node] = out.get(node, 0.0) + weight
        return out


def _step_of(table: Scheduled, before: int, after: int) -> float:
    """Change of the output within a tick as one node's coefficients become another's, at a constant input of 1."""
    from loopshape.toolbox.schedules.kernel import step

    value = 1.0
    table.past[0] = value
    for k, (b0, b1, b2, a0, a1, a2) in enumerate(table.sections[before]):
        rest = a0 + a1 + a2
        value = value * (b0 + b1 + b2) / rest if abs(rest) > 1e-12 * abs(a0) else 0.0
        table.past[k + 1] = value
    six = table.sections[after]
    table.now[:] = np.delete(six / six[:, 3:4], 3, axis=1)
    return abs(step(table, 1.0) - value)


def _gains_first(blocks: Sequence[Block]) -> list[int]:
    return sorted(range(len(blocks)), key=lambda k: blocks[k].kind != "gain")


def _plain(section: Array) -> Section:
    num, den = section.tolist()
    return (num[0], num[1], num[2]), (den[0], den[1], den[2])


def _refined(knots: Sequence[float], between: int) -> list[float]:
    inner = [np.linspace(a, b, between + 2)[:-1].tolist() for a, b in pairwise(knots)]
    return [*(x for part in inner for x in part), knots[-1]]


def _shape_of(block: Block) -> tuple[str, tuple[bool, ...]]:
    num, den = block.section()
    return block.kind, tuple(c != 0.0 for c in (*num, *den))


def _check_alike(controllers: Sequence[Controller]) -> None:
    first = controllers[0]
    for one in controllers:
        if [_shape_of(b) for b in one.blocks] != [_shape_of(b) for b in first.blocks]:
            raise WrongUseError(
                "the controllers of a schedule have one structure",
                f"{', '.join(b.kind for b in first.blocks)}; {', '.join(b.kind for b in one.blocks)}",
                "tune the same blocks at each operating point",
            )
        alike = ("rate_hz", "prewarp_hz", "computation_delay_s", "added_hold", "precision")
        if other := [name for name in alike if getattr(one, name) != getattr(first, name)]:
            raise WrongUseError("the controllers of a schedule run alike", ", ".join(other), "give all the same")
        signs = [np.sign(b.parameters["gain"]) for b in one.blocks if "gain" in b.parameters]
        if signs != [np.sign(b.parameters["gain"]) for b in first.blocks if "gain" in b.parameters]:
            raise WrongUseError("a gain of a schedule changes its sign", repr(one), "between them it would be zero")
    if first.precision != "double":
        raise WrongUseError("a schedule runs in double precision", repr(first.precision), "leave the precision out")
