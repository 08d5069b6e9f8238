"""The working points of the bench, measured one by one, and how often intervals hold the truth."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from h1_h2 import TwoEstimates
from muscle_law import Muscle, damping, printed, slope_closed
from muscle_records import Bench, SpringDamper, measure, spring_damper

from loopshape.core.units import Array
from loopshape.toolbox.arm.source import value

Point = tuple[float, float]
BAND = 1.96  # a 95 % interval in standard deviations


@dataclass(frozen=True, eq=False)
class Measured:
    """One working point: what was measured, what the muscle's slope truly was, and the model's k (N/m)."""

    law: str
    muscle: Muscle
    p_bar: float
    h_m: float
    both: TwoEstimates
    found: SpringDamper
    slope: float
    k: float

    @property
    def holds(self) -> tuple[bool, bool]:
        """Whether the intervals of k_w and d_w hold the truth."""
        k_off, d_off = abs(self.found.k - self.slope), abs(self.found.d - damping(self.p_bar))
        return k_off < BAND * self.found.k_std, d_off < BAND * self.found.d_std


def grid(words: Mapping[str, Any]) -> tuple[list[Point], list[Point]]:
    """Measured and left-out points (p in bar, h in m)."""
    left = [(float(p), 1e-3 * h) for h, p in words["left_out_mm_bar"]]
    every = [(float(p), 1e-3 * h) for h in words["lengths_mm"] for p in words["pressures_bar"]]
    return [q for q in every if q not in left], left


def columns(points: Sequence[Point]) -> tuple[Array, Array]:
    """Pressures and lengths (n,)."""
    return np.array([p for p, _ in points]), np.array([h for _, h in points])


def sweep(
    bench: Bench, law: str, points: Sequence[Point], first_seed: int, one: Muscle | None = None
) -> list[Measured]:
    """All points of one muscle under one law; each record has its own seed."""
    one, out = one or Muscle(), []
    for n, (p, h) in enumerate(points):
        both = measure(bench, law, p, h, first_seed + 100 * n, one)
        k = one.factor * float(printed().stiffness(np.array(p), np.array(h)))
        out.append(Measured(law, one, p, h, both, spring_damper(both.h1), slope_closed(law, p, h, one), k))
    return out


def muscles(words: Mapping[str, Any]) -> list[Muscle]:
    """The five muscles: muscle 4 is the model's, the others lie within the published spread about it."""
    stiff, longer = 0.01 * value("muscles.stiffness_spread"), 1e-3 * value("muscles.nominal_length_spread")
    rows = zip(words["names"], words["stiffness_share"], words["length_share"], strict=True)
    return [Muscle(name, 1.0 + a * stiff, b * longer) for name, a, b in rows]


def coverage(rows: Sequence[Measured]) -> tuple[float, float]:
    """Share of the intervals of k_w and d_w that hold the truth."""
    held = np.mean([row.holds for row in rows], axis=0)
    return float(held[0]), float(held[1])
