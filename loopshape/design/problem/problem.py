"""A tuning problem: free parameters of a structure, measured plants, and L with its exact slopes.

Parameters are optimised as logarithms. All lines of all operating points lie in one flat array, so one
evaluation is a handful of array operations.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from loopshape.core.kernels.loops import flat_loops as kernel
from loopshape.core.kernels.loops import tuning_rows as rows
from loopshape.core.units import Array, ComplexArray, from_db
from loopshape.data.control.block import BlockTemplate
from loopshape.data.control.controller import Block, Controller, controller_grid_hz
from loopshape.data.requirement.limits_over import MASKED, weights
from loopshape.data.requirement.requirements import LIMIT_OF, Requirements
from loopshape.design import structure
from loopshape.design.structure import Variable
from loopshape.loop.loop import Loop, above_hz
from loopshape.loop.margin.between import between_lines
from loopshape.loop.stability.low_end import low_hz, low_models
from loopshape.loop.tolerances import TOL


class Opened(NamedTuple):
    """What disturbs a loop, with the loop open: frequencies (n,) in Hz and power (n,) in the output's unit squared.

    `samples` is the length of its record, nan where it has none; `low` and `high` are the room of the plant's input
    below and above its mean, in its unit.
    """

    f: Array
    power: Array
    samples: float
    low: float
    high: float


@dataclass(frozen=True, eq=False)
class Problem:
    """Plants on flat lines, the structure, and the requirements of one loop.

    `first` (points + 1,) are the places where operating points begin in the flat arrays; `line` maps each
    flat line to its unique frequency, at which the controller is evaluated once. `below` (points,) counts the lines
    before the measured ones on which a model leads towards the negative real axis at 0 Hz. The arrays with `below` do
    the same for the models' lines below the measured ones, which only the count of encirclements sees: the fit's where
    `fitted` (points,), else those of a small model of the lowest lines. Those with `beyond` are for less sure lines
    above, where |L| may not come up to 1 again. `radius` is the radius of the 95 % circle of P at each flat line: -1
    must lie outside that of L. `places` (points,) are the operating points' coordinates, `opened` (points,) what
    disturbs each with the loop open, None where that is not known.
    """

    requirements: Requirements
    templates: tuple[BlockTemplate, ...]
    variables: tuple[Variable, ...]
    unit: Controller
    precision: str
    names: tuple[str, ...]
    f: Array
    P: ComplexArray
    radius: Array
    first: np.ndarray
    below: np.ndarray
    unique_f: Array
    unique_s: ComplexArray
    line: np.ndarray
    integrators: np.ndarray
    unstable: np.ndarray
    fitted: np.ndarray
    P_below: ComplexArray
    s_below: ComplexArray
    first_below: np.ndarray
    f_above: Array
    f_beyond: Array
    P_beyond: ComplexArray
    owner_beyond: np.ndarray
    f_wide: Array
    places: tuple[Mapping[str, float], ...]
    opened: tuple[Opened | None, ...]

    @cached_property
    def each(self) -> tuple[Requirements, ...]:
        """What is required at each operating point."""
        return tuple(self.requirements.of(place) for place in self.places)

    @cached_property
    def limits(self) -> dict[str, Array]:
        """Limit of each quantity at each operating point (points,); where it has none one that nothing misses."""
        every = {name: [getattr(one, name) for one in self.each] for name in self.requirements.limited()}
        return {
            name: np.array([_none(name) if value is None else value for value in values], dtype=float)
            for name, values in every.items()
            if any(value is not None for value in values)
        }

    @cached_property
    def masks(self) -> dict[str, Array]:
        """ln of each mask on the flat lines, +inf without one (of the floor -inf)."""
        cut = zip(self.each, self.first[:-1], self.first[1:], strict=True)
        return self._masks([_ln_masks(one, self.f[a:b]) for one, a, b in cut], np.concatenate)

    @cached_property
    def masks_above(self) -> dict[str, Array]:
        """ln of each mask (points, above) above the last lines, +inf without one and below a point's last line."""
        last = self.f[self.first[1:] - 1]
        levels = [_ln_masks(one, self.f_above) for one in self.each]
        for level, f in zip(levels, last, strict=True):
            level[:, self.f_above < f] = np.inf
        return self._masks(levels, np.stack)

    def _masks(self, levels: list[Array], put: Callable[[list[Array]], Array]) -> dict[str, Array]:
        return {name: put([level[k] for level in levels]) for k, name in enumerate(MASKED) if name in self.limits}

    @cached_property
    def low(self) -> Array:
        """Lower bounds of x."""
        return np.log([v.low for v in self.variables])

    @cached_property
    def high(self) -> Array:
        """Upper bounds of x."""
        return np.log([v.high for v in self.variables])

    @property
    def points(self) -> int:
        """How many operating points there are."""
        return len(self.names)

    @cached_property
    def owner(self) -> np.ndarray:
        """Operating point of each flat line."""
        return np.repeat(np.arange(self.points), np.diff(self.first))

    @cached_property
    def ln_P(self) -> Array:
        """ln |P| on the flat lines."""
        return np.log(np.abs(self.P))

    @cached_property
    def ln_circle(self) -> Array:
        """ln of the radius of P's 95 % circle on the flat lines, -inf where it is known."""
        with np.errstate(divide="ignore"):
            return np.log(self.radius)

    @cached_property
    def ln_f(self) -> Array:
        """ln f on the flat lines."""
        return np.log(self.f)

    @cached_property
    def inside(self) -> np.ndarray:
        """Which flat lines have the next one at the same operating point, all but the last."""
        return np.diff(self.owner) == 0

    @cached_property
    def s(self) -> ComplexArray:
        """Columns: every s at which the controller is looked at (unique lines, above, beyond, wide)."""
        grid = np.concatenate([self.f_above, self.f_beyond, self.f_wide])
        return np.concatenate([self.unique_s, self.unit.s_at(grid)])

    @cached_property
    def outside(self) -> ComplexArray | None:
        """What follows the sections on the columns, 1 on the wide ones: delay and added hold; None without."""
        return self._outside(np.concatenate([self.unique_f, self.f_above, self.f_beyond]), self.f_wide.size)

    def _outside(self, f: Array, ones: int) -> ComplexArray | None:
        if not (self.unit.computation_delay_s or self.unit.added_hold):
            return None
        return np.concatenate([self.unit.outside(f), np.ones(ones)])

    @cached_property
    def above(self) -> slice:
        """Columns above the last line, up to 0.45 of the rate."""
        return slice(self.unique_s.size, self.unique_s.size + self.f_above.size)

    @cached_property
    def beyond(self) -> slice:
        """Columns of the less sure lines above those that are judged."""
        return slice(self.above.stop, self.above.stop + self.f_beyond.size)

    @cached_property
    def wide(self) -> slice:
        """Columns on which the bandwidth of C is read; none where it is not limited."""
        return slice(self.beyond.stop, self.s.size)

    def values(self, x: Array) -> list[dict[str, float]]:
        """Parameters of each block at x."""
        return structure.values_at(self.templates, self.variables, x)

    def blocks(self, x: Array) -> tuple[Block, ...]:
        """Blocks at x."""
        return tuple(Block(t.kind, own) for t, own in zip(self.templates, self.values(x), strict=True))

    def controller(self, x: Array) -> Controller:
        """Controller at x."""
        return replace(self.unit, blocks=self.blocks(x), precision=self.precision)

    def asked(self, requirements: Requirements) -> Problem:
        """The same plants and structure under other limits."""
        return replace(self, requirements=requirements, f_wide=_wide(requirements, self.unit.rate_hz))

    def place(self, at: int, point: int) -> tuple[str, float]:
        """Operating point (-1: every one) and frequency in Hz of a flat line, or of a column above all lines."""
        name = self.names[point] if point >= 0 else "every operating point"
        if at < self.f.size:
            return name, float(self.f[at])
        return name, float(np.concatenate([self.f_above, self.f_beyond, self.f_wide])[at - self.f.size])

    def slopes(self, values: Sequence[Mapping[str, float]], columns: np.ndarray) -> ComplexArray:
        """d ln C/d x (variables, columns) at blocks' parameters, exact; without integral terms on the wide columns."""
        changes = structure.section_changes(self.templates, self.variables, values)
        out = kernel.log_slopes(structure.sections(self.templates, values), changes, self._block_of, self.s[columns])
        wide = np.flatnonzero(columns >= self.wide.start)
        if wide.size:
            blocks = {k: Block(self.templates[k].kind, values[k]) for k in {v.block for v in self.variables}}
            by_block = {k: block.log_slopes(self.s[columns[wide]], bounded=True) for k, block in blocks.items()}
            for row, v in zip(out, self.variables, strict=True):
                names = structure.moved_with(self.templates[v.block], v.name)
                row[wide] = values[v.block][v.name] * sum(by_block[v.block][name] for name in names)
        return out

    def row_slopes(
        self, values: Sequence[Mapping[str, float]], i: np.ndarray, a: ComplexArray, j: np.ndarray, b: ComplexArray
    ) -> Array:
        """Re(a d ln C_i/d x + b d ln C_j/d x), (m, variables), of columns i and j (m,)."""
        if max(i.max(initial=0), j.max(initial=0)) >= self.wide.start:
            D = self.slopes(values, np.concatenate([i, j]))
            return np.real(a * D[:, : i.size] + b * D[:, i.size :]).T
        changes = structure.section_changes(self.templates, self.variables, values)
        places, ab = np.stack([i, j], axis=1), np.stack([a, b], axis=1)
        return rows.row_slopes(structure.sections(self.templates, values), changes, self._block_of, self.s, places, ab)

    @cached_property
    def _block_of(self) -> np.ndarray:
        return np.array([v.block for v in self.variables])

    @cached_property
    def coarse(self) -> Problem:
        """The same on fewer lines, for races: between them ln P runs straight over ln f, or is not known better.

        Itself where that would leave most of the lines.
        """
        cut = zip(self.first[:-1], self.first[1:], strict=True)
        phase = np.concatenate([np.unwrap(np.angle(self.P[a:b])) for a, b in cut])
        with np.errstate(divide="ignore", invalid="ignore"):
            off = np.maximum(STRAIGHT, self.radius / np.abs(self.P))
        below = [np.arange(a, a + n + 1) for a, n in zip(self.first, self.below, strict=False)]
        keep = np.union1d(kernel.thinned(self.ln_f, self.ln_P, phase, off, self.first, GAP), np.concatenate(below))
        if keep.size > WORTH * self.f.size:
            return self
        columns, line = np.unique(self.line[keep], return_inverse=True)
        return replace(
            self,
            f=self.f[keep],
            P=self.P[keep],
            radius=self.radius[keep],
            first=np.searchsorted(keep, self.first),
            unique_f=self.unique_f[columns],
            unique_s=self.unique_s[columns],
            line=line,
        )


