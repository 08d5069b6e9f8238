"""Small tables beside a study, and rows of the scoreboard."""

from __future__ import annotations

import csv
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

SCORES = ("item", "quantity", "source", "ours", "verdict", "why")
AGREES, PARTLY, DIFFERS, NOT_COMPARABLE = "agrees", "partly", "differs", "not comparable"


def write(path: Path, columns: Sequence[str], rows: Iterable[Sequence[Any]]) -> list[list[Any]]:
    """Write a table, numbers to four digits, print it, and give its rows."""
    kept = [[f"{v:.4g}" if isinstance(v, float) else v for v in row] for row in rows]
    with path.open("w", newline="") as file:
        csv.writer(file, lineterminator="\n").writerows([columns, *kept])
    print(f"-- {path.name}")
    for row in (columns, *kept):
        print("  ".join(f"{cell!s:>14.70}" for cell in row))
    return kept


def verdict(good: bool, *, otherwise: str = DIFFERS) -> str:
    """What a rule says."""
    return AGREES if good else otherwise
