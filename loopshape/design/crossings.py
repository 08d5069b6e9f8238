"""Rooms at crossings of L: phase and delay margin at 0 dB, gain margins on the real axis, and bandwidths.

Between lines ln L is linear in ln f.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from loopshape.core.kernels import flat_loops as kernel
from loopshape.core.units import TWO_PI, Array, ComplexArray
from loopshape.design.evaluation import Evaluation
from loopshape.design.rows import DIP, Rows, Tighten, between_lines, on_lines, scaled, wished
from loopshape.loop.controller_bandwidth import HALF_POWER

#: dips of |L| below the bandwidth are watched where |L| is below this
SHALLOW = 3.0


@dataclass(frozen=True, eq=False)
class Crossings:
    """0 dB crossings (m,) of L after flat lines `at`, at a `share` of the way: ln f and its slope factor `move`."""

    at: np.ndarray
    share: Array
    turn: Array
    ln_f: Array
    move: Array
    span: Array


def unit_crossings(e: Evaluation) -> Crossings:
    """All 0 dB crossings of L, in the order of the flat lines."""
    p, size = e.p, e.ln_L
    at = np.flatnonzero((size[:-1] * size[1:] < 0.0) & p.inside)
    rise = size[at + 1] - size[at]
    share, span = -size[at] / rise, p.ln_f[at + 1] - p.ln_f[at]
    turn = np.angle(e.L[at + 1] / e.L[at])
    return Crossings(at, share, turn, p.ln_f[at] + share * span, -span / rise, span)


def crossing_rows(e: Evaluation, tighten: Tighten, c: Crossings) -> Iterator[Rows]:
    """Rows of every limit at a crossing that the requirements make; c are all 0 dB crossings."""
    limits = e.p.limits
    if "phase_margin_deg" in limits or "delay_margin_s" in limits:
        yield from _phase_rows(e, tighten, c)
    if "gain_margin_db" in limits or "gain_reduction_margin_db" in limits:
        yield from _gain_rows(e, tighten)
    if e.p.requirements.objective.bandwidth:
        yield _dips(e, tighten)
    if "bandwidth_hz" in limits:
        yield _at_least(bandwidth(e, c), "bandwidth_hz", e, tighten)
    if "sensitivity_bandwidth_hz" in limits:
        yield _at_least(_sensitivity_bandwidth(e), "sensitivity_bandwidth_hz", e, tighten)
    if "complementary_bandwidth_hz" in limits:
        yield _at_least(_complementary_bandwidth(e, tighten), "complementary_bandwidth_hz", e, tighten)


def _at_least(rows: Rows, name: str, e: Evaluation, tighten: Tighten) -> Rows:
    """Rows of ln f, one for each operating point, held against a limit."""
    room = rows.value - scaled(name, wished(e.p, name, tighten))
    return Rows(name, room, rows.at, rows.point, rows.i, rows.a, rows.j, rows.b)


def _phase_rows(e: Evaluation, tighten: Tighten, c: Crossings) -> Iterator[Rows]:
    p, owner = e.p, e.p.owner[c.at]
    ahead = (np.angle(e.L[c.at]) + c.share * c.turn + np.pi) % TWO_PI  # rotation by lag onto -1
    factor = -1j + c.turn / c.span * c.move  # d phase = Re(factor d ln C)
    if "phase_margin_deg" in p.limits:
        limit = scaled("phase_margin_deg", wished(p, "phase_margin_deg", tighten))[owner]
        lag = ahead <= np.pi
        either = np.where(lag, ahead, TWO_PI - ahead)
        yield between_lines("phase_margin_deg", p, either - limit, c.at, c.share, np.where(lag, 1.0, -1.0) * factor)
    if "delay_margin_s" in p.limits:
        limit = scaled("delay_margin_s", wished(p, "delay_margin_s", tighten))[owner]
        ahead = np.maximum(ahead, 1e-12)
        ln_delay = np.log(ahead / TWO_PI) - c.ln_f
        yield between_lines("delay_margin_s", p, ln_delay - limit, c.at, c.share, factor / ahead - c.move)


def _gain_rows(e: Evaluation, tighten: Tighten) -> Iterator[Rows]:
    """Rows where L passes the negative real axis, and at the last lines: beyond them L may pass it, no larger."""
    p, at = e.p, e.axis
    at = at[(e.L.real[at] < 0.0) | (e.L.real[at + 1] < 0.0)]
    to_axis, turn = np.angle(-e.L[at]), np.angle(e.L[at + 1] / e.L[at])
    with np.errstate(divide="ignore", invalid="ignore"):
        share = -to_axis / turn
    good = (share >= 0.0) & (share <= 1.0) & (np.abs(to_axis) < 0.75 * np.pi)
    at, share, turn = at[good], share[good], turn[good]
    rise = e.ln_L[at + 1] - e.ln_L[at]
    value, factor = e.ln_L[at] + share * rise, 1.0 + 1j * rise / turn
    inside = value <= 0.0
    for name, mine, sign in (("gain_margin_db", inside, -1.0), ("gain_reduction_margin_db", ~inside, 1.0)):
        if name not in p.limits:
            continue
        limit = scaled(name, wished(p, name, tighten))
        room = sign * value[mine] - limit[p.owner[at[mine]]]
        yield between_lines(name, p, room, at[mine], share[mine], sign * factor[mine])
        if name == "gain_margin_db":
            yield on_lines(name, p, -e.ln_L[e.last] - limit, e.last, np.full(p.points, -1.0))


def bandwidth(e: Evaluation, c: Crossings) -> Rows:
    """Rows of ln f of the first 0 dB crossing; below the lowest line along the integrators' slope."""
    p = e.p
    start, first = p.first[:-1], np.searchsorted(c.at, p.first[:-1])
    seen = (e.ln_L[start] >= 0.0) & (first < np.searchsorted(c.at, p.first[1:]))
    order = np.maximum(p.integrators, 1)
    value, move = p.ln_f[start] + e.ln_L[start] / order, 1.0 / order
    at, share, k = start.copy(), np.zeros(p.points), first[seen]
    value[seen], move[seen], at[seen], share[seen] = c.ln_f[k], c.move[k], c.at[k], c.share[k]
    return between_lines("", p, value, at, share, move)


def _dips(e: Evaluation, tighten: Tighten) -> Rows:
    """Rows of ln |L| at its local minima below the first 0 dB crossing.

    Without them a linearised step lets |L| fall through 1 there, the first crossing jumps, and the search gives up.
    """
    p, size = e.p, e.ln_L
    at = kernel.dips(size, p.first, float(np.log(SHALLOW)))
    margin = np.broadcast_to(np.asarray(tighten.get(DIP, 0.0), dtype=float), p.points)
    return on_lines(DIP, p, size[at] - margin[p.owner[at]], at, np.ones(at.size))


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
