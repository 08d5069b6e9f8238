"""A toolbox of one's own: a reader of an oscilloscope's files, a block, and a command."""

from pathlib import Path
from typing import Annotated

import numpy as np

from loopshape.core.toolboxes import Command, Toolbox

TOOLBOX = Toolbox(
    "scope",
    "Recordings of an oscilloscope",
    commands=(Command("Measure and import", "scope", "loopshape_scope:scope", "loopshape scope trace.scope"),),
    names={"soft_notch": "loopshape_scope"},
    readers={".scope": "loopshape_scope:read_scope"},
)


def read_scope(path):
    """Arrays by name: a line of names, then a line of numbers a sample."""
    names, *rows = Path(path).read_text().splitlines()
    table = np.array([[float(cell) for cell in row.split()] for row in rows])
    return dict(zip(names.split(), table.T, strict=True))


def soft_notch(f_hz: float):
    """A notch 20 dB deep with a damping of 0.5 in its poles.

    >>> soft_notch(50.0).kind
    'notch'
    """
    import loopshape as ls

    return ls.notch(f_hz, 0.05, 0.5)


def scope(file: Annotated[Path, "A file of the oscilloscope."]) -> None:
    """Show the rms of each channel of a file of the oscilloscope."""
    for name, values in read_scope(file).items():
        print(f"{name}: {np.std(values):.4g}")