#: a limit in dB that nothing comes up to
NONE_DB = 300.0
#: where L is led below its first line, as shares of its frequency
BELOW_RATIOS = np.geomspace(1e-3, 1.0, 16, endpoint=False)
#: places between lines are looked at where P moves by more than this share of itself, so many a gap at most
STEEP, BETWEEN = 0.5, 6
#: lines of a race: ln P may lie off a straight line between them by this, they lie no farther apart than this in ln f,
#: and they are worth their while where they are no more than this share of all
STRAIGHT, GAP, WORTH = 0.02, 0.08, 0.6


def problem(
    loops: Sequence[Loop],
    requirements: Requirements,
    rate_hz: float,
    precision: str = "double",
    opened: Sequence[Opened | None] = (),
) -> Problem:
    """Problem from loops and requirements with a structure.

    Of the loops' controllers only how they run matters: the first one's prewarping, delay and hold. Searches look at
    coefficients in double precision; controllers are made in `precision`. `opened` is what disturbs each loop, with
    the loop open.
    """
    structure.refuse(loops, requirements, disturbed=any(one is not None for one in opened))
    lines = [_lines(loop) for loop in loops]
    below = [_below(loop) for loop in loops]
    f = np.concatenate([one.f for one in lines])
    unique, line = np.unique(f, return_inverse=True)
    unit = replace(loops[0].controller, loop=requirements.loop, blocks=(Block("gain", {"gain": 1.0}),), rate_hz=rate_hz)
    below_hz = np.concatenate([own for own, _ in below])
    outside = unit.outside(below_hz) if unit.computation_delay_s or unit.added_hold else np.ones(below_hz.size)
    beyond = [_beyond(loop, rate_hz) for loop in loops]
    return Problem(
        requirements=requirements,
        templates=requirements.structure,
        variables=structure.variables_of(requirements),
        unit=unit,
        precision=precision,
        names=tuple(loop.plant.recording or f"frf {k + 1}" for k, loop in enumerate(loops)),
        f=f,
        P=np.concatenate([one.P for one in lines]),
        radius=np.concatenate([one.radius for one in lines]),
        first=np.concatenate([[0], np.cumsum([one.f.size for one in lines])]),
        below=np.array([one.below for one in lines]),
        unique_f=unique,
        unique_s=unit.s_at(unique),
        line=line,
        integrators=np.array([loop.integrators or 0 for loop in loops])
        + sum(t.integrators() for t in requirements.structure),
        unstable=np.array([loop.unstable_poles for loop in loops]),
        fitted=np.array([loop.below_hz.size > 0 for loop in loops]),
        P_below=np.concatenate([P for _, P in below]) * outside,
        s_below=unit.s_at(below_hz),
        f_above=above_hz(min(float(loop.frequency_hz[-1]) for loop in loops), rate_hz),
        first_below=np.concatenate([[0], np.cumsum([own.size for own, _ in below])]),
        f_beyond=np.concatenate([lines for lines, _ in beyond]),
        P_beyond=np.concatenate([P for _, P in beyond]),
        owner_beyond=np.repeat(np.arange(len(loops)), [lines.size for lines, _ in beyond]),
        f_wide=_wide(requirements, rate_hz),
        places=tuple(loop.plant.operating_point for loop in loops),
        opened=tuple(opened) or (None,) * len(loops),
    )


