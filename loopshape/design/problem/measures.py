"""What a tuning is judged by at a point x: its objective's terms and the room each requirement leaves, with slopes.

Room is scaled to be of order one: 0 at the limit, negative beyond. Between lines ln L is linear in ln f.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from loopshape.core.kernels.loops import tuning_rows as kernel
from loopshape.core.units import Array, ComplexArray
from loopshape.data.control.controller import HALF_POWER
from loopshape.design.problem.disturbed import disturbed_rows
from loopshape.design.problem.evaluation import Evaluation
from loopshape.design.problem.peaks import norm_rows, peak_rows
from loopshape.design.problem.problem import Problem
from loopshape.design.problem.rows import DIP, DenseRows, Rows, Tighten, of_kernel, once, required, scaled


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
        """Mean ln 1/|S| over ln f up to the objective's frequency (points,); zero where it asks for no disturbance's.

        S is the error with the loop over the error without it, wherever a disturbance enters, so that operating points
        with large and small plants compare; |PS| would let the plant of largest gain speak for all. The mean is over
        ln f and not over lines: it then hardly depends on how the lines are spaced.
        """
        e, p = self.evaluation, self.evaluation.p
        return np.asarray(np.bincount(p.owner, weights=-e.ln_S * low_weights(p), minlength=p.points), dtype=float)

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
        aim = self.evaluation.p.requirements.objective
        value = aim.bandwidth * float(self.ln_bandwidth.min()) if aim.bandwidth else 0.0
        value += aim.disturbance * float(self.rejection.min()) if aim.disturbance else 0.0
        return value + (aim.weighted_norm * float(self.smallness.min()) if aim.weighted_norm else 0.0)


def measure(p: Problem, x: Array, tighten: Tighten) -> Measures:
    """Measures at x; `tighten` moves limits inward by these amounts, in their own unit (one, or one a point)."""
    e = Evaluation(p, x)
    crossing, bandwidths = crossing_rows(e, tighten)
    return Measures(e, (*peak_rows(e, tighten), *crossing, *disturbed_rows(e, tighten)), bandwidths, norm_rows(e))


def _slopes(e: Evaluation, rows: list[Rows]) -> Array:
    """Slopes (m, n) of rows by x."""
    i, j = (np.concatenate([getattr(r, name) for r in rows]) for name in ("i", "j"))
    a, b = (np.concatenate([getattr(r, name) for r in rows]) for name in ("a", "b"))
    return e.p.row_slopes(e.values, i, a, j, b)


def rejection_slopes(e: Evaluation) -> Array:
    """d rejection/d x (points, n): d ln 1/|S| = Re(T d ln C)."""
    p, weights = e.p, low_weights(e.p)
    k = np.flatnonzero(weights)
    T = e.L[k] / (1.0 + e.L[k])
    each = np.real(weights[k] * T * p.slopes(e.values, p.line[k]))
    return np.array([np.bincount(p.owner[k], weights=row, minlength=p.points) for row in each]).T


def low_weights(p: Problem) -> Array:
    """Weights of the flat lines up to `disturbance_below_hz`: trapezia in ln f, summing to one at each point."""
    below = p.requirements.objective.disturbance_below_hz
    weights = np.zeros(p.f.size)
    for a, b in zip(p.first[:-1] + p.below, p.first[1:], strict=True):
        low = p.ln_f[a:b][p.f[a:b] <= (below or 0.0)]
        span = np.diff(low)
        share = 0.5 * (np.append(span, 0.0) + np.append(0.0, span)) if low.size > 1 else np.ones(low.size)
        weights[a : a + low.size] = share / max(share.sum(), 1e-300)
    return weights


#: margins in the order of the kernel's rows
_MARGINS = ("phase_margin_deg", "delay_margin_s", "gain_margin_db", "gain_reduction_margin_db")


def crossing_rows(e: Evaluation, tighten: Tighten) -> tuple[list[Rows], Rows]:
    """Rows of every limit at a crossing that the requirements make, and those of ln bandwidth of each operating point.

    The bandwidth is the first 0 dB crossing; below the lowest line along the integrators' slope. Dips are rows of ln
    |L| at its local minima below it: without them a linearised step lets |L| fall through 1 there, the first crossing
    jumps, and the search gives up.
    """
    p, limits = e.p, e.p.limits
    *made, value, at, ab = kernel.crossing_rows(e.flat, *_levels(p, tighten), p.integrators)
    order = np.argsort(made[0][:, 0], kind="stable")  # by quantity, as they came
    bandwidths = Rows("", value, at[:, 0], at[:, 1], at[:, 2], ab[:, 0], at[:, 3], ab[:, 1])
    out = list(of_kernel((*_MARGINS, DIP), *(rows[order] for rows in made)))
    if "bandwidth_hz" in limits:
        out.append(_at_least(bandwidths, "bandwidth_hz", e, tighten))
    if "sensitivity_bandwidth_hz" in limits:
        out.append(_at_least(_sensitivity_bandwidth(e), "sensitivity_bandwidth_hz", e, tighten))
    if "complementary_bandwidth_hz" in limits:
        out.append(_at_least(_complementary_bandwidth(e, tighten), "complementary_bandwidth_hz", e, tighten))
    return out, bandwidths


@once
def _levels(p: Problem, tighten: Tighten) -> tuple[Array, Array, Array, Array, Array, float]:
    """Limits of the margins and of dips (points,) as the kernel counts them, and below what |L| dips are watched."""
    phase, delay, gain, reduction = (
        scaled(x, required(p, x, tighten)) if x in p.limits else np.full(p.points, np.nan) for x in _MARGINS
    )
    dip = np.broadcast_to(np.asarray(tighten.get(DIP, 0.0), dtype=float), p.points).copy()
    shallow = 3.0  # dips of |L| below the bandwidth are watched where |L| is below this
    return phase, delay, gain, reduction, dip, float(np.log(shallow)) if p.requirements.objective.bandwidth else 0.0


def _at_least(rows: Rows, name: str, e: Evaluation, tighten: Tighten) -> Rows:
    """Rows of ln f, one for each operating point, held against a limit."""
    room = rows.value - scaled(name, required(e.p, name, tighten))
    return Rows(name, room, rows.at, rows.point, rows.i, rows.a, rows.j, rows.b)


def _sensitivity_bandwidth(e: Evaluation) -> Rows:
    """Rows of ln f where |S| first rises through -3 dB: led below the first line; the last where it never does."""
    over, p = e.ln_S - HALF_POWER, e.p
    found = []
    for i, (a, b) in enumerate(zip(p.first[:-1], p.first[1:], strict=True)):
        beyond = over[a:b] >= 0.0
        if beyond[0]:
            order = max(int(p.integrators[i]), 1)
            found.append((a, 0.0, p.ln_f[a] - over[a] / order, -1.0 / order))
        elif beyond.any():
            found.append(_level_crossing(p.ln_f, over, int(a + np.argmax(beyond)) - 1))
        else:
            found.append((b - 1, 0.0, p.ln_f[b - 1], 0.0))
    return _of_levels(e, found, lambda L: -L / (1.0 + L))


def _complementary_bandwidth(e: Evaluation, tighten: Tighten) -> Rows:
    """Rows of ln f where |T| last falls through -3 dB; where it stays below, short of the wish by what it lacks."""
    over, p = e.ln_L + e.ln_S - HALF_POWER, e.p
    aim = np.log(required(p, "complementary_bandwidth_hz", tighten))
    found = []
    for i, (a, b) in enumerate(zip(p.first[:-1], p.first[1:], strict=True)):
        above = np.flatnonzero(over[a:b] >= 0.0)
        if not above.size:
            k = int(a + np.argmax(over[a:b]))
            found.append((k, 0.0, min(p.ln_f[k], aim[i]) + over[k], 1.0))
        elif a + above[-1] == b - 1:
            found.append((b - 1, 0.0, p.ln_f[b - 1], 0.0))
        else:
            found.append(_level_crossing(p.ln_f, over, int(a + above[-1])))
    return _of_levels(e, found, lambda L: 1.0 / (1.0 + L))


def _level_crossing(ln_f: Array, over: Array, k: int) -> tuple[int, float, float, float]:
    """Line, share, ln f and its slope by `over` where `over` passes zero between lines k and k + 1."""
    rise, span = over[k + 1] - over[k], ln_f[k + 1] - ln_f[k]
    return k, -over[k] / rise, ln_f[k] - over[k] / rise * span, -span / rise


def _of_levels(
    e: Evaluation, found: Sequence[tuple[int, float, float, float]], factor: Callable[[ComplexArray], ComplexArray]
) -> Rows:
    """Rows of ln f from lines, shares, values and slopes by ln of a magnitude, which moves with ln L by `factor`."""
    p = e.p
    at, share, value, slope = (np.array(column) for column in zip(*found, strict=True))
    after = np.minimum(at + 1, p.f.size - 1)
    a, b = (1.0 - share) * slope * factor(e.L[at]), share * slope * factor(e.L[after])
    return Rows("", value, at, p.owner[at], p.line[at], a, p.line[after], b)
