"""Rooms under the limits on magnitudes: |S|, |T|, |CS|, |PS|, the disk, the reach of L, and C's own bandwidth."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from loopshape.core.kernels import flat_loops as kernel
from loopshape.core.units import Array, ComplexArray, rad
from loopshape.design.evaluation import Evaluation
from loopshape.design.problem import Problem
from loopshape.design.rows import SURE, Rows, Tighten, on_lines, scaled, wished
from loopshape.loop.controller_bandwidth import HALF_POWER
from loopshape.loop.stability import FIT_DEG

#: local peaks this far below their limit (in ln) are left out, save the highest of each operating point
FAR = 0.7
#: of lines this near to their limit (in ln) every fourth counts too: on a plateau the peak goes where a step tilts it
PLATEAU, EVERY = 0.1, 4
_OF_C = "controller_bandwidth_hz"


def _S(L: ComplexArray) -> ComplexArray:
    return np.asarray(1.0 / (1.0 + L))


def _minus_T(L: ComplexArray) -> ComplexArray:
    return np.asarray(-L / (1.0 + L))


def _disk(L: ComplexArray) -> ComplexArray:
    return np.asarray(-2.0 * L / (1.0 - L**2))


def _one(L: ComplexArray) -> ComplexArray:
    return np.ones_like(L)


#: quantity -> ln of its magnitude on the flat lines, and d of it/d ln L
_PEAKS: dict[str, tuple[Callable[[Evaluation], Array], Callable[[ComplexArray], ComplexArray]]] = {
    "sensitivity_peak_db": (lambda e: e.ln_S, _minus_T),
    "modulus_margin": (lambda e: e.ln_S, _minus_T),
    "complementary_peak_db": (lambda e: e.ln_L + e.ln_S, _S),
    "control_peak_db": (lambda e: e.ln_C[e.p.line] + e.ln_S, _S),
    "control_high_frequency_db": (lambda e: e.ln_C[e.p.line] + e.ln_S, _S),
    "process_peak_db": (lambda e: e.p.ln_P + e.ln_S, _minus_T),
    "disk_margin": (lambda e: e.ln_disk, _disk),
    "sensitivity_mask_db": (lambda e: e.ln_S - e.p.masks["sensitivity_mask_db"], _minus_T),
    "complementary_mask_db": (lambda e: e.ln_L + e.ln_S - e.p.masks["complementary_mask_db"], _S),
    "control_mask_db": (lambda e: e.ln_C[e.p.line] + e.ln_S - e.p.masks["control_mask_db"], _S),
    "process_mask_db": (lambda e: e.p.ln_P + e.ln_S - e.p.masks["process_mask_db"], _minus_T),
    "loop_mask_db": (lambda e: e.ln_L - e.p.masks["loop_mask_db"], _one),
    "loop_floor_db": (lambda e: e.p.masks["loop_floor_db"] - e.ln_L, lambda L: -_one(L)),
}
#: above the last line, where |L| <= l, a masked response is at most |C|^own l^share (1/(1 - l))^worst
_ABOVE = {
    "sensitivity_mask_db": (0.0, 0.0, 1.0),
    "complementary_mask_db": (0.0, 1.0, 1.0),
    "control_mask_db": (1.0, 0.0, 1.0),
    "process_mask_db": (-1.0, 1.0, 1.0),
    "loop_mask_db": (0.0, 1.0, 0.0),
}


def peak_rows(e: Evaluation, tighten: Tighten) -> Iterator[Rows]:
    """Rows of every limit on a magnitude that the requirements make."""
    for name, (size_of, factor_of) in _PEAKS.items():
        if name not in e.p.limits:
            continue
        level = _level(name, wished(e.p, name, tighten))
        from_hz = _from_hz(e.p, name)
        size = size_of(e) if from_hz == 0.0 else np.where(e.p.f >= from_hz, size_of(e), -np.inf)
        at = _chosen(e.p, size, level - FAR)
        yield on_lines(name, e.p, level[e.p.owner[at]] - size[at], at, -factor_of(e.L[at]))
        yield from _above(e, name, level, from_hz)
    yield from _sure(e, tighten)
    yield from _ends(e)
    if e.p.f_wide.size:
        yield _controller_bandwidth(e, tighten)


def _level(name: str, limit: Array) -> Array:
    """ln of the largest magnitude allowed."""
    if name == "modulus_margin":
        return -scaled(name, limit)
    return np.log(2.0) - scaled(name, limit) if name == "disk_margin" else scaled(name, limit)


def _from_hz(p: Problem, name: str) -> float:
    return (p.requirements.control_high_frequency_from_hz or 0.0) if name == "control_high_frequency_db" else 0.0


def _chosen(p: Problem, size: Array, above: Array) -> np.ndarray:
    """Flat lines that are local maxima above a level or their neighbours, the largest of each point, and plateaus."""
    return kernel.peaks(size, above, p.first, FAR - PLATEAU, EVERY)


def _above(e: Evaluation, name: str, level: Array, from_hz: float) -> Iterator[Rows]:
    """Rows above the last lines, where |L| <= l, its last value: |S| <= 1/(1-l), |T| <= l/(1-l), |CS| <= |C|/(1-l)."""
    share, last, p = e.share_above, e.last, e.p
    worst, slope = -np.log1p(-share), share / (1.0 - share)
    if name in ("sensitivity_peak_db", "modulus_margin"):
        yield on_lines(name, p, level - worst, last, -slope)
    elif name == "complementary_peak_db":
        yield on_lines(name, p, level - np.log(share) - worst, last, -1.0 - slope)
    elif name == "disk_margin":
        yield on_lines(name, p, level - np.log1p(share) - worst, last, -2.0 * share / (1.0 - share**2))
    elif name in _ABOVE and p.f_above.size:
        yield _mask_above(e, name, level)
    elif name in ("control_peak_db", "control_high_frequency_db") and p.f_above.size:
        yield _control_above(e, name, level - worst, slope, from_hz)


def _mask_above(e: Evaluation, name: str, level: Array) -> Rows:
    """Rows of a masked response above the last lines, one for each point where it has least room there."""
    p, (own, share, worst) = e.p, _ABOVE[name]
    ln_share, ln_worst = np.log(e.share_above), -np.log1p(-e.share_above)
    size = own * e.ln_C[p.above] + (share * ln_share + worst * ln_worst)[:, None] - p.masks_above[name]
    k = size.argmax(axis=1)
    point = np.flatnonzero(np.isfinite(size.max(axis=1)))
    k, slope = k[point], share + worst * (e.share_above / (1.0 - e.share_above))[point]
    a, b = np.full(point.size, -own, dtype=complex), np.asarray(-slope, dtype=complex)
    room = level[point] - size[point, k]
    return Rows(name, room, p.f.size + k, point, p.above.start + k, a, p.line[e.last[point]], b)


def _control_above(e: Evaluation, name: str, left: Array, slope: Array, from_hz: float) -> Rows:
    """Rows of |C| above the last lines: the highest for each point, and near peaks for the one with least room."""
    p, size = e.p, e.ln_C[e.p.above]
    low = np.maximum(p.f[e.last], from_hz) * (1.0 - 1e-12)
    seen = np.flatnonzero(low <= p.f_above[-1])
    worst = int(np.argmin(left))
    over = np.where(p.f_above >= low[worst], size, -np.inf)
    near = np.flatnonzero(over > over.max() - 0.05)
    point = np.concatenate([seen, np.full(near.size, worst)])
    k = np.concatenate([kernel.highest(size, np.searchsorted(p.f_above, low[seen])), near])
    a, b = np.full(k.size, -1.0 + 0.0j), np.asarray(-slope[point], dtype=complex)
    column, room = p.above.start + k, left[point] - size[k]
    return Rows(name, room, p.f.size + k, point, column, a, p.line[e.last[point]], b)


def _sure(e: Evaluation, tighten: Tighten) -> Iterator[Rows]:
    """Rows that keep stability countable: -1 outside the 95 % circles of L, and |L| below 1 on lines beyond."""
    p, level = e.p, -np.broadcast_to(np.asarray(tighten.get(SURE, 0.0), dtype=float), e.p.points)
    if p.reach.any():
        with np.errstate(divide="ignore"):
            size = e.ln_C[p.line] + e.ln_S + np.log(p.reach)
        if size.max() > level.min() - FAR:
            at = _chosen(p, size, level - FAR)
            yield on_lines(SURE, p, level[p.owner[at]] - size[at], at, -_S(e.L[at]))
    if p.f_beyond.size:
        size = e.ln_C[p.beyond] + np.log(np.abs(p.P_beyond))
        k = np.flatnonzero(size > min(-FAR, float(size.max()) - 1e-9))
        column, minus = p.beyond.start + k, np.full(k.size, -1.0 + 0.0j)
        at = p.f.size + p.f_above.size + k
        yield Rows(SURE, -1e-3 - size[k], at, p.owner_beyond[k], column, minus, column, np.zeros(k.size, dtype=complex))


def _ends(e: Evaluation) -> Iterator[Rows]:
    """Rows that keep both ends of L countable.

    |L| is below 1 at the last lines; at the first ones, without a fit, above 1, and without any model that leads it on
    near the phase of its integrators.
    """
    p, first = e.p, e.p.first[:-1] + e.p.led
    yield on_lines(SURE, p, -1e-3 - e.ln_L[e.last], e.last, np.full(p.points, -1.0))
    blind, unfitted = first[np.diff(p.first_below) == 0], first[~p.fitted]
    if blind.size:
        owner = p.owner[blind]
        swing = np.angle(e.L[blind] * 1j ** p.integrators[owner] * np.where(p.unstable[owner] % 2 == 1, -1.0, 1.0))
        yield on_lines(SURE, p, float(rad(FIT_DEG)) - 1e-3 - np.abs(swing), blind, 1j * np.sign(swing))
    if unfitted.size:
        yield on_lines(SURE, p, e.ln_L[unfitted] - 1e-3, unfitted, np.ones(unfitted.size))


def _controller_bandwidth(e: Evaluation, tighten: Tighten) -> Rows:
    """Rows of |C| at and above its bandwidth's limit, 3 dB and what is tightened (ln) below the largest under it."""
    p, size = e.p, e.ln_C[e.p.wide]
    limit, lower = float(wished(p, _OF_C, {})[0]), float(np.max(tighten.get(_OF_C, 0.0)))
    split = int(np.searchsorted(p.f_wide, limit * (1.0 - 1e-12)))
    top, rest = int(np.argmax(size[: split + 1])), size[split:]
    peak = np.ones(rest.size, dtype=bool)
    peak[1:] &= rest[1:] >= rest[:-1]
    peak[:-1] &= rest[:-1] >= rest[1:]
    peak[0] = True
    k = split + np.flatnonzero(peak)
    one, start = np.full(k.size, 1.0 + 0.0j), p.wide.start
    at, every = p.f.size + p.f_above.size + p.f_beyond.size + k, np.full(k.size, -1)
    room = size[top] + HALF_POWER - lower - size[k]
    return Rows(_OF_C, room, at, every, np.full(k.size, start + top), one, start + k, -one)
