"""An effect: something that a nominal model leaves out, as parameters moved away from neutral; its forms; its fix."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from enum import StrEnum
from typing import Any

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

    @property
    def quantity(self) -> str:
        """What a magnitude without a unit is, by the plant's parameter; "" where the unit says it."""
        return self.free[0].parameter.rpartition(".")[2].replace("_", " ") if self.unit == "1" else ""

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


class NotWritten(StrEnum):
    """Why a number of a fix does not stand in the patched model file as it is.

    `NO_ATTRIBUTE`: the format has none for it, it is in the Python function. `SHARPER`: the format has the effect
    without this number. `REFUSED`: the user's file does not take it (it does not compile, or scales masses anew).
    """

    NO_ATTRIBUTE = "no_attribute"
    SHARPER = "sharper"
    REFUSED = "refused"


@dataclass(frozen=True)
class NumberChange:
    """A parameter's value in the nominal model and in the fixed one. Without `effect` it moved within its tolerance."""

    parameter: str
    old: float
    new: float
    unit: str
    effect: str | None = None


@dataclass(frozen=True)
class AttributeChange:
    """An attribute of the user's model file before and after; radians, whatever the file's unit of angles."""

    element: str
    name: str
    attribute: str
    old: float | tuple[float, ...]
    new: float | tuple[float, ...]


@dataclass(frozen=True)
class LeftToYou:
    """A parameter of a fix that the patched model file does not hold, and why."""

    parameter: str
    reason: NotWritten


@dataclass(frozen=True, eq=False)
class Fix:
    """An effect, and what the tolerances moved by, as a change of the user's own model.

    `of` is the effect or pair, `is_verdict` false where the verdict is unknown and it is only the best name; `form` and
    `source` of its equation. `file` names a patched copy of the model's file, `function` a Python file with what is
    not in it; `texts` has their contents by name. Both together are the whole change.
    """

    of: str
    is_verdict: bool
    form: str
    source: str
    parameters: tuple[NumberChange, ...]
    attributes: tuple[AttributeChange, ...] = ()
    left_to_you: tuple[LeftToYou, ...] = ()
    file: str | None = None
    function: str | None = None
    assets: tuple[str, ...] = ()
    texts: Mapping[str, str] = field(default_factory=dict)

    @property
    def sentence(self) -> str:
        """Each effect's size, from what to what, with the other numbers of its form; how many more moved."""
        parts: dict[str, str] = {}
        for c in self.parameters:
            unit = "" if c.unit == "1" else f" {c.unit}"
            if c.effect in parts:
                parts[c.effect] += f", {c.parameter.rpartition('.')[2]} {c.new:.4g}{unit}"
            elif c.effect:
                parts[c.effect] = f"{c.parameter} {c.old:.4g} -> {c.new:.4g}{unit}"
        rest = sum(c.effect is None for c in self.parameters)
        return "; ".join([*parts.values(), *([f"{rest} more within tolerance"] if rest else [])])

    def named(self, names: Mapping[str, str]) -> Fix:
        """With its files under other names."""
        file, function = (name and names.get(name, name) for name in (self.file, self.function))
        texts = {names.get(name, name): text for name, text in self.texts.items()}
        return replace(self, file=file, function=function, texts=texts)

    def to_dict(self) -> dict[str, Any]:
        """For JSON: all but the files' contents."""
        keys = ("of", "is_verdict", "form", "source", "parameters", "attributes", "left_to_you", "file", "function")
        return {key: asdict(self)[key] for key in (*keys, "assets")}


def fix_of(
    forms: Sequence[EffectForm], moves: Mapping[str, float], nominal: Mapping[str, tuple[float, str]], is_verdict: bool
) -> Fix:
    """The numbers that forms and tolerances move; `nominal` has value and unit by parameter."""
    whose = {name: f.effect for f in forms for name in (*(free.parameter for free in f.free), *f.fixed, *f.tied)}
    units = {f.free[0].parameter: f.unit for f in forms if f.scale == 1.0}
    changes = tuple(
        NumberChange(name, nominal[name][0], value, units.get(name, nominal[name][1]), whose.get(name))
        for name, value in sorted(moves.items(), key=lambda move: move[0] not in whose)
        if value != nominal[name][0]
    )
    of = "+".join(sorted(f.effect for f in forms))
    form, source = " + ".join(f.form for f in forms), "; ".join(f.source for f in forms if f.source)
    return Fix(of, is_verdict, form, source, changes)
