"""All exams counted together: shares with their intervals, by effect, and whether the stated probabilities hold.

python experiments/machines_exam/together.py     writes together.csv, by_effect.csv and the figure of reliability

First scores as they were given, under the rule of their day. The probability of a verdict is that of all names that no
recording tells from it: they count as right together.
"""

from __future__ import annotations

import csv
import json
import sys
from pathlib import Path

import numpy as np

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE), str(HERE.parent / "lab")]  # the study's own files and the lab, however it is started

from exam_pictures import reliability_figure  # noqa: E402
from examiner.score import BINS, calibrated, ece  # noqa: E402
from run import FIGURES, SEEDS, named, share, write  # noqa: E402
from specimens import ALIKE  # noqa: E402

from loopshape.io.files import write_bytes_whole  # noqa: E402
from loopshape.view.style import png  # noqa: E402


def main() -> None:
    """Both tables and the figure."""
    rows = [row for seed in SEEDS for row in marked(HERE / f"seed-{seed}")]
    single = [r for r in rows if r["kind"] == "single"]
    sized = [r for r in single if r["right"] == "True" and r["effect"] not in ("viscous_error", "joint_flexibility")]
    shares = [
        share("kind and place named, single effects", single, lambda r: r["right"] == "True"),
        share("among the first two", single, lambda r: r["second"] == "True"),
        share("place right", single, lambda r: r["place"] == "True"),
        share("false alarms on healthy machines", of(rows, "none"), lambda r: r["right"] != "True"),
        share("unlisted effects recognised", of(rows, "unlisted"), lambda r: r["right"] == "True"),
        share("size within 20 %", sized, lambda r: abs(float(r["found"]) / float(r["magnitude"]) - 1.0) < 0.2),
        share("95 % interval of the size covers it", sized, lambda r: r["covered"] == "True"),
    ]
    right = np.array([float(r["right"] == "True") for r in rows])
    stated = np.array([r["stated"] for r in rows])
    c = calibrated(stated, right)
    low, high = drawn_error(stated, right)
    shrinks = [shrink(r) for r in single if r["right"] == "True"]
    more = [
        ("held-out shrink of the named effect, median", "", len(shrinks), f"{np.median(shrinks):.3f}",
         *(f"{q:.3f}" for q in np.quantile(shrinks, (0.025, 0.975)))),
        ("calibration error", "", len(rows), f"{c.ece:.3f}", f"{low:.3f}", f"{high:.3f}"),
        ("calibration error of perfect answers", "", len(rows), f"{c.null_mean:.3f}", "", f"{c.null_95:.3f}"),
    ]  # fmt: skip
    write(HERE / "together.csv", ("share", "right", "of", "value", "low_95", "high_95"), [*shares, *more])
    kinds = sorted({(r["kind"], r["effect"]) for r in rows})
    table = [
        share(effect, [r for r in rows if r["effect"] == effect], lambda r: r["right"] == "True") for _, effect in kinds
    ]
    write(HERE / "by_effect.csv", ("effect", "right", "of", "value", "low_95", "high_95"), table)
    write_bytes_whole(FIGURES / "reliability.png", png(reliability_figure(c)))
    for row in (*shares, *more, *table):
        print(*row)


def marked(folder: Path) -> list[dict]:
    """Rows of an exam, each with the probability stated for its verdict and what cannot be told from it."""
    with (folder / "results.csv").open() as file:
        rows = list(csv.DictReader(file))
    for row in rows:
        answer = json.loads((folder / "answers" / f"{row['specimen']}.json").read_text())
        groups = [{named(kind, row["plant"]) for kind in group} for group in ALIKE[row["plant"]]]
        same = next((g for g in groups if row["verdict"] in g), {row["verdict"]})
        row["stated"] = min(sum(r["probability"] for r in answer["ranking"] if r["effect"] in same), 1.0)
    return rows


def of(rows: list[dict], kind: str) -> list[dict]:
    """Rows of one kind."""
    return [r for r in rows if r["kind"] == kind]


def shrink(row: dict) -> float:
    """Share of the held-out gap above the noise floor that the effect takes away."""
    before, after = float(row["before"]), float(row["after"])
    return (before - after) / (before - 1.0)


def drawn_error(stated: np.ndarray, right: np.ndarray, draws: int = 2000) -> tuple[float, float]:
    """95 % interval of the calibration error, specimens drawn with replacement (Efron 1979)."""
    rng = np.random.default_rng(1)
    picks = rng.integers(0, right.size, (draws, right.size))
    bins = np.minimum((stated * BINS).astype(int), BINS - 1)
    found = [ece(stated[p], right[p], bins[p]) for p in picks]
    return float(np.quantile(found, 0.025)), float(np.quantile(found, 0.975))


if __name__ == "__main__":
    main()
