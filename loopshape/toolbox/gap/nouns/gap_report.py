"""What a gap diagnosis answers: which effect, where, how far the gap shrinks, and how sure all that is."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from enum import StrEnum
from typing import TYPE_CHECKING, Any

from loopshape.core.units import Array
from loopshape.toolbox.gap.nouns.effect import Fix
from loopshape.toolbox.gap.nouns.gap_table import GapTable
from loopshape.toolbox.rig.study import Study

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FORMAT = "loopshape-gap/1"


def percent(p: float) -> str:
    """A probability in whole percent; near 0 and 1 on which side of 1 and 99 % it lies."""
    return "< 1 %" if p < 0.01 else "> 99 %" if p > 0.99 else f"{100.0 * p:.0f} %"


@dataclass(frozen=True)
class Ranked:
    """One hypothesis: `magnitude`, its 95 % `interval` and `unit` for single effects; for pairs one each, by effect.

    `quantities` says by effect what a magnitude without a unit is.
    """

    effect: str
    probability: float
    magnitude: float | None = None
    interval: tuple[float, float] | None = None
    unit: str | None = None
    form: str | None = None
    parts: Mapping[str, tuple[float, tuple[float, float] | None, str]] = field(default_factory=dict)
    quantities: Mapping[str, str] = field(default_factory=dict)

    @property
    def sizes(self) -> dict[str, tuple[str, tuple[float, float] | None]]:
        """By effect its size in words, "61.2 g" or "gas absolute share 0.9", and the interval; {} without a fit."""
        parts = dict(self.parts)
        if self.magnitude is not None:
            parts = {self.effect: (self.magnitude, self.interval, self.unit or "1")}
        return {name: (self._words(name, m, unit), interval) for name, (m, interval, unit) in parts.items()}

    def _words(self, effect: str, magnitude: float, unit: str) -> str:
        return f"{self.quantities.get(effect, '')} {magnitude:.3g} {'' if unit == '1' else unit}".strip()

    def to_dict(self) -> dict[str, Any]:
        """For JSON: what is not known of it is left out."""
        row: dict[str, Any] = {"effect": self.effect, "probability": self.probability}
        if self.magnitude is not None:
            row |= {"magnitude": self.magnitude, "interval": self.interval, "unit": self.unit, "form": self.form}
        if self.quantities:
            row["quantities"] = dict(self.quantities)
        if self.parts:
            named = (dict(zip(("magnitude", "interval", "unit"), part, strict=True)) for part in self.parts.values())
            row |= {"form": self.form, "parts": dict(zip(self.parts, named, strict=True))}
        return row


@dataclass(frozen=True)
class Visible:
    """An effect, the least size of it that recordings show (None where they show nothing), and what looks like it."""

    effect: str
    least: float | None
    unit: str
    alike: tuple[str, ...]


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
    """The gap on validation recordings, relative to the floor that noise and manufacturing tolerance leave (1.0).

    `after` is with the effect `of`: the verdict's, for unknown the best name; None for none.
    """

    metric: str
    before: float
    after: float
    shrink: float | None
    interval: tuple[float, float] | None
    recordings: Sequence[str]
    rival: str | None = None
    rival_after: float | None = None
    of: str | None = None

    def to_dict(self) -> dict[str, Any]:
        """For JSON, with the recordings' files."""
        files = [f"{name}.parquet" if "." not in name else name for name in self.recordings]
        return {"metric": self.metric, "noise_floor": 1.0} | asdict(self) | {"recordings": files}


@dataclass(frozen=True, eq=False)
class Curve:
    """What acts at a place, without a name: a force or signal over one quantity x (n,), less its mean, with a 95 %
    interval, and what the best named effect there would be (None where there is none).

    `explains` is the share of the held-out gap that all curves of the place take away together, None where it is not
    known.
    """

    place: str
    over: str
    over_unit: str
    x: Array
    value: Array
    low: Array
    high: Array
    unit: str = ""
    named: Array | None = None
    explains: float | None = None

    @property
    def file(self) -> str:
        """Name of the table of its place."""
        return f"missing_{''.join(c if c.isalnum() else '_' for c in self.place)}.csv"

    @property
    def key(self) -> str:
        """The quantity with its unit, as a column's name."""
        return "_".join(filter(None, (self.over, self.over_unit.replace("/", "_").replace(" ", "_"))))


class BudgetPart(StrEnum):
    """What a step of a budget leaves: nothing added, the best effect, the best two, any push at a place, noise."""

    BEFORE = "before"
    BEST_NAME = "best_name"
    BEST_SET = "best_set"
    CEILING = "ceiling"
    FLOOR = "floor"


@dataclass(frozen=True)
class BudgetStep:
    """What is left of a gap with `effects` added (of the ceiling the place), on recordings held out or left out.

    `gap` is relative to the noise floor, `share` what it takes away of what lies beyond the floor with its 95 %
    `interval`, None where there is hardly a gap, or one recording alone.
    """

    step: BudgetPart
    effects: tuple[str, ...]
    gap: float
    share: float | None
    interval: tuple[float, float] | None = None