def _none(name: str) -> float:
    """A limit in its own unit that nothing misses."""
    limit = LIMIT_OF[name]
    return 0.0 if limit.sense == "at_least" else NONE_DB if limit.unit == "dB" else float(from_db(NONE_DB))


def _ln_masks(requirements: Requirements, f: Array) -> Array:
    """ln of the sharpest masks (6, nf) at frequencies in Hz, +inf where there is none, of the floor -inf."""
    with np.errstate(divide="ignore"):
        level = -0.5 * np.log(weights(requirements.masks, f))
    level[MASKED.index("loop_floor_db")] *= -1.0
    return level


def _below(loop: Loop) -> tuple[Array, ComplexArray]:
    """Frequencies below the first line and P there, by the fit, else by the likeliest model of the lowest lines."""
    if loop.below_hz.size:
        return loop.below_hz, loop.P_below
    f, models = low_hz(loop), low_models(loop)
    return (f, models[0].response(f)) if models else (np.zeros(0), np.zeros(0, dtype=complex))


class _Lines(NamedTuple):
    """Frequencies, P and the radius of its 95 % circle (n,), of which the first `below` are a model's."""

    f: Array
    P: ComplexArray
    radius: Array
    below: int


def _lines(loop: Loop) -> _Lines:
    """A loop's lines, with places between them at narrow resonances and where P turns fast, as the check reads them.

    Without integrators P may start on the negative real axis at 0 Hz, and L pass -1 below the first line, where the
    check reads margins too: then a model leads the lines down to there.
    """
    dense, P = between_lines(loop), between_lines(loop).response
    dense = dense.between(np.abs(np.diff(P)), np.minimum(np.abs(P[1:]), np.abs(P[:-1])), STEEP, BETWEEN)
    f, P, radius = dense.frequency_hz, dense.response, np.interp(dense.frequency_hz, loop.frequency_hz, _radius(loop))
    models = () if loop.integrators else low_models(loop)[:1]
    down = f[0] * BELOW_RATIOS
    for model in models:
        below = model.response(down)
        if below[0].real < 0.0:
            ahead = radius[0] / abs(P[0]) * np.abs(below)
            return _Lines(np.append(down, f), np.append(below, P), np.append(ahead, radius), down.size)
    return _Lines(f, P, radius, 0)


