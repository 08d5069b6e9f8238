"""Small tables of what came out."""

from __future__ import annotations

import csv
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from nine_actions import Rules
from trial_outcomes import Summary, interval_percent

#: trials, actions, setpoints reached, trials that move at the end and at how many Hz
Curve = list[tuple[int, int, int, int, float]]
Counts = dict[tuple[float, float], int]
Rows = Sequence[Sequence[object]]
OUTCOME = (
    "trials", "reached", "percent", "low_95", "high_95", "left_range", "settling_s", "static_deg", "stayed", "moving",
    "span_deg", "span_90_deg", "frequency_hz", "edges_hz",
)  # fmt: skip


@dataclass(frozen=True, eq=False)
class Results:
    """Everything that tables, scores and figures are made of."""

    settings: Mapping[str, Any]
    rules: Rules
    curves: dict[int, Curve]
    variant_curves: dict[str, dict[int, Curve]]
    tried: dict[tuple[str, str], tuple[Summary, Counts]]  # by (who, arm)
    variants: dict[tuple[str, int], tuple[Summary, Counts]]  # by (variant, seed)
    tracking: dict[tuple[str, float], tuple[float, float]]  # rms and largest error in deg by (who, Hz)

    @property
    def learners(self) -> list[str]:
        """Names of the learners, one a seed."""
        return [f"learner {seed}" for seed in self.curves]

    def together(self, arm: str, what: str) -> tuple[int, int]:
        """A count of all learners' trials on an arm, and how many trials."""
        found = [self.tried[name, arm][0] for name in self.learners]
        return sum(getattr(s, what) for s in found), sum(s.trials for s in found)

    def trials_to(self, percent: float) -> dict[int, int | None]:
        """Trials after which each learner first reaches this share of the watched setpoints; None: never."""
        asked = self.settings["learner"]["curve_trials"] * percent / 100.0
        return {seed: next((n for n, _, hits, *_ in c if hits >= asked), None) for seed, c in self.curves.items()}

    def restless(self, variant: str) -> int:
        """The seed of a variant that moves most often at the end."""
        return max((s for n, s in self.variants if n == variant), key=lambda s: self.variants[variant, s][0].moving)


def write_rows(path: Path, rows: Rows) -> None:
    """A small table."""
    with path.open("w", newline="", encoding="utf-8") as file:
        csv.writer(file, lineterminator="\n").writerows(rows)


def write_tables(folder: Path, results: Results) -> None:
    """All tables, and the main ones on the screen."""
    tables: dict[str, Rows] = {
        "outcomes.csv": [("who", "arm", *OUTCOME), *([*k, *cells(s)] for k, (s, _) in results.tried.items())],
        "variants.csv": [("variant", "seed", *OUTCOME), *([*k, *cells(s)] for k, (s, _) in results.variants.items())],
        "curves.csv": curve_rows(results),
        "tolerance.csv": tolerance_rows(results),
        "tracking.csv": [
            ("who", "frequency_hz", "rms_deg", "largest_deg"),
            *([who, hz, *(number(v) for v in errors)] for (who, hz), errors in results.tracking.items()),
        ],
    }
    for name, rows in tables.items():
        write_rows(folder / name, rows)
        if name != "curves.csv":
            print(f"-- {name}")
            for row in rows:
                print("  ".join(f"{cell!s:>11.18}" for cell in row))


def number(value: float) -> str:
    """Three digits; nothing for nan."""
    return "" if value != value else f"{value:.3g}"


def cells(s: Summary) -> list[object]:
    """A summary in the order of OUTCOME."""
    rate = [f"{v:.0f}" for v in interval_percent(s.reached, s.trials)]
    found: list[object] = [s.trials, s.reached, *rate, s.left_range, number(s.settling_s), number(s.static_deg)]
    found += [s.stayed, s.moving, number(s.span_deg), number(s.span_90_deg), number(s.frequency_hz)]
    return [*found, number(s.edges_hz)]


def curve_rows(results: Results) -> Rows:
    """Every evaluation of every learner."""
    named = {"learner": results.curves} | results.variant_curves
    rows = [
        (n, seed, *at[:4], number(at[4]))
        for n, curves in named.items()
        for seed, curve in curves.items()
        for at in curve
    ]
    return [("learner", "seed", "trials", "actions", "reached", "moving", "frequency_hz"), *rows]


def tolerance_rows(results: Results) -> Rows:
    """Setpoints reached by tolerance and by how long it must be kept, nominal arm."""
    columns = list(next(iter(results.tried.values()))[1])
    head = ("who", *(f"within_{t:g}_deg_for_{h:g}_s" for t, h in columns))
    return [
        head,
        *([who, *(c[k] for k in columns)] for (who, arm), (_, c) in results.tried.items() if arm == "nominal"),
    ]
