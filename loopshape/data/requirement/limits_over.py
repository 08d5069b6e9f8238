"""Limits over frequency (masks on |S|, |T|, |L|, |CS|, |PS|) and over operating points."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from loopshape.core.errors import WrongUseError, refuse_unknown
from loopshape.core.gate import pass_fields
from loopshape.core.units import Array, from_db

#: how far the worst frequency lies beyond all masks of a kind, in the order of the kernel's columns
MASKED = (
    "sensitivity_mask_db", "complementary_mask_db", "control_mask_db", "process_mask_db", "loop_mask_db",
    "loop_floor_db",
)  # fmt: skip
_QUANTITY = dict(zip(("S", "T", "CS", "PS", "L"), MASKED, strict=False))
_SENSES = ("at_most", "at_least")


@dataclass(frozen=True)
class Mask:
    """A limit on |response| over frequency: in dB, straight over ln f between `points` (Hz, dB), none outside them.

    `response` is S, T, L, CS or PS; `sense` is "at_most", of L "at_least" too. Refuses another response, fewer than two
    points, frequencies that do not rise, and numbers that are not finite.

    >>> import loopshape as ls
    >>> print(ls.Mask("S", ((0.1, -40.0), (10.0, 0.0))).level_db([0.01, 1.0]))
    [ inf -20.]
    """

    response: str
    points: tuple[tuple[float, float], ...]
    sense: str = "at_most"

    def __post_init__(self) -> None:
        pass_fields(self)
        refuse_unknown("a mask limits S, T, L, CS or PS", self.response, _QUANTITY)
        refuse_unknown("the sense of a mask is at_most or at_least", self.sense, _SENSES)
        if self.sense == "at_least" and self.response != "L":
            raise WrongUseError(
                f"a mask on |{self.response}| is an upper limit", "at_least",
                "give the floor as a mask on L with sense at_least",
            )  # fmt: skip
        self._check_points()

    def _check_points(self) -> None:
        of = f"the points of a mask on |{self.response}|"
        pairs = [isinstance(one, (list, tuple)) and len(one) == 2 and all(map(_is_finite, one)) for one in self.points]
        if len(pairs) < 2 or not all(pairs):
            raise WrongUseError(f"{of} are two pairs (Hz, dB) at least", f"{self.points!r}")
        hz = [one[0] for one in self.points]
        if hz[0] <= 0.0 or not all(a < b for a, b in pairwise(hz)):
            raise WrongUseError(f"{of} must have positive, strictly increasing frequencies", f"{hz!r}")
        object.__setattr__(self, "points", tuple((float(f), float(level)) for f, level in self.points))

    @property
    def quantity(self) -> str:
        """Name of the limit that this mask belongs to."""
        return "loop_floor_db" if self.sense == "at_least" else _QUANTITY[self.response]

    @property
    def band_hz(self) -> tuple[float, float]:
        """First and last frequency."""
        return self.points[0][0], self.points[-1][0]

    def level_db(self, f: ArrayLike) -> Array:
        """The limit in dB at frequencies (nf,) in Hz; outside its points no limit, inf (of a floor -inf)."""
        hz, level = np.array(self.points).T
        none = -np.inf if self.sense == "at_least" else np.inf
        return np.interp(np.log(np.asarray(f, dtype=float)), np.log(hz), level, none, none)

    def to_table(self) -> dict[str, Any]:
        """The table of this mask in a file."""
        made = {"response": self.response, "points": [list(pair) for pair in self.points]}
        return made if self.sense == "at_most" else made | {"sense": self.sense}


def weights(masks: Sequence[Mask], f: Array) -> Array:
    """What squared magnitudes are multiplied with to be 1 at the sharpest limit, a row for each of `MASKED` (6, nf).

    0 where nothing is limited; the row of the floor is for 1/|L|².
    """
    out = np.zeros((len(MASKED), f.size))
    for mask in masks:
        level, row = mask.level_db(f), MASKED.index(mask.quantity)
        sign = 1.0 if mask.sense == "at_least" else -1.0
        out[row] = np.maximum(out[row], from_db(sign * level) ** 2)
    return out


@dataclass(frozen=True)
class AtPoints:
    """Limits that take the place of a loop's others at some operating points.

    `where` gives for coordinates of the operating point the range (low, high) in which these hold, ends included;
    `limits` are by the names of `Requirements`; a mask replaces those of its kind.

    >>> import loopshape as ls
    >>> heavy = ls.AtPoints({"load_kg": (2.0, 5.0)}, {"phase_margin_deg": 30.0})
    >>> ls.Requirements(phase_margin_deg=45.0, at=(heavy,)).of({"load_kg": 3.0}).phase_margin_deg
    30.0
    """

    where: Mapping[str, tuple[float, float]]
    limits: Mapping[str, float] = field(default_factory=dict)
    masks: tuple[Mask, ...] = ()

    def __post_init__(self) -> None:
        pass_fields(self)
        if not self.where or not (self.limits or self.masks):
            raise WrongUseError(
                "limits at operating points need where and a limit", f"{dict(self.where)}, {dict(self.limits)}"
            )
        for name, ends in self.where.items():
            if not (isinstance(ends, (list, tuple)) and len(ends) == 2 and all(map(_is_finite, ends))):
                raise WrongUseError(f"where {name} of an operating point is a range", f"{ends!r}", "give [low, high]")
            if ends[0] > ends[1]:
                raise WrongUseError(f"where {name} of an operating point must rise", f"{ends!r}")

    def holds_at(self, point: Mapping[str, float]) -> bool:
        """Whether an operating point lies in all ranges; one that lacks a coordinate does not."""
        return all(name in point and low <= point[name] <= high for name, (low, high) in self.where.items())

    @classmethod
    def unfolded(cls, table: Mapping[str, Any]) -> dict[str, Any]:
        """{ where = { x_m = [0.0, 0.5] }, phase_margin_deg = 40.0 }, perhaps with masks: the other keys are limits."""
        given = dict(table)
        made = {key: given.pop(key) for key in ("where", "masks") if key in given}
        if isinstance(where := made.get("where", {}), Mapping):
            made["where"] = {key: [one, one] if _is_finite(one) else one for key, one in where.items()}
        return made | {"limits": given}

    def to_table(self) -> dict[str, Any]:
        """The table of these limits in a file, as `unfolded` reads it."""
        made = {"where": {name: list(ends) for name, ends in self.where.items()}, **self.limits}
        return made | ({"masks": [mask.to_table() for mask in self.masks]} if self.masks else {})


def _is_finite(value: Any) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool) and bool(np.isfinite(value))
