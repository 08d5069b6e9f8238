"""A structure to be tuned: its free parameters, and what cannot be tuned at all."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from loopshape.core.errors import WrongUseError
from loopshape.data.block import Free
from loopshape.data.loop import Loop
from loopshape.data.requirements import LIMITS, Requirements

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


def refuse(loops: Sequence[Loop], requirements: Requirements) -> None:
    """Refuse what cannot be tuned: no structure, nothing free, nothing that holds L off -1, unknown poles."""
    if not requirements.structure:
        raise WrongUseError(
            f"the requirements of loop {requirements.loop!r} name no structure to tune",
            "",
            "add structure = [ { kind = ..., ... } ] with min and max for what may move",
        )
    if "error_rms" in requirements.limited():
        raise WrongUseError(
            f"error_rms of loop {requirements.loop!r} is checked and not tuned to",
            f"{requirements.error_rms}",
            'tune with objective = "disturbance" or a mask on S, then check with --disturbance RUN',
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
    unknown = [loop.plant.recording for loop in loops if loop.integrators is None]
    if unknown:
        raise WrongUseError(
            f"the number of integrators of the plant in loop {requirements.loop!r} is not known",
            f"lowest frequencies that fit no whole number at {', '.join(unknown)}",
            "declare integrators in the requirements' [[loop]], or fit a model that follows the measured FRF",
        )
    unknown = [loop.plant.recording for loop in loops if loop.unstable_poles is None]
    if unknown:
        raise WrongUseError(
            f"the number of unstable poles of the plant in loop {requirements.loop!r} is not known",
            f"not declared, nor known from the recorded loop or a fit at {', '.join(unknown)}",
            "declare unstable_poles in the requirements' [[loop]], name the recorded loop's controller in the map, or"
            " fit a model that leaves nothing but noise",
        )
    below = requirements.objective.disturbance_below_hz
    blind = [loop.plant.recording for loop in loops if below is not None and loop.frequency_hz[0] > below]
    if blind:
        raise WrongUseError(
            f"the objective of loop {requirements.loop!r} needs frequencies below {below:g} Hz",
            f"none that is judged at {', '.join(blind)}",
            "measure lower, or raise disturbance_below_hz",
        )


def variables_of(requirements: Requirements) -> tuple[Variable, ...]:
    """Free parameters of the requirements' structure, in its order."""
    return tuple(
        Variable(k, name, value.low, value.high, value.start)
        for k, template in enumerate(requirements.structure)
        for name, value in template.parameters.items()
        if isinstance(value, Free)
    )
