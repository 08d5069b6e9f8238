"""Screenshots of a report in a browser: the motor bench of the README's tour, at desktop and phone width."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import loopshape as ls

ROOT = Path(__file__).parents[2]
BENCH, FIGURES = ROOT / "examples" / "motor_bench", ROOT / "figures" / "report"
DATE = "2025-01-01 12:00:00+00:00"
FLAGS = (
    "--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run",
    "--disable-background-networking", "--disable-component-update", "--disable-sync", "--hide-scrollbars",
)  # fmt: skip
#: leaves the plots alone on the page and points at the peak of |S|
POINT = """<script>window.addEventListener("load", function () {
document.querySelectorAll("main > section:not(#plots), header, nav, footer").forEach(function (x) { x.remove(); });
var plot = document.querySelector('canvas[data-plot="S-db"]'), at = plot.getBoundingClientRect();
plot.dispatchEvent(new PointerEvent("pointermove",
  { clientX: at.left + 0.42 * at.width, clientY: at.top + 0.2 * at.height, bubbles: true }));
});</script></body>"""


def main() -> None:
    """Make the run, its report and the screenshots; says so where there is no browser."""
    browser = next((p for n in ("chromium", "chromium-browser", "google-chrome") if (p := shutil.which(n))), None)
    if browser is None:
        print("no chromium, chromium-browser or google-chrome on PATH: no screenshots")
        return
    FIGURES.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as folder:
        page = _report(Path(folder))
        pointed = page.with_name("pointed.html")
        text = re.sub(r'<meta http-equiv="Content-Security-Policy"[^>]*>', "", page.read_text(encoding="utf-8"))
        pointed.write_text(text.replace("</body>", POINT), encoding="utf-8")
        for name, source, width, height in (
            ("desktop", page, 1280, 1640),
            ("desktop_plots", pointed, 1280, 2180),
            ("phone", page, 390, 1640),
            ("phone_plots", pointed, 390, 2180),
        ):
            _shoot(browser, source, FIGURES / f"{name}.png", width, height, Path(folder) / "profile")
            print(f"figures/report/{name}.png")


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
    ls.report(run, path, controllers=controller, requirements=require, date=DATE)
    return path


def _shoot(browser: str, page: Path, out: Path, width: int, height: int, profile: Path) -> None:
    words = [browser, *FLAGS, f"--user-data-dir={profile}", f"--window-size={width},{height}", f"--screenshot={out}"]
    subprocess.run([*words, page.as_uri()], check=True, capture_output=True, timeout=120)


if __name__ == "__main__":
    main()
