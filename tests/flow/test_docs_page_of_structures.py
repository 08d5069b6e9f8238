"""The examples of the page of structures run one after the other, and each diagram that it shows is drawn."""

import runpy
from pathlib import Path

import loopshape as ls

ROOT = Path(__file__).parents[2]


def test_the_examples_run_and_the_pictures_are_theirs() -> None:
    left = runpy.run_path(str(ROOT / "docs" / "pictures.py"))["structures"]()
    shown = {name for name, one in left.items() if isinstance(one, ls.Diagram)} - {"D", "with_it"}
    page = (ROOT / "docs" / "structures.md").read_text()
    assert {path.stem for path in (ROOT / "figures" / "diagrams").glob("*.png")} == shown
    assert all(f"figures/diagrams/{name}.png" in page for name in shown)
