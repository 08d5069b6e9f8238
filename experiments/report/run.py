"""A picture of a report in a browser: the motor bench of the README's tour."""

from __future__ import annotations

import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT / "experiments" / "lab"))

from screenshots import WIDTH_PX, chromium, shoot, watched  # noqa: E402

import loopshape as ls  # noqa: E402

BENCH, FIGURES = ROOT / "examples" / "motor_bench", ROOT / "figures" / "report"
DATE = "2025-01-01 12:00:00+00:00"
HEIGHT_PX = 1050


def main() -> None:
    """Make the run, its report and a picture of its first screen."""
    FIGURES.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as folder, chromium() as browser:
        page = watched(browser.new_page(viewport={"width": WIDTH_PX, "height": HEIGHT_PX}, color_scheme="light"))
        page.goto(_report(Path(folder)).as_uri())
        page.wait_for_timeout(500)
        shoot(page, FIGURES / "report.png")
        print("figures/report/report.png")


def _report(folder: Path) -> Path:
    """The tour's commands, and the report of its run."""
    run, controller, require = folder / "bench", folder / "controller.toml", BENCH / "requirements.toml"
    rational = [
        "--structure",
        "rational",
        "--numerator",
        "2",
        "--denominator",
        "4",
        "--delay",
        "--weighting",
        "relative",
    ]
    for words in (
        ["import", BENCH / "multisine_type_a.parquet", "--map", BENCH / "map.toml", "--out", run],
        ["frf", run],
        ["fit", run, *rational],
        ["figures", run],
        ["tune", run, "--require", require, "--out", controller],
        ["check", run, controller, "--require", require],
    ):
        command = [sys.executable, "-m", "loopshape.cli.main", *map(str, words), "--quiet"]
        done = subprocess.run(command, check=False, cwd=ROOT)
        if done.returncode not in (0, 1):
            raise SystemExit(f"{words[0]} ended with {done.returncode}")
    path = folder / "report.html"
    ls.report(run, path, controllers=controller, requirements=require, date=DATE, author="the README's tour")
    return path


if __name__ == "__main__":
    main()
