"""CSV of the study, numbers to four digits."""

from __future__ import annotations

import csv
from collections.abc import Iterable, Sequence
from pathlib import Path


def write(path: Path, rows: Iterable[Sequence[object]]) -> None:
    """A table, numbers to four digits."""
    with path.open("w", newline="", encoding="utf-8") as file:
        out = csv.writer(file, lineterminator="\n")
        for row in rows:
            out.writerow([f"{x:.4g}" if isinstance(x, float) else x for x in row])
