"""Rooms at crossings of L: phase and delay margin at 0 dB, gain margins on the real axis, and bandwidths.

Between lines ln L is linear in ln f.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from loopshape.core.kernels.loops import tuning_rows as kernel
from loopshape.core.units import Array, ComplexArray
from loopshape.design.problem.evaluation import Evaluation
from loopshape.design.problem.problem import Problem
from loopshape.design.problem.rows import DIP, Rows, Tighten, of_kernel, once, scaled, wished
from loopshape.loop.margin.controller_bandwidth import HALF_POWER

#: dips of |L| below the bandwidth are watched where |L| is below this
SHALLOW = 3.0
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
    bandwidths = Rows("", value, at[:, 0], at[:, 1], at[:, 2], ab[:, 0], at[:, 3], ab[:, 1])
    out = list(of_kernel((*_MARGINS, DIP), *made))
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
        scaled(x, wished(p, x, tighten)) if x in p.limits else np.full(p.points, np.nan) for x in _MARGINS
    )
    dip = np.broadcast_to(np.asarray(tighten.get(DIP, 0.0), dtype=float), p.points).copy()
    return phase, delay, gain, reduction, dip, float(np.log(SHALLOW)) if p.requirements.objective.bandwidth else 0.0


def _at_least(rows: Rows, name: str, e: Evaluation, tighten: Tighten) -> Rows:
    """Rows of ln f, one for each operating point, held against a limit."""
    room = rows.value - scaled(name, wished(e.p, name, tighten))
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
    wish = np.log(wished(p, "complementary_bandwidth_hz", tighten))
    found = []
    for i, (a, b) in enumerate(zip(p.first[:-1], p.first[1:], strict=True)):
        above = np.flatnonzero(over[a:b] >= 0.0)
        if not above.size:
            k = int(a + np.argmax(over[a:b]))
            found.append((k, 0.0, min(p.ln_f[k], wish[i]) + over[k], 1.0))
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
