"""From opened labels and answers to scores, each share with its Clopper-Pearson interval, against the exam's bars.

An answer is the JSON of a gap diagnosis as a dict (docs/files.md) with `time_s` beside it. Every count is of cases
that nobody chose afterwards: an answer that broke off has the verdict `failed` and is wrong everywhere.
"""

from __future__ import annotations

import csv
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, astuple, dataclass, fields
from io import StringIO
from math import isnan, nan
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.stats import beta, binom

from loopshape.core.units import Array

from .labels import BLOCKS, OUTSIDE, verdict

FORMAT = "loopshape-exam-scores/1"
FAILED, PAIR = "failed", "pair"
NEAR = 0.2  # relative error of a magnitude that still counts as right
BINS = 10
NULL_DRAWS = 4000


class Share(NamedTuple):
    """`right` of `of` cases, its value (nan without cases), and its 95 % interval after Clopper and Pearson."""

    right: int
    of: int
    value: float
    interval: tuple[float, float]


class Spread(NamedTuple):
    """Median of `of` numbers, its 95 % interval by order statistics, quartiles, mean and largest."""

    of: int
    median: float
    interval: tuple[float, float]
    quartiles: tuple[float, float]
    mean: float
    largest: float


class Bin(NamedTuple):
    """Answers of like confidence: their mean confidence, and how many of them were right."""

    confidence: float
    right: Share


@dataclass(frozen=True)
class Calibration:
    """Expected calibration error over equal bins and over bins of equal count, and what perfect answers would show."""

    ece: float
    ece_adaptive: float
    null_mean: float
    null_95: float
    bins: tuple[Bin, ...]


@dataclass(frozen=True)
class Label:
    """What was sealed of a case: the effects with their magnitudes, and which of the generator's forms made them."""

    case: str
    kind: str
    labels: Mapping[str, float]
    variant: int

    @property
    def truth(self) -> str:
        """The verdict that would be right."""
        return verdict(self.labels)


@dataclass(frozen=True)
class Marked:
    """One case beside its answer. `rank` counts from 1; magnitudes, error, `covered`, `shrink` of single effects."""

    case: str
    kind: str
    truth: str
    variant: int
    verdict: str
    probability: float
    rank: int | None
    block_ok: bool
    set_size: int
    in_set: bool
    named: int
    magnitude_truth: float | None
    magnitude: float | None
    magnitude_error: float | None
    covered: bool | None
    shrink: float | None
    time_s: float

    @property
    def right(self) -> bool:
        """Whether the verdict is the truth."""
        return self.verdict == self.truth


class Bar(NamedTuple):
    """A bar of the exam: what must be reached, what is aimed at, if anything; `upwards` where more is better."""

    name: str
    score: str
    must: float = nan
    aim: float = nan
    upwards: bool = True
    unit: str = "%"


BARS = (
    Bar("single effects named", "single", 0.85, 0.95),
    Bar("truth among the first two", "first_two", 0.92, 0.98),
    Bar("block of single effects", "block", 0.95, 0.99),
    Bar("false alarms on healthy arms", "false_alarms", 0.05, 0.02, False),
    Bar("unknowns recognised", "unknown", 0.70, 0.90),
    Bar("pairs, both named", "pairs", 0.60, 0.85),
    Bar("expected calibration error", "calibration", 0.10, 0.06, False, "1"),
    Bar("held-out shrink, median", "shrink", 0.80, 0.95),
    Bar("magnitude within 20 %", "magnitude", 0.70, 0.90),
    Bar("time an arm, median", "time_s", 180.0, 60.0, False, "s"),
    Bar("unknowns, called so or put into their block", "unknown_or_block"),
    Bar("pairs, at least one named", "pairs_one"),
    Bar("truth in the ambiguity set", "set_coverage"),
    Bar("size of the ambiguity set, median", "set_size", unit="1"),
    Bar("magnitude in its 95 % interval", "interval_coverage"),
    Bar("relative error of the magnitude, median", "magnitude_error", unit="1"),
)


class Line(NamedTuple):
    """A score against its bar: `met` is aim, must, missed, or - without cases or bar."""

    bar: Bar
    value: float
    interval: tuple[float, float] | None
    of: int
    met: str


@dataclass(frozen=True)
class Scores:
    """Everything that an exam tells. Magnitude, its interval and the shrink count where the effect was named right."""

    cases: int
    failed: int
    single: Share
    first_two: Share
    block: Share
    false_alarms: Share
    unknown: Share
    unknown_or_block: Share
    pairs: Share
    pairs_one: Share
    calibration: Calibration
    set_size: Spread
    set_coverage: Share
    magnitude: Share
    magnitude_error: Spread
    interval_coverage: Share
    shrink: Spread
    no_gap_to_shrink: int
    time_s: Spread
    by_effect: Mapping[str, Share]
    by_variant: Mapping[str, Share]
    by_form: Mapping[str, Share]
    confusion: Mapping[str, Mapping[str, int]]


