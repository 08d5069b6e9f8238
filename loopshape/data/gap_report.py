"""What a gap diagnosis answers: which effect, where, how far the gap shrinks, and how sure all that is."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

from loopshape.core.units import Array
from loopshape.data.gap_table import GapTable
from loopshape.data.study import Study

FORMAT = "loopshape-gap/1"


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

    def to_dict(self) -> dict[str, Any]:
        """For JSON: what is not known of it is left out."""
        row: dict[str, Any] = {"effect": self.effect, "probability": self.probability}
        if self.magnitude is not None:
            row |= {"magnitude": self.magnitude, "interval": self.interval, "unit": self.unit, "form": self.form}
        if self.parts:
            named = (dict(zip(("magnitude", "interval", "unit"), part, strict=True)) for part in self.parts.values())
            row |= {"form": self.form, "parts": dict(zip(self.parts, named, strict=True))}
        return row


@dataclass(frozen=True)
class Submodel:
    """How far a submodel is off in one recording: rms relative to its noise floor, nominal and with the effect."""

    recording: str
    role: str
    path: str
    before: float
    after: float | None
    rival: float | None


@dataclass(frozen=True)
class Where:
    """The place: block with probabilities of all, channel, band, operating points.

    `places`: residual if this equation had an arbitrary disturbance, relative to the noise floor in the channels that
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
    """The gap on validation recordings, relative to the floor that noise and manufacturing tolerance leave (1.0)."""

    metric: str
    before: float
    after: float
    shrink: float | None
    interval: tuple[float, float] | None
    recordings: Sequence[str]
    rival: str | None = None
    rival_after: float | None = None

    def to_dict(self) -> dict[str, Any]:
        """For JSON, with the recordings' files."""
        files = [f"{name}.parquet" if "." not in name else name for name in self.recordings]
        return {"metric": self.metric, "noise_floor": 1.0} | asdict(self) | {"recordings": files}


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
    """The experiment that best separates the two hypotheses of `parts`, the first of a study ready to be measured.

    `study` is None where the controller is not known: then `name` is a recording to repeat.
    `separation` is the predicted rms difference of the outputs over what noise alone makes: 1 separates nothing.
    """

    name: str
    parts: tuple[str, str]
    separation: float
    study: Study | None
    sentence: str

    def to_dict(self) -> dict[str, Any]:
        """For JSON: what it parts, by how much, and its study as in a study file."""
        return {
            "name": self.name,
            "parts": list(self.parts),
            "separation": self.separation,
            "sentence": self.sentence,
            "study": None if self.study is None else self.study.to_table(),
        }


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

    @property
    def control(self) -> list[dict[str, Any]]:
        """What the gap means for control, recording by recording: nu-gaps before and after, and their scale."""
        if self.table is None:
            return []
        after = {(r.loop, r.recording): r.value for r in (self.table_after.nu_gaps if self.table_after else ())}
        return [
            {
                "loop": r.loop,
                "recording": r.recording,
                "operating_point": dict(r.operating_point),
                "nu_gap_before": r.value,
                "nu_gap_after": after.get((r.loop, r.recording)),
                "nu_gap_to_nearest_point": r.scale,
            }
            for r in self.table.nu_gaps
        ]

    def to_dict(self) -> dict[str, Any]:
        """The answer that other tools read as JSON; `docs/gap.md` lists its keys."""
        return {
            "format": FORMAT,
            "run": self.run,
            "plant": self.plant,
            "verdict": self.verdict,
            "ranking": [r.to_dict() for r in self.ranking],
            "ambiguity_set": list(self.ambiguity),
            "where": asdict(self.where) | {"place": self.where.block},
            "gap": None if self.gap is None else self.gap.to_dict(),
            "submodels": [asdict(s) for s in self.submodels],
            "next_experiment": None if self.proposal is None else self.proposal.to_dict(),
            "control": self.control,
            "parameters": dict(self.moves),
            "software": list(self.software),
            "notes": list(self.notes),
            "sentence": self.sentence,
        }
