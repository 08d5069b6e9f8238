"""What a gap diagnosis answers: which effect, where, how far the gap shrinks, and how sure all that is."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from loopshape.core.units import Array
from loopshape.data.gap_table import GapTable
from loopshape.data.study import Study


@dataclass(frozen=True)
class Ranked:
    """One hypothesis: `magnitude`, its 95 % `interval` and `unit` for single effects; for pairs one each, by effect."""

    effect: str
    probability: float
    magnitude: float | None = None
    interval: tuple[float, float] | None = None
    unit: str | None = None
    form: str | None = None
    parts: Mapping[str, tuple[float, tuple[float, float] | None, str]] = field(default_factory=dict)


@dataclass(frozen=True)
class Submodel:
    """How far a submodel is off in one recording: rms over its noise floor, nominal and with the effect."""

    recording: str
    role: str
    path: str
    before: float
    after: float | None
    rival: float | None


@dataclass(frozen=True)
class Where:
    """The place: block with probabilities of all, channel, band, operating points.

    `places`: what a free disturbance at one equation would leave of the gap, rms over the floor in the channels that
    it does not reach; the place is where the least is left.
    """

    block: str
    blocks: Mapping[str, float]
    channel: str
    band_hz: tuple[float, float]
    operating_points: Sequence[Mapping[str, float]]
    places: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class Shrink:
    """The gap on validation recordings, over the floor that noise and ordinary spread leave (1.0)."""

    metric: str
    before: float
    after: float
    shrink: float | None
    interval: tuple[float, float] | None
    recordings: Sequence[str]
    rival: str | None = None
    rival_after: float | None = None


@dataclass(frozen=True, eq=False)
class Trace:
    """A stretch of a validation recording for the eye: time, measured, nominal, with the effect."""

    recording: str
    channel: str
    t_s: Array
    measured: Array
    nominal: Array
    with_effect: Array


@dataclass(frozen=True, eq=False)
class Proposal:
    """The experiment that would part the two hypotheses of `parts` most, the first of a study ready to be measured.

    `separation` is the predicted rms difference of the outputs over what noise alone makes: 1 parts nothing.
    """

    name: str
    parts: tuple[str, str]
    separation: float
    study: Study
    sentence: str


@dataclass(frozen=True, eq=False)
class GapReport:
    """Everything that `loopshape gap` says of a run. `notes` tell what these recordings cannot."""

    run: str
    plant: str
    verdict: str
    ranking: Sequence[Ranked]
    ambiguity: Sequence[str]
    where: Where
    gap: Shrink | None
    submodels: Sequence[Submodel]
    software: Sequence[str]
    table: GapTable | None
    table_after: GapTable | None
    traces: Sequence[Trace]
    sentence: str
    moves: Mapping[str, float] = field(default_factory=dict)
    notes: Sequence[str] = ()
    proposal: Proposal | None = None

    @property
    def probability(self) -> float:
        """Of the verdict."""
        return next(r.probability for r in self.ranking if r.effect == self.verdict)