def share(right: int, of: int, level: float = 0.95) -> Share:
    """A share with its two-sided interval (Clopper and Pearson 1934)."""
    rest = 0.5 * (1.0 - level)
    low = float(beta.ppf(rest, right, of - right + 1)) if right > 0 else 0.0
    high = float(beta.ppf(1.0 - rest, right + 1, of - right)) if right < of else 1.0
    return Share(right, of, right / of if of else nan, (low, high))


def spread(values: Sequence[float]) -> Spread:
    """Median and quartiles; the median's interval is free of any distribution, as wide as it goes for a few numbers."""
    n = len(values)
    if n == 0:
        return Spread(0, nan, (nan, nan), (nan, nan), nan, nan)
    x = np.sort(np.asarray(values, dtype=float))
    first = max(int(binom.ppf(0.025, n, 0.5)), 1)  # the median lies outside x[first-1]..x[n-first] in at most 5 %
    low, middle, high = (float(q) for q in np.percentile(x, [25.0, 50.0, 75.0]))
    return Spread(n, middle, (float(x[first - 1]), float(x[n - first])), (low, high), float(x.mean()), float(x[-1]))


def mark(label: Label, answer: Mapping[str, Any]) -> Marked:
    """A case beside its answer; the ranking may come in any order."""
    truth = label.truth
    ranking = sorted(answer["ranking"], key=lambda row: -row["probability"])
    names = [row["effect"] for row in ranking]
    said, gap = str(answer["verdict"]), answer.get("gap") or {}
    inside = [name for group in answer.get("ambiguity_set", ()) for name in group]
    own = ranking[names.index(truth)] if label.kind == "single" and said == truth and truth in names else {}
    true_size = label.labels[truth] if label.kind == "single" else None
    found, interval = own.get("magnitude"), own.get("interval")
    return Marked(
        case=label.case,
        kind=label.kind,
        truth=truth,
        variant=label.variant,
        verdict=said,
        probability=float(ranking[names.index(said)]["probability"]) if said in names else nan,
        rank=names.index(truth) + 1 if truth in names else None,
        block_ok=_block_ok(label, said, str((answer.get("where") or {}).get("block"))),
        set_size=len(inside),
        in_set=truth in inside,
        named=len(set(said.split("+")) & set(label.labels)),
        magnitude_truth=true_size,
        magnitude=found,
        magnitude_error=None if found is None or true_size is None else abs(found / true_size - 1.0),
        covered=bool(interval[0] <= true_size <= interval[1]) if interval and true_size is not None else None,
        shrink=gap.get("shrink") if label.kind == "single" and said == truth else None,
        time_s=float(answer["time_s"]),
    )


def _block_ok(label: Label, said: str, block: str) -> bool:
    """Whether the place is right; an effect from outside may be called unknown or be put into its block."""
    if any(name in OUTSIDE for name in label.labels) and said == "unknown":
        return True
    return block == ("+".join(sorted(BLOCKS[name] for name in label.labels)) or "none")


def calibrated(confidence: Array, right: Array, seed: int = 1) -> Calibration:
    """Expected calibration error of answers (n,) and its distribution had they been right as often as they said."""
    if not confidence.size:
        return Calibration(nan, nan, nan, nan, bins=())
    equal = np.minimum((confidence * BINS).astype(int), BINS - 1)
    order = np.argsort(np.argsort(confidence, kind="stable"), kind="stable")
    adaptive = order * min(BINS, confidence.size) // confidence.size
    rng = np.random.default_rng(seed)
    draws = (rng.random((NULL_DRAWS, confidence.size)) < confidence).astype(float)
    null = [ece(confidence, drawn, equal) for drawn in draws]
    bins = tuple(
        Bin(float(confidence[m].mean()), share(int(right[m].sum()), int(m.sum())))
        for m in (equal == k for k in np.unique(equal))
    )
    found, found_adaptive = (ece(confidence, right, at) for at in (equal, adaptive))
    return Calibration(found, found_adaptive, float(np.mean(null)), float(np.quantile(null, 0.95)), bins)


def ece(confidence: Array, right: Array, bins: NDArray[np.integer[Any]]) -> float:
    """Expected calibration error: |right - confidence| of each bin's means, weighed by its count; `bins` (n,)."""
    off = np.bincount(bins, weights=right - confidence)
    return float(np.abs(off).sum() / confidence.size)


