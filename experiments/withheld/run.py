"""Answers for the nine arms whose effect nobody told: answers/*.json, answers.csv, figures/withheld/*.png."""

from __future__ import annotations

import csv
import json
import os
import time
from pathlib import Path

import loopshape as ls
from loopshape.io.files import write_bytes_whole, write_json
from loopshape.toolbox.gap.pictures.report import gap_figure
from loopshape.view.style import png

HERE = Path(__file__).parent
RUNS = Path(os.environ.get("LOOPSHAPE_WITHHELD", HERE.parents[2] / "shared" / "withheld"))
FIGURES = HERE.parents[1] / "figures" / "withheld"


def main() -> None:
    """Diagnose every run folder found; an answer that exists is kept: it was given before anyone told the truth."""
    folders = sorted(p.parent for p in RUNS.glob("*/run.toml"))
    if not folders:
        print(f"withheld: no run folders in {RUNS} (set LOOPSHAPE_WITHHELD); nothing done")
        return
    answers = HERE / "answers"
    answers.mkdir(exist_ok=True)
    FIGURES.mkdir(parents=True, exist_ok=True)
    for folder in folders:
        path = answers / f"{folder.name}.json"
        if path.exists():
            continue
        start = time.monotonic()
        found = ls.gap(folder)
        write_json(path, found.to_dict())
        write_bytes_whole(FIGURES / f"{folder.name}.png", png(gap_figure(found)))
        print(f"{folder.name}: {found.sentence} ({time.monotonic() - start:.0f} s)")
    table(sorted(answers.glob("*.json")))


def table(paths: list[Path]) -> None:
    """One row an arm: verdict, probabilities of the first three, magnitude, held-out gap."""
    with (HERE / "answers.csv").open("w", newline="") as file:
        out = csv.writer(file, lineterminator="\n")
        out.writerow(["arm", "verdict", "probability", "second", "its", "third", "its", "magnitude", "before", "after"])
        for path in paths:
            a = json.loads(path.read_text())
            first, second, third = a["ranking"][:3]
            gap = a["gap"] or {}
            parts = first.get("parts", {}).values()
            sizes = first.get("magnitude") or ", ".join(f"{p['magnitude']:.3g}" for p in parts)
            row = [path.stem, first["effect"], first["probability"], second["effect"], second["probability"]]
            row += [third["effect"], third["probability"], sizes, gap.get("before"), gap.get("after")]
            out.writerow([f"{v:.4g}" if isinstance(v, float) else v for v in row])


if __name__ == "__main__":
    main()
