"""What a tuning makes large."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from loopshape.core.errors import WrongUseError, refuse_unknown
from loopshape.core.gate import pass_fields

#: terms that may stand alone
TERMS = ("bandwidth", "disturbance", "weighted_norm")


@dataclass(frozen=True)
class Objective:
    """What `tune` makes large, over the operating points at their worst each: a weighted sum of its terms.

    `bandwidth` weighs ln of the first 0 dB crossing of L; `disturbance` the mean of ln 1/|S| over ln f on the lines up
    to `disturbance_below_hz`. |S| is the error with the loop over the error without it, wherever a disturbance
    enters, so that operating points compare. `weighted_norm` weighs ln of one over the norm that the requirements'
    `weights` ask for: that norm is made small. Refuses weights below zero, none above, and half a disturbance term.

    >>> import loopshape as ls
    >>> ls.Objective(bandwidth=1.0, disturbance=0.5, disturbance_below_hz=0.3).disturbance
    0.5
    """

    bandwidth: float = 1.0
    disturbance: float = 0.0
    disturbance_below_hz: float | None = None
    weighted_norm: float = 0.0

    def __post_init__(self) -> None:
        pass_fields(self)
        weights = (self.bandwidth, self.disturbance, self.weighted_norm)
        if not all(is_number(w) and 0.0 <= w < np.inf for w in weights) or max(weights) == 0.0:
            raise WrongUseError(
                "the weights of an objective must not be negative, and one must be positive", f"{weights}"
            )
        below = self.disturbance_below_hz
        if (self.disturbance > 0.0) != (below is not None):
            raise WrongUseError(
                "disturbance and disturbance_below_hz of an objective go together", "one of them", "give both or none"
            )
        if below is not None and not (is_number(below) and 0.0 < below < np.inf):
            raise WrongUseError("disturbance_below_hz must be positive and finite", f"{below!r}")

    @classmethod
    def from_toml(cls, given: Any, below_hz: Any = None) -> Objective:
        """Objective from its one term, "disturbance" with `disturbance_below_hz` beside it, or a table of weights."""
        if isinstance(given, Mapping):
            if unknown := set(given) - {f.name for f in fields(cls)}:
                raise WrongUseError(
                    f"an objective has the keys {', '.join(f.name for f in fields(cls))}",
                    ", ".join(sorted(unknown)),
                )
            below = {} if below_hz is None else {"disturbance_below_hz": below_hz}
            return cls(**({"bandwidth": 0.0} | below | dict(given)))
        refuse_unknown("an objective is a word, or a table of weights", given, TERMS, "use one of")
        return cls(**({"bandwidth": 0.0, "disturbance_below_hz": below_hz} | {given: 1.0}))


def is_number(value: Any) -> bool:
    """Whether a value is a number, true and false left out."""
    return isinstance(value, (int, float)) and not isinstance(value, bool)
