"""A controller of order n near the best possible: blocks fitted to a convex design's C and tuned on from there.

`bound_reach` finds the best controller of unlimited order, as numbers at nodes. Biquads are fitted to it one after the
other, each where it helps most, all together each time, by least squares of the errors that they leave in S and CS:
for a small change of C these are T S dC/C and CS S dC/C. `tune` goes on from there under all requirements at all FRFs.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import least_squares

from loopshape.core.errors import WrongUseError
from loopshape.core.units import Array, ComplexArray
from loopshape.data.control.block import Block, BlockTemplate, Free, series_response
from loopshape.data.control.controller import Controller
from loopshape.data.requirement.requirements import Requirements
from loopshape.data.response.frf import FRF
from loopshape.data.response.model import Fit
from loopshape.design.tune import Search, Tuning, tune
from loopshape.loop.loop import Loop
from loopshape.loop.loops import loops_of
from loopshape.toolbox.limits.bound import excluded
from loopshape.toolbox.limits.bound_nodes import counted
from loopshape.toolbox.limits.bound_reach import Reached, achieved, reached_at
from loopshape.toolbox.limits.growth import library

#: places across the band and dampings at which a new block is tried, steps of each trial and of the last fit
PLACES, DAMPINGS, TRIAL, LAST = 10, (0.1, 0.6), 25, 300
#: a gain may be tuned this far either way
GAIN = 1000.0


def reach_order(
    frfs: Sequence[FRF],
    controller: Controller,
    requirements: Requirements,
    order: int,
    fits: Sequence[Fit] = (),
    *,
    seed: int = 0,
) -> Tuning:
    """The best controller of at most `order` poles that convex designs lead to; same input and seed, same controller.

    The requirements' structure counts for nothing: that of the answer is a gain, biquads ("notch") and lead-lags.
    Designs at shares of the bandwidth reached are fitted and tuned, with all poles, and with two less and one block
    grown, and from random starts where none of them meets the limits; what passes the check comes first, then the
    larger objective. See `loopshape.achieved`.
    """
    if order < 1:
        raise WrongUseError("a controller to be found has at least one pole", f"order {order}", "ask for 4 or more")
    loops, _ = loops_of(frfs, controller, requirements, fits)
    bounds = [excluded(loop, [loop], requirements).bound_hz for loop in loops]
    least = int(np.argmin(bounds))
    designs = _designs(loops[least], requirements, bounds[least])
    if not designs:
        raise WrongUseError(
            "no convex design to start from was found",
            f"{loops[least].plant.recording} under {', '.join(counted(requirements)[0]) or 'no such limit'}",
            "relax the limits or give one on S, CS or T, or tune a structure",
        )
    task = _Order(tuple(frfs), controller, requirements, tuple(fits), library(loops), seed)
    found = [task.tuned(design, order) for design in designs]
    if order >= 3:  # from this order on a block is also grown on a smaller controller
        found.append(task.grown(min((task.tuned(design, order - 2) for design in designs), key=_rank)))
    if not any(one.feasible for one in found):
        found.append(task.searched(found[0], order))
    return min(found, key=_rank)


def _designs(loop: Loop, limits: Requirements, bound_hz: float) -> list[Reached]:
    """Convex designs with margins at shares of the largest bandwidth that one reaches."""
    most = achieved(loop, limits, bound_hz, margins=True).bandwidth_hz
    # shares of the bandwidth reached at which a design is fitted: farther below it needs less order
    shares = (1.0, 0.85, 0.7)
    found = [reached_at(loop, limits, share * most, margins=True) for share in shares if most]
    return [one for one in found if one is not None]


def _rank(one: Tuning) -> tuple[bool, bool, float]:
    return not one.verdict.passed, not one.feasible, -one.objective


@dataclass(frozen=True, eq=False)
class _Order:
    """What controllers are tuned for, how they run, and the blocks that they are made of."""

    frfs: tuple[FRF, ...]
    controller: Controller
    requirements: Requirements
    fits: tuple[Fit, ...]
    library: tuple[BlockTemplate, ...]
    seed: int

    def tuned(self, design: Reached, order: int) -> Tuning:
        """A controller of `order` poles fitted to a design and tuned from there."""
        structure = self._structure(order)
        return self._from(fitted(design, self.controller, structure), structure, starts=1)

    def grown(self, tuning: Tuning) -> Tuning:
        """A controller with one block more."""
        notch, lead = self.library
        blocks = tuning.controller.blocks[1:]
        structure = tuple(notch if one.kind == "notch" else lead for one in blocks)
        return self._from(tuning.controller, structure, starts=1, grow=1)

    def searched(self, tuning: Tuning, order: int) -> Tuning:
        """A controller of `order` poles from a tuned one and random starts beside it."""
        structure = self._structure(order)
        random = 16  # starts where no design leads to what meets the limits
        return self._from(tuning.controller, structure, starts=random)

    def _structure(self, order: int) -> tuple[BlockTemplate, ...]:
        notch, lead = self.library
        return (*[notch] * (order // 2), *[lead] * (order % 2))

    def _from(self, start: Controller, structure: tuple[BlockTemplate, ...], *, starts: int, grow: int = 0) -> Tuning:
        gain = start.blocks[0].parameters["gain"]
        every = (BlockTemplate("gain", {"gain": Free(gain / GAIN, gain * GAIN)}), *structure)
        asked = replace(self.requirements, structure=every)
        search = Search(self.seed, starts, grow=grow)
        return tune(self.frfs, asked, self.fits, search, start=start, explain=False)


def fitted(found: Reached, controller: Controller, structure: Sequence[BlockTemplate]) -> Controller:
    """A gain and blocks of a structure with free parameters, near a convex design's C where that matters."""
    unit = replace(controller, blocks=(Block("gain", {"gain": 1.0}),), precision="double")
    S = 1.0 / (1.0 + found.L)
    weight = np.abs(S) * (np.abs(1.0 - S) + np.abs(found.C * S) / np.abs(found.C * S).max())
    use = weight > 1e-3 * weight.max()
    target = _Target(unit.s_at(found.f)[use], (found.C / unit.response(found.f))[use], weight[use])
    x = np.array([np.log(np.median(np.abs(target.C)))])
    for k in range(len(structure)):
        trials = [target.fit(np.append(x, new), structure[: k + 1], TRIAL) for new in _places(structure[k])]
        x = min(trials, key=lambda trial: trial[1])[0]
    x, _ = target.fit(x, structure, LAST)
    return replace(controller, blocks=tuple(_blocks(x, structure)))


