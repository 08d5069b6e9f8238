"""Runs every study, or those named: `python experiments/run.py [name ...]`. Each has its own run.py.

The exam is not one of them: it takes long, and its first score counts. `make exam` sits it.
"""

from __future__ import annotations

import runpy
import sys
from pathlib import Path

HERE = Path(__file__).parent
APART = frozenset({"exam"})


def main() -> None:
    """Run the studies in the order of their names."""
    names = sys.argv[1:] or sorted({path.parent.name for path in HERE.glob("*/run.py")} - APART)
    for name in names:
        print(f"== {name} ==")
        runpy.run_path(str(HERE / name / "run.py"), run_name="__main__")


if __name__ == "__main__":
    main()
