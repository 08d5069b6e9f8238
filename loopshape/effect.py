"""An effect: something that a nominal model leaves out, as parameters moved away from neutral."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field


@dataclass(frozen=True)
class Effect:
    """A name, the block of the plant it lives in, and the values to which it moves parameters.

    Neutral values are the plant's nominal ones and are the identity bit for bit, so "with" and "without"
    are one code path; several effects compose by moving several parameters.
    """

    name: str
    block: str
    moves: Mapping[str, float] = field(default_factory=dict)
    source: str = ""
