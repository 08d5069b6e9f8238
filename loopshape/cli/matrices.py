"""A plant's matrix in the commands: which recordings span it, its table, its pictures."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from loopshape.cli.output import Output, point
from loopshape.cli.pictures import figures_of

if TYPE_CHECKING:
    from loopshape.data.frf import FRF

_KEYS = (
    "recordings",
    "loops",
    "outputs",
    "operating_point",
    "trusted_from_hz",
    "trusted_to_hz",
    "lines",
    "std_percent",
)


def matrix_table(frfs: Sequence[FRF], output: Output) -> list[dict[str, Any]]:
    """Print the table of matrices, a row each; gives the rows for JSON."""
    import numpy as np

    if not frfs:
        return []
    rows = []
    for one in frfs:
        lines = one.select(one.trusted) if one.trusted.any() else one
        std = lines.modulus_std
        low, high = one.trusted_band_hz
        where = point(one.operating_point, one.parameters)
        count = int(one.trusted.sum())
        rows.append([one.recording, one.loop, len(one.outputs), where, low, high, count, 100.0 * float(np.median(std))])
    columns = ["recordings", "loops", "outputs", "operating point", "valid from [Hz]", "to [Hz]", "lines"]
    output.table("The plant's matrices", [*columns, "median std of elements [%]"], rows)
    return [dict(zip(_KEYS, row, strict=True)) | {"method": f.method} for row, f in zip(rows, frfs, strict=True)]


def draw_matrices(folder: Path, frfs: Sequence[FRF], output: Output) -> list[str]:
    """A page for each matrix."""
    from loopshape.cli.pictures import save
    from loopshape.view.matrix import matrix_page

    drawn = []
    for k, one in enumerate(frfs):
        tail = f"_{k + 1:02d}" if len(frfs) > 1 else ""
        drawn.append(str(save(matrix_page(one), figures_of(folder) / f"matrix_{one.loop}{tail}.png")))
    return drawn
