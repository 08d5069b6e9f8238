"""Makes controller.toml and verdict.json, its baseline, by the commands of the README's tour.

    python examples/motor_bench/make.py

Run it after a change that is meant to move them: tests and the workflow in examples/ci hold the project to both.
"""

from __future__ import annotations

import sys
from pathlib import Path
from tempfile import TemporaryDirectory

from loopshape.cli.check import Reports, check_run
from loopshape.cli.fit import fit_run
from loopshape.cli.frf import estimate_and_report
from loopshape.cli.import_file import import_run
from loopshape.cli.output import Output
from loopshape.cli.tune import tune_run

HERE = Path(__file__).parent


def main() -> int:
    """Import, estimate, fit, tune, check; 1 where the controller does not hold, and then nothing is kept of it."""
    output, quiet = Output(), Output(quiet=True)
    require, controller = HERE / "requirements.toml", HERE / "controller.toml"
    with TemporaryDirectory() as folder:
        run = Path(folder)
        import_run(HERE / "multisine_type_a.parquet", HERE / "map.toml", run, quiet)
        estimate_and_report(run, quiet, figures=False)
        fit_run(run, quiet, structure="rational", numerator=2, denominator=4, delay=True, weighting="relative")
        made = run / "controller.toml"
        if not tune_run(run, require, made, output):
            return 1
        passed, _ = check_run(run, made, require, output, reports=Reports(save_verdict=run / "v.json"), figures=False)
        if passed:
            controller.write_bytes(made.read_bytes())
            (HERE / "verdict.json").write_bytes((run / "v.json").read_bytes())
    return 0 if passed else 1


if __name__ == "__main__":
    sys.exit(main())
