"""An effect: something that a nominal model leaves out, as parameters moved away from neutral, and its forms."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from loopshape.core.errors import WrongUseError


@dataclass(frozen=True)
class Effect:
    """A name, the block of the plant it lives in, and the values to which it moves parameters.

    Neutral values are the plant's nominal ones and are the identity bit for bit, so "with" and "without"
    are one code path; several effects compose by moving several parameters.
    """

    name: str
    block: str
    moves: Mapping[str, float] = field(default_factory=dict)
    source: str = ""


@dataclass(frozen=True)
class Free:
    """A number that a form leaves to the data: the plant's parameter, bounds, values to start from.

    `step` is the share of it by which slopes are taken.
    """

    parameter: str
    low: float
    high: float
    starts: tuple[float, ...]
    step: float = 0.1

    def __post_init__(self) -> None:
        if not (self.starts and all(self.low <= s <= self.high for s in self.starts)):
            raise WrongUseError(f"starts of {self.parameter} lie in its bounds", f"{self.starts!r}")


@dataclass(frozen=True)
class EffectForm:
    """One functional form of an effect: what it frees, sets, and ties to what it frees.

    `free[0]` carries the magnitude: its value times `scale`, in `unit`. `tied` parameters are a factor times a
    free one, `fixed` ones shape it. `scale` translates where a form's own number is another quantity. `extends`
    names the effect that this one contains: then it has to earn its place over it.
    """

    effect: str
    form: str
    block: str
    unit: str
    free: tuple[Free, ...]
    fixed: Mapping[str, float] = field(default_factory=dict)
    tied: Mapping[str, tuple[str, float]] = field(default_factory=dict)
    scale: float = 1.0
    usual: tuple[float, float] = (0.0, float("inf"))
    source: str = ""
    extends: str = ""

    def moves(self, values: Sequence[float]) -> dict[str, float]:
        """Parameters of the plant at these values of what is free, in order."""
        own = {f.parameter: float(v) for f, v in zip(self.free, values, strict=True)}
        return own | dict(self.fixed) | {name: factor * own[of] for name, (of, factor) in self.tied.items()}

    def magnitude(self, values: Sequence[float]) -> float:
        """Magnitude in `unit` at these values."""
        return self.scale * float(values[0])

    def at(self, magnitude: float) -> Effect:
        """The effect at a magnitude, other free numbers at their first start; out of bounds is refused."""
        own = magnitude / self.scale
        first = self.free[0]
        if not first.low <= own <= first.high:
            low, high = sorted((first.low * self.scale, first.high * self.scale))
            raise WrongUseError(
                f"the magnitude of {self.effect} lies between {low:g} and {high:g} {self.unit}", f"{magnitude:g}"
            )
        values = [own, *(f.starts[0] for f in self.free[1:])]
        return Effect(self.effect, self.block, self.moves(values), self.source)


@dataclass(frozen=True)
class Spread:
    """What differs from machine to machine and is no gap: parameters that scale together, uniformly by up to `half`.

    With `adds` they are moved by up to `half` in their own unit instead.
    """

    name: str
    parameters: tuple[str, ...]
    half: float
    adds: bool = False

    def moved(self, value: float, share: float) -> float:
        """A parameter of this value where the spread stands at `share` (-1..1)."""
        return value + self.half * share if self.adds else value * (1.0 + self.half * share)