class FloorSource(StrEnum):
    """Where a floor comes from: noise and a share of the motion, the user, a good machine, or the error of FRFs."""

    ESTIMATED = "estimated"
    STATED = "leaves"
    BASELINE = "baseline"
    FRF = "frf"


@dataclass(frozen=True)
class Floor:
    """Rms of an output, in its unit and within a window, that is no gap: what a good model leaves."""

    output: str
    rms: float
    unit: str
    source: FloorSource


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
    """Everything that `loopshape gap` says of a run. `notes` tell what these recordings cannot.

    `by_recording` is which single effect, or none, predicts each recording best that was left out of its fit.
    `window_s` is how long a machine of the user's own was followed, chosen among `windows_s` where that was left open.
    `floors` are those of a machine of the user's own, by output.
    `ambiguity` are groups of names that the recordings cannot tell apart, best first, holding nine tenths together.
    """

    run: str
    plant: str
    verdict: str
    ranking: Sequence[Ranked]
    ambiguity: Sequence[Sequence[str]]
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
    budget: Sequence[BudgetStep] = ()
    missing: Sequence[Curve] = ()
    by_recording: Mapping[str, str] = field(default_factory=dict)
    window_s: float | None = None
    windows_s: Sequence[float] = ()
    floors: Sequence[Floor] = ()
    fix: Fix | None = None

    def figure(self) -> Figure:
        """Where the simulation leaves the machine, which effect causes it, and how that looks in time."""
        from loopshape.toolbox.gap.pictures.report import gap_figure

        return gap_figure(self)

    @property
    def probability(self) -> float:
        """Of the verdict."""
        return next(r.probability for r in self.ranking if r.effect == self.verdict)

    @property
    def kinds(self) -> dict[str, float]:
        """Probabilities summed over the places of each kind of effect (a+b for pairs), most probable first."""
        out: dict[str, float] = {}
        for r in self.ranking:
            kind = "+".join(sorted(part.partition("@")[0] for part in r.effect.split("+")))
            out[kind] = out.get(kind, 0.0) + r.probability
        return dict(sorted(out.items(), key=lambda item: -item[1]))

    @property
    def twins(self) -> tuple[str, ...]:
        """Names that these recordings cannot tell from the verdict."""
        mine = next((group for group in self.ambiguity if self.verdict in group), ())
        return tuple(name for name in mine if name != self.verdict)

    @property
    def agreeing(self) -> tuple[int, int]:
        """How many recordings the leading name predicts best, or one that is not told from it, and of how many."""
        mine = {self.leading_name, *self.twins}
        mine |= {part for name in mine for part in name.split("+")}
        return sum(name in mine for name in self.by_recording.values()), len(self.by_recording)

    def budget_step(self, part: BudgetPart) -> BudgetStep | None:
        """One step of the budget, None where it is not known."""
        return next((x for x in self.budget if x.step is part), None)

    @property
    def missing_by_place(self) -> dict[str, list[Curve]]:
        """Curves of the nameless force or signal at each place, the place that explains most first."""
        places = dict.fromkeys(c.place for c in self.missing)
        return {place: [c for c in self.missing if c.place == place] for place in places}

    @property
    def leading_name(self) -> str:
        """The verdict, or for none and unknown the effect or pair that comes next."""
        return next((r.effect for r in self.ranking if r.effect not in ("none", "unknown")), self.verdict)

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
            "ambiguity_set": [list(group) for group in self.ambiguity],
            "kinds": self.kinds,
            "by_recording": dict(self.by_recording),
            "window_s": self.window_s,
            "windows_tried_s": list(self.windows_s),
            "floors": [asdict(floor) for floor in self.floors],
            "where": asdict(self.where) | {"place": self.where.block},
            "gap": None if self.gap is None else self.gap.to_dict(),
            "submodels": [asdict(s) for s in self.submodels],
            "next_experiment": None if self.proposal is None else self.proposal.to_dict(),
            "budget": [asdict(step) for step in self.budget],
            "missing": [_missing(curves) for curves in self.missing_by_place.values()],
            "control": self.control,
            "parameters": dict(self.moves),
            "fix": None if self.fix is None else self.fix.to_dict(),
            "software": list(self.software),
            "notes": list(self.notes),
            "sentence": self.sentence,
        }


def _missing(curves: Sequence[Curve]) -> dict[str, Any]:
    """The nameless estimate at a place, for JSON; its curves stand in the file."""
    first = curves[0]
    over = [c.key for c in curves]
    return {"place": first.place, "over": over, "unit": first.unit, "file": first.file, "explains": first.explains}


def missing_csv(curves: Sequence[Curve]) -> str:
    """A place's curves as a table: quantity, its value, what would close the gap there with its interval, the name."""
    rows = ["over,x,value,low,high,named"]
    for c in curves:
        named = [""] * len(c.x) if c.named is None else [f"{v:.9g}" for v in c.named]
        columns = zip(c.x, c.value, c.low, c.high, strict=True)
        rows += [",".join((c.key, *(f"{v:.9g}" for v in row), name)) for row, name in zip(columns, named, strict=True)]
    return "\n".join(rows) + "\n"
