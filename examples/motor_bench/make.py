"""Makes controller.toml and verdict.json, its baseline, as the commands of the README's tour do.

    python examples/motor_bench/make.py

Run it after a change that is meant to move them: tests and the workflow in examples/ci hold the project to both.
"""

from __future__ import annotations

import sys
from pathlib import Path

import loopshape as ls

HERE = Path(__file__).parent


def main() -> int:
    """Import, estimate, fit, tune, check; 1 where the controller does not hold, and then nothing is kept of it."""
    P = ls.frf(ls.formats.read_table(HERE / "multisine_type_a.parquet", HERE / "map.toml"))
    fits = [ls.fit(P, "rational", numerator=2, denominator=4, delay=True, weighting="relative")]
    (R,) = ls.read_requirements(HERE / "requirements.toml")
    tuning = ls.tune(P, R, fits=fits)
    if not tuning.feasible:
        return 1
    verdict = ls.check(P, tuning, R, fits=fits)
    print(verdict)
    if not verdict.passed:
        return 1
    ls.write(tuning, HERE / "controller.toml")
    ls.write(verdict, HERE / "verdict.json")
    return 0


if __name__ == "__main__":
    sys.exit(main())