def score(marked: Sequence[Marked], seed: int = 1) -> Scores:
    """All scores of an exam; `seed` draws the null of the calibration error."""
    single, healthy, unknown, pairs = (
        [m for m in marked if m.kind == kind] for kind in ("single", "healthy", "unknown", "pair")
    )
    named = [m for m in single if m.right]
    sized = [m.magnitude_error for m in named if m.magnitude_error is not None]
    covered = [m.covered for m in named if m.covered is not None]
    shrinks = [m.shrink for m in named if m.shrink is not None]
    said = [m for m in marked if np.isfinite(m.probability)]
    return Scores(
        cases=len(marked),
        failed=sum(m.verdict == FAILED for m in marked),
        single=_share(single, lambda m: m.right),
        first_two=_share(single, lambda m: m.rank is not None and m.rank <= 2),
        block=_share(single, lambda m: m.block_ok),
        false_alarms=_share(healthy, lambda m: not m.right),
        unknown=_share(unknown, lambda m: m.right),
        unknown_or_block=_share(unknown, lambda m: m.block_ok),
        pairs=_share(pairs, lambda m: m.right),
        pairs_one=_share(pairs, lambda m: m.named >= 1),
        calibration=calibrated(np.array([m.probability for m in said]), np.array([float(m.right) for m in said]), seed),
        set_size=spread([m.set_size for m in marked]),
        set_coverage=_share(marked, lambda m: m.in_set),
        magnitude=share(sum(e <= NEAR for e in sized), len(sized)),
        magnitude_error=spread(sized),
        interval_coverage=share(sum(covered), len(covered)),
        shrink=spread(shrinks),
        no_gap_to_shrink=sum(m.shrink is None for m in named),
        time_s=spread([m.time_s for m in marked]),
        by_effect=_by(single, lambda m: m.truth),
        by_variant=_by(single, lambda m: str(m.variant)),
        by_form=_by(single, lambda m: f"{m.truth}/{m.variant}"),
        confusion=confusion(marked),
    )


def _share(marked: Sequence[Marked], right: Callable[[Marked], bool]) -> Share:
    return share(sum(right(m) for m in marked), len(marked))


def _by(marked: Sequence[Marked], key: Callable[[Marked], str]) -> dict[str, Share]:
    return {k: _share([m for m in marked if key(m) == k], lambda m: m.right) for k in sorted(set(map(key, marked)))}


def confusion(marked: Sequence[Marked]) -> dict[str, dict[str, int]]:
    """Counts by truth, then by verdict; all pairs are `pair`, and a pair named wrong has the verdict `wrong pair`."""
    out: dict[str, dict[str, int]] = {}
    for m in marked:
        said = m.verdict if "+" not in m.verdict else PAIR if m.right or "+" not in m.truth else f"wrong {PAIR}"
        row = out.setdefault(PAIR if "+" in m.truth else m.truth, {})
        row[said] = row.get(said, 0) + 1
    return out


def against_bars(scores: Scores) -> list[Line]:
    """Each bar with the score that it is for, and the scores beside them."""
    return [_line(bar, getattr(scores, bar.score)) for bar in BARS]


def _line(bar: Bar, found: Share | Spread | Calibration) -> Line:
    if isinstance(found, Calibration):
        of, value, interval = sum(b.right.of for b in found.bins), found.ece, None
    else:
        of, interval = found.of, found.interval
        value = found.value if isinstance(found, Share) else found.median
    if of == 0 or isnan(bar.must):
        return Line(bar, value, interval, of, "-")
    side = 1.0 if bar.upwards else -1.0
    met = [name for name, level in (("aim", bar.aim), ("must", bar.must)) if side * value >= side * level]
    return Line(bar, value, interval, of, met[0] if met else "missed")


def as_csv(marked: Sequence[Marked]) -> str:
    """One row a case, with a header; what is not known is empty."""
    text = StringIO()
    table = csv.writer(text, lineterminator="\n")
    table.writerows([[f.name for f in fields(Marked)], *(astuple(m) for m in marked)])
    return text.getvalue()


def as_json(scores: Scores) -> dict[str, Any]:
    """Scores and bars as words, numbers, lists and mappings; None where there is no case or no bar."""
    lines = [
        {**line.bar._asdict(), "value": line.value, "interval": line.interval, "of": line.of, "met": line.met}
        for line in against_bars(scores)
    ]
    return {"format": FORMAT, "bars": _plain(lines)} | {k: _plain(v) for k, v in asdict(scores).items()}


def _plain(value: Any) -> Any:
    """Named tuples as mappings and what is not known as None, all the way down."""
    if isinstance(value, float) and isnan(value):
        return None
    if hasattr(value, "_asdict"):
        return _plain(value._asdict())
    if isinstance(value, Mapping):
        return {k: _plain(v) for k, v in value.items()}
    return [_plain(v) for v in value] if isinstance(value, list | tuple) else value
