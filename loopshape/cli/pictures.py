"""Figures to files."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def figures_of(run: Path) -> Path:
    """The folder of a run's figures; refuses a link that leads out of the run."""
    from loopshape.io.files import inside
    from loopshape.io.run.run_inputs import FIGURES

    return inside(run, FIGURES, "the folder of a run's figures")


def save(figure: Figure, path: Path) -> Path:
    """Write a figure as PNG, whole or not at all; gives the path."""
    from loopshape.io.files import write_bytes_whole
    from loopshape.view.style import png

    write_bytes_whole(path, png(figure))
    return path
