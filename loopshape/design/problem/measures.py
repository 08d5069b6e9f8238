"""What a tuning is judged by at a point x: its objective's terms and the room each requirement leaves, with slopes.

Room is scaled to be of order one: 0 at the limit, negative beyond. Between lines ln L is linear in ln f.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from loopshape.core.units import Array
from loopshape.design.problem.crossings import crossing_rows
from loopshape.design.problem.evaluation import Evaluation
from loopshape.design.problem.norms import norm_rows
from loopshape.design.problem.peaks import peak_rows
from loopshape.design.problem.problem import Problem
from loopshape.design.problem.rms import rms_rows
from loopshape.design.problem.rows import DenseRows, Rows, Tighten


@dataclass(frozen=True, eq=False)
class Measures:
    """ln bandwidth (points,) and rooms (m,), each with what and where; slopes and stability when asked for.

    `what` (m,) are names of `Margins`' fields, or "stability" for what keeps the count of encirclements sure; `at`
    (m,) the flat line nearest to each, or a column above them; `point` (m,) its operating point, -1 for C alone.
    `norms` are rows of ln of one over the norm of the weighted loop at its peaks, where the objective has one.
    """

    evaluation: Evaluation
    rows: tuple[Rows | DenseRows, ...]
    bandwidths: Rows
    norms: tuple[Rows, ...] = ()

    @property
    def ln_bandwidth(self) -> Array:
        """ln of the first 0 dB crossing in Hz (points,)."""
        return self.bandwidths.value

    @cached_property
    def bandwidth_slopes(self) -> Array:
        """d ln bandwidth/d x (points, n)."""
        return self._slopes[: self.bandwidths.value.size]

    @cached_property
    def rejection(self) -> Array:
        """Mean ln 1/|S| over the objective's low lines (points,); zero where it asks for none."""
        return rejection(self.evaluation)

    @cached_property
    def rejection_slopes(self) -> Array:
        """d rejection/d x (points, n)."""
        return rejection_slopes(self.evaluation)

    @cached_property
    def smallness(self) -> Array:
        """ln of one over the norm of the weighted loop at its peaks (k,); none where the objective has no norm."""
        return np.concatenate([np.zeros(0), *(r.value for r in self.norms)])

    @property
    def smallness_slopes(self) -> Array:
        """d smallness/d x (k, n)."""
        return self._slopes[self.bandwidths.value.size :][: self.smallness.size]

    @cached_property
    def room(self) -> Array:
        """Room of each row (m,)."""
        return np.concatenate([np.zeros(0), *(r.value for r in self.rows)])

    @cached_property
    def room_slopes(self) -> Array:
        """d room/d x (m, n)."""
        return self._slopes[self.bandwidths.value.size + self.smallness.size :]

    @cached_property
    def _slopes(self) -> Array:
        """Slopes of the bandwidths, of the norm and of all rows, from C's on the columns that they name."""
        dense = [row.slopes() for row in self.rows if isinstance(row, DenseRows)]  # the last of the rows
        rows = [row for row in self.rows if isinstance(row, Rows)]
        return np.concatenate([_slopes(self.evaluation, [self.bandwidths, *self.norms, *rows]), *dense])

    @cached_property
    def what(self) -> list[str]:
        """Quantity of each row."""
        return [r.what for r in self.rows for _ in range(r.value.size)]

    @cached_property
    def at(self) -> np.ndarray:
        """Flat line of each row."""
        return np.concatenate([np.zeros(0, dtype=int), *(r.at for r in self.rows)])

    @cached_property
    def point(self) -> np.ndarray:
        """Operating point of each row."""
        return np.concatenate([np.zeros(0, dtype=int), *(r.point for r in self.rows)])

    @property
    def stable(self) -> bool:
        """Whether the bare Nyquist count is zero at every operating point."""
        return self.evaluation.stable

    @property
    def worst(self) -> float:
        """Least room, +inf where nothing is required."""
        return float(self.room.min()) if self.room.size else np.inf

    def objective(self) -> float:
        """The objective's weighted sum, each term at its worst operating point."""
        wish = self.evaluation.p.requirements.objective
        value = wish.bandwidth * float(self.ln_bandwidth.min()) if wish.bandwidth else 0.0
        value += wish.disturbance * float(self.rejection.min()) if wish.disturbance else 0.0
        return value + (wish.weighted_norm * float(self.smallness.min()) if wish.weighted_norm else 0.0)


def measure(p: Problem, x: Array, tighten: Tighten) -> Measures:
    """Measures at x; `tighten` moves limits inward by these amounts, in their own unit (one, or one a point)."""
    e = Evaluation(p, x)
    crossing, bandwidths = crossing_rows(e, tighten)
    return Measures(e, (*peak_rows(e, tighten), *crossing, *rms_rows(e, tighten)), bandwidths, norm_rows(e))


def _slopes(e: Evaluation, rows: list[Rows]) -> Array:
    """Slopes (m, n) of rows by x."""
    i, j = (np.concatenate([getattr(r, name) for r in rows]) for name in ("i", "j"))
    a, b = (np.concatenate([getattr(r, name) for r in rows]) for name in ("a", "b"))
    return e.p.row_slopes(e.values, i, a, j, b)


def rejection(e: Evaluation) -> Array:
    """Mean ln 1/|S| over ln f up to a frequency, (points,); zero where the objective asks for no disturbance's.

    S is the error with the loop over the error without it, wherever a disturbance enters, so that operating points with
    large and small plants compare; |PS| would let the plant of largest gain speak for all. The mean is over ln f and
    not over lines: it then hardly depends on how the lines are spaced.
    """
    if e.p.requirements.objective.disturbance_below_hz is None:
        return np.zeros(e.p.points)
    return np.asarray(np.bincount(e.p.owner, weights=-e.ln_S * low_weights(e.p), minlength=e.p.points), dtype=float)


def rejection_slopes(e: Evaluation) -> Array:
    """d rejection/d x (points, n): d ln 1/|S| = Re(T d ln C)."""
    p = e.p
    if p.requirements.objective.disturbance_below_hz is None:
        return np.zeros((p.points, e.x.size))
    weights = low_weights(p)
    k = np.flatnonzero(weights)
    T = e.L[k] / (1.0 + e.L[k])
    each = np.real(weights[k] * T * p.slopes(e.values, p.line[k]))
    return np.array([np.bincount(p.owner[k], weights=row, minlength=p.points) for row in each]).T


def low_weights(p: Problem) -> Array:
    """Weights of the flat lines up to `disturbance_below_hz`: trapezia in ln f, summing to one at each point."""
    below = p.requirements.objective.disturbance_below_hz
    weights = np.zeros(p.f.size)
    for a, b in zip(p.first[:-1] + p.led, p.first[1:], strict=True):
        low = p.ln_f[a:b][p.f[a:b] <= (below or 0.0)]
        span = np.diff(low)
        share = 0.5 * (np.append(span, 0.0) + np.append(0.0, span)) if low.size > 1 else np.ones(low.size)
        weights[a : a + low.size] = share / max(share.sum(), 1e-300)
    return weights
