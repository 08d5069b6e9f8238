"""A structure to be tuned: its free parameters, and what cannot be tuned at all."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from loopshape.core.errors import WrongUseError
from loopshape.core.units import Array
from loopshape.data.control.block import BLOCK_KINDS, Block, BlockTemplate, Free
from loopshape.data.requirement.requirements import LIMIT_OF, LIMITS, Requirements
from loopshape.loop.loop import Loop

#: a problem needs one of these: without them a loop comes as near to -1 as it likes
NEAR = tuple(limit.name for limit in LIMITS if limit.keeps_off)


@dataclass(frozen=True)
class Variable:
    """One free parameter: which block, which name, and its bounds."""

    block: int
    name: str
    low: float
    high: float
    start: float | None


def refuse(loops: Sequence[Loop], requirements: Requirements, *, disturbed: bool) -> None:
    """Refuse what cannot be tuned: no structure, nothing free, nothing that holds L off -1, unknown poles, or a limit
    on the error where nothing tells what disturbs the loop.
    """
    if not requirements.structure:
        raise WrongUseError(
            f"the requirements of loop {requirements.loop!r} name no structure to tune",
            "",
            "add structure = [ { kind = ..., ... } ] with bounds; in Python call ls.tune(P, R, [ls.gain(), ...])",
        )
    asked = [name for name in requirements.limited() if LIMIT_OF[name].disturbed]
    if asked and not disturbed:
        raise WrongUseError(
            f"{', '.join(asked)} of loop {requirements.loop!r} needs what disturbs the loop",
            "no disturbance",
            "give a recording of the closed loop without excitation (--disturbance RUN, disturbance=...)",
        )
    if unread := [name for name in requirements.limited() if not (LIMIT_OF[name].magnitude or LIMIT_OF[name].own_rows)]:
        raise WrongUseError(
            f"the requirements of loop {requirements.loop!r} cannot all be tuned for",
            ", ".join(unread),
            "leave them out, tune, and check the controller with them",
        )
    weighted = requirements.weighted_norm is not None or requirements.objective.weighted_norm > 0.0
    if not weighted and all(getattr(requirements, name) is None for name in NEAR):
        raise WrongUseError(
            f"the requirements of loop {requirements.loop!r} let the loop come as near to -1 as it likes",
            "no limit on a margin or on |S|",
            f"give one of {', '.join(NEAR)}",
        )
    if not variables_of(requirements):
        raise WrongUseError(f"the structure of loop {requirements.loop!r} has nothing free to tune")
    named = [(loop.plant.recording or f"frf {k + 1}", loop) for k, loop in enumerate(loops)]
    unknown = [name for name, loop in named if loop.integrators is None]
    if unknown:
        raise WrongUseError(
            f"the number of integrators of the plant in loop {requirements.loop!r} is not known",
            f"lowest frequencies that fit no whole number at {', '.join(unknown)}",
            "declare integrators in the requirements' [[loop]], or fit a model that follows the measured FRF",
        )
    if any(loop.integrators is not None and loop.integrators < 0 for loop in loops) and _integrates(requirements):
        raise WrongUseError(
            f"the structure of loop {requirements.loop!r} has an integrator that the plant's zero at 0 Hz cancels",
            "integrators below 0, and a pole at s = 0 in the structure",
            "leave it out: the controller's output would drift without bound, and no margin shows it",
        )
    unknown = [name for name, loop in named if loop.unstable_poles is None]
    if unknown:
        raise WrongUseError(
            f"the number of unstable poles of the plant in loop {requirements.loop!r} is not known",
            f"not declared, nor known from the recorded loop or a fit at {', '.join(unknown)}",
            "declare unstable_poles in the requirements' [[loop]], name the recorded loop's controller in the map, or"
            " fit a model that leaves nothing but noise",
        )
    below = requirements.objective.disturbance_below_hz
    blind = [name for name, loop in named if below is not None and loop.frequency_hz[0] > below]
    if blind:
        raise WrongUseError(
            f"the objective of loop {requirements.loop!r} needs frequencies below {below:g} Hz",
            f"none that is judged at {', '.join(blind)}",
            "measure lower, or raise disturbance_below_hz",
        )


def _integrates(requirements: Requirements) -> bool:
    """Whether a block of the structure has a pole at s = 0, whatever its free parameters."""
    variables = variables_of(requirements)
    low = values_at(requirements.structure, variables, np.log([v.low for v in variables]))
    return any(Block(t.kind, own).integrators() > 0 for t, own in zip(requirements.structure, low, strict=True))


def variables_of(requirements: Requirements) -> tuple[Variable, ...]:
    """Free parameters of the requirements' structure, in its order."""
    return tuple(
        Variable(k, name, value.low, value.high, value.start)
        for k, template in enumerate(requirements.structure)
        for name, value in template.parameters.items()
        if isinstance(value, Free)
    )


def moved_with(template: BlockTemplate, name: str) -> list[str]:
    """Parameters of a block that a free one moves: itself and those tied to it."""
    return [name, *(k for k, target in template.tie.items() if target == name)]


def values_at(templates: Sequence[BlockTemplate], variables: Sequence[Variable], x: Array) -> list[dict[str, float]]:
    """Parameters of each block where ln of the free ones is x (n,), within their bounds."""
    made = [{k: v for k, v in t.parameters.items() if not isinstance(v, Free)} for t in templates]
    for v, value in zip(variables, np.exp(x).tolist(), strict=True):
        made[v.block][v.name] = min(max(value, v.low), v.high)
    for own, template in zip(made, templates, strict=True):
        own |= {name: own[target] for name, target in template.tie.items()}
    return made


def sections(templates: Sequence[BlockTemplate], values: Sequence[Mapping[str, float]]) -> Array:
    """Coefficients (blocks, 6) of blocks with these parameters, as `data.block.coefficients` has them."""
    parts = (BLOCK_KINDS[t.kind].section(own) for t, own in zip(templates, values, strict=True))
    return np.array([(*num, *den) for num, den in parts], dtype=float)


def section_changes(
    templates: Sequence[BlockTemplate], variables: Sequence[Variable], values: Sequence[Mapping[str, float]]
) -> Array:
    """d section/d x (variables, 6), of each variable's block."""
    slopes = {k: BLOCK_KINDS[templates[k].kind].slopes(values[k]) for k in {v.block for v in variables}}
    out = []
    for v in variables:
        parts = [slopes[v.block][name] for name in moved_with(templates[v.block], v.name)]
        moved = [(*num, *den) for num, den in parts]
        every = moved[0] if len(moved) == 1 else [sum(one) for one in zip(*moved, strict=True)]
        out.append([values[v.block][v.name] * c for c in every])
    return np.array(out, dtype=float)
