"""Draws the pictures of README and docs anew, and notes what they show in figures/shown.json: `make pictures`.

A test computes these numbers anew and compares: where it is red the pictures are older than the code.
"""

import json
import os
import runpy
from pathlib import Path

import matplotlib

import loopshape as ls

DOCS = Path(__file__).parent
FIGURES, BENCH = DOCS.parent / "figures", DOCS.parent / "examples" / "motor_bench"


def shown() -> dict[str, dict[str, list[float]]]:
    """By folder and requirement the worst case and the ends of its 95 % interval, computed anew.

    The report's are those of the README: `tune` ends at the shipped controller, and a test of the tour holds that.
    """
    P = ls.frf(ls.read_table(BENCH / "multisine_type_a.parquet", BENCH / "map.toml"))
    model = ls.fit(P, "rational", numerator=2, denominator=4, delay=True, weighting="relative")
    (own,) = ls.read_controllers(BENCH / "controller.toml")
    (R,) = ls.read_requirements(BENCH / "requirements.toml")
    verdicts = {
        "readme": ls.check(P, own, R, fits=[model]),
        "shape": ls.check(*runpy.run_path(str(DOCS / "shape_pictures.py"))["walk"]()),
    }
    return {
        name: {
            row["requirement"]: [float(row[k]) for k in ("worst case", "low", "high")]
            for _, row in verdict.table().iterrows()
        }
        for name, verdict in verdicts.items()
    }


def draw() -> None:
    """The README's by the first example of the gallery, the pages' in the system's Chromium."""
    here, readme = Path.cwd(), FIGURES / "readme"
    readme.mkdir(parents=True, exist_ok=True)
    os.chdir(DOCS / "gallery")  # examples read their data two folders above themselves
    figure = runpy.run_path("1_bench.py")["figure"]
    os.chdir(here)
    figure.savefig(readme / "bench.png", dpi=150)
    for script in (
        DOCS / "shape_pictures.py",
        DOCS.parent / "experiments" / "report" / "run.py",
    ):
        runpy.run_path(str(script), run_name="__main__")


if __name__ == "__main__":
    matplotlib.use("Agg")
    draw()
    (FIGURES / "shown.json").write_text(json.dumps(shown(), indent=1) + "\n")
