"""Rows for the scoreboard: what the source says, what came out, and a verdict that a rule decides."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from dataclasses import astuple, dataclass, fields
from pathlib import Path

from loopshape.toolbox.arm.source import number

AGREES, PARTLY, DIFFERS, APART = "agrees", "partly", "differs", "not comparable"


@dataclass(frozen=True)
class Score:
    """One line: item and quantity, the source's words with keys in braces, ours, the verdict and its cause."""

    item: str
    quantity: str
    source: str
    ours: str
    verdict: str
    why: str = ""


def judged(key: str, low: float, high: float, partly_within: float) -> str:
    """Agrees where the interval meets the printed digit, partly within a share of the printed value."""
    printed = number(key)
    value, half = printed.value, printed.half_digit
    if low <= value + half and high >= value - half:
        return AGREES
    nearest = min(abs(low - value), abs(high - value))
    return PARTLY if nearest <= partly_within * abs(value) else DIFFERS


def within(value: float, required: float, error: float, partly: float = 2.0) -> str:
    """Agrees within an error, partly within `partly` times that."""
    off = abs(value - required)
    return AGREES if off <= error else PARTLY if off <= partly * error else DIFFERS


def holds(share: float) -> str:
    """Of a statement about many: agrees where it holds for all, partly for more than half."""
    return AGREES if share >= 1.0 else PARTLY if share > 0.5 else DIFFERS


def write_scores(path: Path, scores: Sequence[Score]) -> None:
    """The table as CSV."""
    with path.open("w", newline="") as file:
        out = csv.writer(file, lineterminator="\n")
        out.writerow([field.name for field in fields(Score)])
        out.writerows(astuple(score) for score in scores)
