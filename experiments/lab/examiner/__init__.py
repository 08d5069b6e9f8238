"""The examiner: arms with sealed effects, by models of its own. It knows run folders and no plant."""

from .exam import make_run
from .labels import (
    BLOCKS,
    EFFECTS,
    KINDS,
    OUTSIDE,
    RANGES,
    UNITS,
    canonical,
    draw_case,
    draw_magnitude,
    seal,
    verdict,
)

__all__ = [
    "BLOCKS",
    "EFFECTS",
    "KINDS",
    "OUTSIDE",
    "RANGES",
    "UNITS",
    "canonical",
    "draw_case",
    "draw_magnitude",
    "make_run",
    "seal",
    "verdict",
]
