"""Draws figures/shape/*.png, the pictures of the page of `shape`, in the system's Chromium: light and dark."""

import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT / "experiments" / "lab"))

from screenshots import WIDTH_PX, chromium, shoot, watched  # noqa: E402

import loopshape as ls  # noqa: E402

BENCH = ROOT / "examples" / "motor_bench"
HEIGHT_PX = 980


def walk() -> tuple[ls.FRF, ls.Controller, ls.Requirements]:
    """The motor bench at the end of the walk in shape.md."""
    P = ls.frf(ls.formats.read_table(BENCH / "multisine_type_a.parquet", BENCH / "map.toml"))
    (R,) = ls.read_requirements(BENCH / "requirements.toml")
    blocks = (
        ls.gain(12.0),
        ls.lead_lag(1.0, 50.0),
        ls.notch(77.5, 0.1, 0.6),
        ls.low_pass(400.0, 1.0),
    )
    return P, ls.controller(*blocks, rate_hz=P.rate_hz, loop=P.loop), R


def draw(file: Path, name: str, out: Path) -> None:
    with chromium() as browser:
        for scheme in ("light", "dark"):
            size = {"width": WIDTH_PX, "height": HEIGHT_PX}
            one = watched(browser.new_page(viewport=size, color_scheme=scheme))
            one.goto(file.as_uri())
            one.wait_for_selector("#verdict-badge .badge:not(.none)")
            box = one.locator("#magnitude").bounding_box()
            one.mouse.move(box["x"] + 0.55 * box["width"], box["y"] + 30)
            one.wait_for_timeout(100)
            shoot(one, out / f"{name}-{scheme}.png")
            one.close()


if __name__ == "__main__":
    pictures = ROOT / "figures" / "shape"
    pictures.mkdir(exist_ok=True)
    with tempfile.TemporaryDirectory() as folder:
        files = [Path(x).resolve() for x in sys.argv[1:]] or [
            ls.shape(*walk(), Path(folder) / "bench.html")
        ]
        for file in files:
            draw(file, file.stem, pictures)
