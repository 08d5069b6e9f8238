"""A campaign: one study done to many simulated machines - draws of the manufacturing tolerance, amplitudes, effects."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from hashlib import sha256
from itertools import product
from typing import Any

import numpy as np

from loopshape.core.errors import WrongUseError
from loopshape.toolbox.gap.nouns.effect import Spread
from loopshape.toolbox.gap.nouns.plant import ParameterTable
from loopshape.toolbox.rig.excitation.excitation import Excitation
from loopshape.toolbox.rig.study import ExperimentTemplate, Study, merged_effects

MOST = 10_000_000  # machines: more is a slip of the pen
_LONGEST_NAME = 120  # letters of a machine's folder


@dataclass(frozen=True, eq=False)
class Machine:
    """One simulated machine: its name, what was drawn, and its study, whose seed is its own.

    `hidden` are the drawn parameters: whoever reads its recordings does not know them.
    """

    name: str
    draw: int
    amplitude: float
    study: Study
    hidden: Mapping[str, float]


@dataclass(frozen=True)
class Part:
    """The part k of n of a campaign: recordings that follow each other, every one in one part, none larger by over one.

    Refuses a part that is none of 1 to n.
    """

    number: int
    of: int

    def __post_init__(self) -> None:
        if not 1 <= self.number <= self.of:
            raise WrongUseError("a campaign has no such part", f"{self.number}/{self.of}", "write 1/8 to 8/8")

    def recordings(self, count: int) -> range:
        """Numbers of its recordings of `count`, from 0."""
        return range((self.number - 1) * count // self.of, self.number * count // self.of)

    @property
    def name(self) -> str:
        """Of its folder."""
        return f"part-{self.number}-of-{self.of}"


@dataclass(frozen=True, eq=False)
class Campaign:
    """A study, factors on its amplitudes, sets of effects, and how many machines are drawn from the tolerance.

    `draws` 0 is the nominal machine alone. Each draw is the same machine at all amplitudes and under all effects.
    Refuses amplitudes that are not positive, no effects (an empty set is one), machines of one name, and more than
    ten million.
    """

    study: Study
    amplitudes: tuple[float, ...] = (1.0,)
    effects: tuple[Mapping[str, float], ...] = ({},)
    draws: int = 0
    seed: int = 0

    def __post_init__(self) -> None:
        if not self.amplitudes or min(self.amplitudes) <= 0.0:
            raise WrongUseError("amplitudes are positive factors", f"{self.amplitudes}", "1.0 is as in the study")
        if not self.effects:
            raise WrongUseError("a campaign has sets of effects", "none", 'write [""] for machines without')
        if self.size > MOST:
            raise WrongUseError(f"a campaign has at most {MOST} machines", f"{self.size}", "draw fewer")
        names = [_name(None, amplitude, effects) for amplitude, effects in product(self.amplitudes, self.effects)]
        if twice := next((name for name in names if names.count(name) > 1), ""):
            raise WrongUseError(
                "two machines of a campaign have one name",
                twice.removeprefix("nominal-"),
                "give each amplitude and each set of effects once; names tell six digits apart",
            )

    @property
    def size(self) -> int:
        """Number of machines."""
        return max(1, self.draws) * len(self.amplitudes) * len(self.effects)

    def machines(self, spread: Sequence[Spread], table: ParameterTable) -> Iterable[Machine]:
        """All machines in order; the same seed gives the same, whoever simulates them.

        Refuses draws of a plant without a spread: they would all be one machine.
        """
        if self.draws and not spread:
            raise WrongUseError(
                f"the plant {self.study.plant} has no manufacturing tolerance",
                f"draws = {self.draws}",
                "leave draws out",
            )
        cases = product(range(max(1, self.draws)), self.amplitudes, self.effects)
        seeds_apart = 1_000_003  # of machines' sensor noise
        for number, (draw, amplitude, effects) in enumerate(cases):
            drawn = _drawn(spread, table, self.study.changes, (self.seed, draw)) if self.draws else {}
            study = replace(
                self.study,
                seed=self.study.seed + self.seed * seeds_apart + number,
                effects=merged_effects(self.study.effects, effects),
                experiments=tuple(_scaled(e, amplitude) for e in self.study.experiments),
            )
            yield Machine(_name(draw if self.draws else None, amplitude, effects), draw, amplitude, study, drawn)


def _name(draw: int | None, amplitude: float, effects: Mapping[str, float]) -> str:
    words = ["nominal" if draw is None else f"d{draw:06d}", f"x{amplitude:g}"]
    name = "-".join([*words, *(f"{name.replace(':', '_')}={size:g}" for name, size in effects.items())])
    if len(name) <= _LONGEST_NAME:
        return name
    return f"{name[: _LONGEST_NAME - 20]}-{sha256(name.encode()).hexdigest()[:16]}"


def _drawn(
    spread: Sequence[Spread], table: ParameterTable, changes: Mapping[str, float], seed: tuple[int, int]
) -> dict[str, float]:
    """Parameters of one machine, within the tolerance about the study's, each kind uniform and independent."""
    shares = np.random.default_rng(list(seed)).uniform(-1.0, 1.0, len(spread))
    nominal = {row.name: row.value for row in table.rows} | dict(changes)
    moved: dict[str, float] = {}
    for one, share in zip(spread, shares, strict=True):
        moved |= {name: one.moved(moved.get(name, nominal[name]), float(share)) for name in one.parameters}
    return moved


def _scaled(template: ExperimentTemplate, factor: float) -> ExperimentTemplate:
    """A template with its excitations a factor larger; setpoints stay."""
    if factor == 1.0 or template.excitation is None:
        return template
    return replace(
        template,
        excitation=_larger(template.excitation, factor),
        excites_also={loop: _larger(one, factor) for loop, one in template.excites_also.items()},
    )


def _larger(excitation: Any, factor: float) -> Excitation:
    larger: Excitation = replace(excitation, amplitude=factor * excitation.amplitude)
    return larger
