"""Draws figures/readme/bench.png, the picture of the README, by the first example of the gallery."""

import os
import runpy
from pathlib import Path

import matplotlib

DOCS = Path(__file__).parent

if __name__ == "__main__":
    matplotlib.use("Agg")
    out = DOCS.parent / "figures" / "readme" / "bench.png"
    out.parent.mkdir(exist_ok=True)
    os.chdir(DOCS / "gallery")  # examples read their data two folders above themselves
    runpy.run_path("1_bench.py")["figure"].savefig(out.resolve(), dpi=150)
