"""Draws figures/shape/*.png, the pictures of the page of `shape`, in the system's Chromium: three widths, light and dark."""

import shutil
import sys
import tempfile
from pathlib import Path

import loopshape as ls

ROOT = Path(__file__).parents[1]
BENCH = ROOT / "examples" / "motor_bench"
SIZES = {1440: 940, 1024: 900, 390: 844}


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
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=shutil.which("chromium"))
        for width, height in SIZES.items():
            for scheme in ("light", "dark"):
                context = browser.new_context(
                    viewport={"width": width, "height": height}, color_scheme=scheme
                )
                one = context.new_page()
                one.goto(file.as_uri())
                one.wait_for_selector("#verdict-badge .badge:not(.none)")
                box = one.locator("#magnitude").bounding_box()
                one.mouse.move(box["x"] + 0.55 * box["width"], box["y"] + 30)
                one.wait_for_timeout(100)
                one.screenshot(path=out / f"{name}-{width}-{scheme}.png")
                context.close()
        browser.close()


if __name__ == "__main__":
    pictures = ROOT / "figures" / "shape"
    pictures.mkdir(exist_ok=True)
    with tempfile.TemporaryDirectory() as folder:
        files = [Path(x).resolve() for x in sys.argv[1:]] or [
            ls.shape(*walk(), Path(folder) / "bench.html")
        ]
        for file in files:
            draw(file, file.stem, pictures)
