"""Is the comparison's p-value uniform where the plant has not changed, and how often is a changed plant noticed?

Lines with errors of known kind; one prediction and one measurement a run. Writes calibration.csv.
"""

from __future__ import annotations

import csv
import sys
from pathlib import Path

import numpy as np

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE.parent.parent / "tests" / "helpers" / name) for name in ("", "loops", "nouns")]

from predicted_loops import NEW, OLD, arm, measured, predicted  # noqa: E402

from loopshape.data.response.model import TransferFunction  # noqa: E402
from loopshape.toolbox.validation.comparison import compare, sensitivity_of  # noqa: E402

RUNS = 1000
NOISE = (0.02, 0.05, 0.1)
#: line overlap, averages behind each variance (0: it is known), lines that a variance is pooled over
KINDS = ((1.0, 0, 1), (1.94, 0, 1), (1.0, 5, 1), (1.0, 20, 1), (1.94, 20, 1), (1.94, 5, 5), (1.0, 4, 15))
LINES = (30, 150)
CHANGES = (
    ("none", arm()),
    ("gain +10 %", arm(kappa=1485.0)),
    ("resonance +2 %", arm(f_hz=5.1)),
    ("damping x 1.3", arm(zeta=0.083)),
)
COLUMNS = (
    "change", "noise", "lines", "overlap", "averages", "pooled", "below_0.01", "below_0.05", "below_0.2", "median",
    "would_notice_db",
)  # fmt: skip


def main() -> None:
    """All kinds where nothing changed; Hann segments where something did."""
    rows = [cell("none", arm(), noise, lines, kind) for noise in NOISE for lines in LINES for kind in KINDS]
    rows += [cell(name, plant, noise, 150, KINDS[4]) for name, plant in CHANGES[1:] for noise in NOISE]
    with (HERE / "calibration.csv").open("w", newline="") as file:
        csv.writer(file, lineterminator="\n").writerows([COLUMNS, *rows])


def cell(name: str, plant: TransferFunction, noise: float, lines: int, kind: tuple[float, int, int]) -> list[object]:
    """One row: shares of p-values below three levels."""
    f = (15.0 / lines) * np.arange(1, lines + 1)
    how = dict(zip(("overlap", "averages", "pooled"), kind, strict=True))
    p, noticed = [], []
    for seed in range(RUNS):
        rng = np.random.default_rng([seed, lines])
        one = measured(rng, f, arm().response(f), noise, OLD, **how)  # type: ignore[arg-type]
        two = measured(rng, f, plant.response(f), noise, NEW, **how)  # type: ignore[arg-type]
        found = compare(predicted(one), sensitivity_of(two))
        p.append(found.p_value)
        noticed.append(found.noticed_db)
    shares = [round(float(np.mean(np.array(p) < level)), 3) for level in (0.01, 0.05, 0.2)]
    print(name, noise, lines, kind, shares, flush=True)
    return [name, noise, lines, *kind, *shares, round(float(np.median(p)), 3), round(float(np.median(noticed)), 2)]


if __name__ == "__main__":
    main()
