"""How fast the page of `shape` follows a drag: 24 FRFs of 500 frequencies with 200 draws, in Chromium and Firefox.

python tests/speed/shape_latency.py [chromium] [firefox]
"""

import sys
import tempfile
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "helpers"))
sys.path.insert(0, str(Path(__file__).parents[1] / "helpers" / "loops"))
sys.path.insert(0, str(Path(__file__).parents[1] / "helpers" / "nouns"))
import page_in_browser
import shaped_cases
from firefox import firefox

import loopshape as ls
from loopshape.toolbox.pages.shape.shaping import page_of, shaped

POINTS, LINES, MOVES, FRAME_MS = 24, 500, 150, 16
EMPTY = "Object.values(loopshape.timings).forEach(x => x.length = 0)"
WANTED = ls.Requirements(
    "x", phase_margin_deg=30.0, sensitivity_peak_db=6.0, gain_margin_db=5.0, complementary_peak_db=6.0,
    bandwidth_hz=5.0, integrators=1, unstable_poles=0,
)  # fmt: skip


def plants() -> list[ls.FRF]:
    """A motion axis with a resonance that moves from operating point to operating point."""
    f = np.geomspace(0.5, 300.0, LINES)
    s, out = 2j * np.pi * f, []
    for k in range(POINTS):
        w = 2.0 * np.pi * (50.0 + k)
        P = 30.0 / (s * (1.0 + s / 60.0)) * w**2 / (s**2 + 0.1 * w * s + w**2)
        out.append(shaped_cases.noisy(f, P, 0.02, f"point {k + 1}", seed=k))
    return out


def in_chromium(file: Path) -> dict[str, list[float]]:
    """Milliseconds of each kind while a notch is dragged and after it, in the system's Chromium and Firefox."""
    with page_in_browser.browser() as browser:
        page = page_in_browser.opened(browser.new_context(viewport={"width": 1440, "height": 1000}), file)
        page_in_browser.until(page, "loopshape.state.detuned")
        page.evaluate(EMPTY)
        box, (x, y) = page.locator("#magnitude").bounding_box(), page.evaluate("loopshape.handles.N")
        places = path(box["x"] + x, box["y"] + y)
        page.mouse.move(*places[0])
        page.mouse.down()
        for place in places[1:]:
            page.mouse.move(*place)
            page.wait_for_timeout(FRAME_MS)
        page.mouse.up()
        page_in_browser.until(page, "loopshape.state.detuned")
        return dict(page.evaluate("loopshape.timings"))


def in_firefox(file: Path, folder: Path) -> dict[str, list[float]]:
    """The same in Firefox."""
    with firefox(folder) as browser:
        page = browser.opened(file)
        page.until("loopshape.state.detuned", 60.0)
        page.evaluate(EMPTY)
        x, y = page.evaluate(
            "(([x, y], box) => [box.x + x, box.y + y])(loopshape.handles.N, magnitude.getBoundingClientRect())"
        )
        page.follow(path(x, y), FRAME_MS)
        page.until("loopshape.state.detuned", 60.0)
        return dict(page.evaluate("loopshape.timings"))


def path(x: float, y: float) -> list[tuple[float, float]]:
    """Where the mouse goes."""
    return [(x + 60.0 * np.sin(0.1 * k), y + 5.0 * np.sin(0.07 * k)) for k in range(MOVES)]


def main() -> None:
    C = ls.controller(ls.gain(1.0), ls.notch(60.0, 0.1, 0.6), rate_hz=shaped_cases.RATE_HZ, loop="x")
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "shape.html"
        file.write_bytes(page_of([shaped(plants(), C, WANTED, ())], "speed"))
        print(
            f"{POINTS} FRFs of {LINES} frequencies, 200 draws; the file has {file.stat().st_size / 1e6:.2f} MB",
            flush=True,
        )
        for name in sys.argv[1:] or ("chromium", "firefox"):
            told(name, in_chromium(file) if name == "chromium" else in_firefox(file, Path(folder)))


def told(name: str, timings: dict[str, list[float]]) -> None:
    for what, values in timings.items():
        half, most, worst = np.quantile(values, (0.5, 0.95, 1.0))
        words = f"median {half:.0f} ms, 95 % within {most:.0f}, all within {worst:.0f} ({len(values)})"
        print(f"{name}, {what}: {words}", flush=True)


if __name__ == "__main__":
    main()