def _radius(loop: Loop) -> Array:
    """Radius (nf,) of the 95 % circle of P; wider where its variance was itself estimated with few degrees of freedom.

    |d|² over an estimated variance follows an F distribution with 2 and that many degrees.
    """
    freedom = loop.plant.variance_freedom
    square = TOL.square_95
    if np.isfinite(freedom):
        square = 0.5 * freedom * np.expm1(2.0 * square / freedom)
    return np.sqrt(square * loop.plant.variance[:, 0, 0])


def _beyond(loop: Loop, rate_hz: float) -> tuple[Array, ComplexArray]:
    """Less sure lines above the judged ones, below half the rate."""
    if loop.beyond is None:
        return np.zeros(0), np.zeros(0, dtype=complex)
    f = loop.beyond.frequency_hz
    return f[f < 0.5 * rate_hz], loop.beyond.siso[f < 0.5 * rate_hz]


def _wide(requirements: Requirements, rate_hz: float) -> Array:
    """Lines on which the bandwidth of C is read, and its limit; none where it is not limited."""
    limit = requirements.controller_bandwidth_hz
    if limit is None:
        return np.zeros(0)
    grid = controller_grid_hz(rate_hz)
    return np.unique(np.append(grid, min(limit, float(grid[-1]))))


def bounds_reached(p: Problem, x: Array) -> tuple[str, ...]:
    """Parameters that stand at a bound, in words."""
    names = []
    for k, v in enumerate(p.variables):
        for limit, word in ((p.low[k], "min"), (p.high[k], "max")):
            if abs(x[k] - limit) < 1e-6:
                names.append(f"{p.templates[v.block].kind} {v.name} at its {word} {np.exp(limit):g}")
    return tuple(names)
