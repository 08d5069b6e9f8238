"""Accuracy and coverage of every estimator of a frequency response, with the truth known: tables and figures."""

from __future__ import annotations

import csv
import sys
from collections.abc import Iterable
from pathlib import Path

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE))  # the study's own files, however it is started

import accuracy  # noqa: E402
import intervals  # noqa: E402

import figures  # noqa: E402


def main() -> None:
    """Write both tables and the figures; a quarter of an hour on one busy core (OMP_NUM_THREADS=1)."""
    covered = written("coverage.csv", intervals.COLUMNS, intervals.all_rows())
    ratios = written("accuracy.csv", accuracy.COLUMNS, (row for c in accuracy.cases() for row in accuracy.rows_of(c)))
    figures.draw_ratios(ratios)
    figures.draw_example()
    figures.draw_coverage(covered)
    summary(ratios, covered)


def written(name: str, columns: Iterable[str], rows: Iterable[list]) -> list[dict]:
    """Write a table, and give it back by names."""
    made = [dict(zip(columns, row, strict=True)) for row in rows]
    with (HERE / name).open("w", newline="") as file:
        writer = csv.DictWriter(file, columns)
        writer.writeheader()
        writer.writerows(made)
    return made


def summary(ratios: list[dict], covered: list[dict]) -> None:
    """Worst cases of both tables."""
    for method in ("local", "auto"):
        worst = sorted(ratios, key=lambda r: -r[f"{method}_over_best"])[:8]
        for r in worst:
            case = [r[k] for k in accuracy.COLUMNS[:7]]
            print(f"{method} over best Welch: {r[f'{method}_over_best']:.2f}  {case}")
    for word in ("inside", "undecided", "outside"):
        print(f"coverage {word}: {sum(r['verdict'] == word for r in covered)} of {len(covered)}")


if __name__ == "__main__":
    main()
