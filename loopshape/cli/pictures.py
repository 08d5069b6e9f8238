"""Figures to files."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def save(figure: Figure, path: Path) -> Path:
    """Write a figure as PNG, whole or not at all; gives the path."""
    from loopshape.draw.style import png
    from loopshape.store.files import write_bytes_whole

    write_bytes_whole(path, png(figure))
    return path