@dataclass(frozen=True, eq=False)
class _Target:
    """C (n,) to be met at s (n,), errors weighted by `weight` (n,)."""

    s: ComplexArray
    C: ComplexArray
    weight: Array

    def fit(self, x: Array, structure: Sequence[BlockTemplate], most: int) -> tuple[Array, float]:
        """Logarithms of gain and parameters nearest by least squares from x, and the error."""
        low, high = _ends(structure)
        x = np.clip(x, low + 1e-9, high - 1e-9)

        def error(y: Array) -> Array:
            return _real(self._error(y, structure))

        def slopes(y: Array) -> Array:
            return _real(self._slopes(y, structure)).T

        out = least_squares(error, x, slopes, bounds=(low, high), max_nfev=most)
        return out.x, float(out.cost)

    def _error(self, x: Array, structure: Sequence[BlockTemplate]) -> ComplexArray:
        return np.asarray(self.weight * np.log(series_response(_blocks(x, structure), self.s) / self.C))

    def _slopes(self, x: Array, structure: Sequence[BlockTemplate]) -> ComplexArray:
        blocks = _blocks(x, structure)
        slopes = [one.parameters[name] * slope for one in blocks for name, slope in one.log_slopes(self.s).items()]
        return np.asarray(slopes) * self.weight


def _real(z: ComplexArray) -> Array:
    return np.concatenate([z.real, z.imag], axis=-1)


def _free(template: BlockTemplate) -> dict[str, Free]:
    return {name: value for name, value in template.parameters.items() if isinstance(value, Free)}


def _ends(structure: Sequence[BlockTemplate]) -> tuple[Array, Array]:
    """Bounds of ln gain, which has none, and of the blocks' parameters."""
    every = [one for template in structure for one in _free(template).values()]
    low, high = ([getattr(one, side) for one in every] for side in ("low", "high"))
    return np.append(-np.inf, np.log(low)), np.append(np.inf, np.log(high))


def _blocks(x: Array, structure: Sequence[BlockTemplate]) -> list[Block]:
    values = iter(np.exp(x))
    out = [Block("gain", {"gain": float(next(values))})]
    return out + [template.block({name: float(next(values)) for name in _free(template)}) for template in structure]


def _places(template: BlockTemplate) -> list[Array]:
    """Logarithms of the parameters of blocks that do nothing yet, across the band."""
    free = _free(template)
    band = free["f1_hz"]
    dampings = DAMPINGS if "damping1" in free else (1.0,)
    return [
        np.log([place if name.endswith("_hz") else damping for name in free])
        for place in np.geomspace(1.2 * band.low, band.high / 1.2, PLACES)
        for damping in dampings
    ]
