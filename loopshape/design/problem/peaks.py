"""Rooms under the limits on magnitudes: |S|, |T|, |CS|, |PS|, the disk, the reach of L, and C's own bandwidth.

The norm of the weighted loop is sqrt(sum of |W|² |response|²) at its peaks: a limit, or what is made small.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from loopshape.core.kernels.loops import tuning_rows as kernel
from loopshape.core.remembered import remembered
from loopshape.core.units import Array, ComplexArray, rad
from loopshape.data.control.controller import HALF_POWER
from loopshape.data.requirement.requirements import LIMITS
from loopshape.design.problem.evaluation import Evaluation, weighed
from loopshape.design.problem.problem import Problem
from loopshape.design.problem.rows import SURE, Rows, Tighten, of_kernel, once, required, scaled
from loopshape.loop.stability.stability import FIT_DEG

#: name of the limit on the norm of the weighted loop, and of its rows
NORM = "weighted_norm"
_OF_C = "controller_bandwidth_hz"
#: quantity -> magnitude
_KINDS = {x.name: int(getattr(kernel, x.magnitude)) for x in LIMITS if x.magnitude} | {SURE: kernel.SURE}
#: quantities that go on above the last line, where |L| stays below its last value
_STAY = (
    "sensitivity_peak_db", "modulus_margin", "complementary_peak_db", "disk_margin", "control_peak_db",
    "control_high_frequency_db",
)  # fmt: skip
#: above the last line, where |L| <= l, a masked response is at most |C|^own l^share (1/(1 - l))^worst
_ABOVE = {
    "sensitivity_mask_db": (0.0, 0.0, 1.0),
    "complementary_mask_db": (0.0, 1.0, 1.0),
    "control_mask_db": (1.0, 0.0, 1.0),
    "process_mask_db": (-1.0, 1.0, 1.0),
    "loop_mask_db": (0.0, 1.0, 0.0),
}


@remembered
def _asked(p: Problem) -> tuple[tuple[str, ...], kernel.Magnitudes]:
    """Names of a problem's limits on magnitudes, and these as the kernel takes them, their levels left open."""
    names = tuple(x for x in _KINDS if x in p.limits or (x == SURE and p.radius.any()))
    masks, from_hz = [x for x in names if x in p.masks], p.requirements.control_high_frequency_from_hz or 0.0
    return names, kernel.Magnitudes(
        kinds=np.array([_KINDS[x] for x in names], dtype=np.int64),
        level=np.zeros((0, p.points)),
        from_hz=np.array([from_hz * (x == "control_high_frequency_db") for x in names], dtype=float),
        above=np.array([kernel.STAYS if x in _STAY else kernel.NOT for x in names], dtype=np.int64),
        masks=np.stack([p.masks[x] for x in masks]) if masks else np.zeros((0, p.f.size)),
        masked=np.array([masks.index(x) if x in masks else -1 for x in names], dtype=np.int64),
    )


@once
def _levels(p: Problem, tighten: Tighten) -> Array:
    """ln of the largest magnitudes allowed (names, points)."""
    names, _ = _asked(p)
    return np.array([_level(p, x, tighten) for x in names]).reshape(len(names), p.points)


def peak_rows(e: Evaluation, tighten: Tighten) -> Iterator[Rows]:
    """Rows of every limit on a magnitude that the requirements make, and of what keeps stability countable.

    They lie at local peaks and beside them, at the highest of each operating point, and on plateaus.
    """
    p, (names, limits) = e.p, _asked(e.p)
    level = _levels(p, tighten)
    yield from of_kernel(names, *_magnitude_rows(e, limits._replace(level=level)))
    for name, mine in zip(names, level, strict=True) if p.f_above.size else ():
        if name in _ABOVE:
            yield _mask_above(e, name, mine)
        if name == NORM:
            yield from _norm_above(e, mine)
    yield from _beyond(e)
    blind = np.diff(p.first_below) == 0
    ends = kernel.end_rows(e.flat, 0, blind, ~p.fitted, p.integrators, p.unstable, float(rad(FIT_DEG)))
    yield from of_kernel((SURE,), *ends)
    if p.f_wide.size:
        yield _controller_bandwidth(e, tighten)


def _level(p: Problem, name: str, tighten: Tighten) -> Array:
    """ln of the largest magnitude allowed (points,)."""
    if name == SURE:
        return -np.broadcast_to(np.asarray(tighten.get(SURE, 0.0), dtype=float), p.points)
    limit = required(p, name, tighten)
    if name == "modulus_margin":
        return -scaled(name, limit)
    return np.log(2.0) - scaled(name, limit) if name == "disk_margin" else scaled(name, limit)


def _magnitude_rows(e: Evaluation, limits: kernel.Magnitudes) -> tuple[np.ndarray, Array, ComplexArray]:
    return kernel.magnitude_rows(e.flat, limits, _FAR, _FAR - _PLATEAU, _EVERY)


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


def _beyond(e: Evaluation) -> Iterator[Rows]:
    """Rows that keep |L| below 1 on the less sure lines above those that are judged."""
    p = e.p
    if p.f_beyond.size:
        size = e.ln_C[p.beyond] + np.log(np.abs(p.P_beyond))
        k = np.flatnonzero(size > min(-_FAR, float(size.max()) - 1e-9))
        column, minus = p.beyond.start + k, np.full(k.size, -1.0 + 0.0j)
        at = p.f.size + p.f_above.size + k
        yield Rows(SURE, -1e-3 - size[k], at, p.owner_beyond[k], column, minus, column, np.zeros(k.size, dtype=complex))


def _controller_bandwidth(e: Evaluation, tighten: Tighten) -> Rows:
    """Rows of |C| at and above its bandwidth's limit, 3 dB and what is tightened (ln) below the largest under it."""
    p, size = e.p, e.ln_C[e.p.wide]
    limit, lower = float(required(p, _OF_C, {})[0]), float(np.max(tighten.get(_OF_C, 0.0)))
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


#: peaks this far below the largest (ln) are left out, save the highest of each operating point
_FAR = 0.7
#: of lines this near to the largest every fourth counts too: where the optimum is flat, all of it is pushed down
_PLATEAU, _EVERY = 0.1, 4
#: above the last lines rows come from this close (ln) to the largest
_NEAR = 0.05


def norm_rows(e: Evaluation) -> tuple[Rows, ...]:
    """Rows of ln of one over the norm, where it is among the largest; none where the objective has no norm."""
    if not e.p.requirements.objective.weighted_norm:
        return ()
    level = np.full((1, e.p.points), max(float(e.ln_norm.max()), float(_above(e)[0].max(initial=-np.inf))))
    kinds, above, none = np.array([kernel.NORM]), np.array([kernel.NOT]), np.zeros((0, e.p.f.size))
    limits = kernel.Magnitudes(kinds, level, np.zeros(1), above, none, np.array([-1]))
    places, value, ab = _magnitude_rows(e, limits)
    lines = of_kernel((NORM,), places, value - level[0, 0], ab)
    return (*lines, *_norm_above(e, np.zeros(e.p.points)))


def _norm_above(e: Evaluation, level: Array) -> Iterator[Rows]:
    """Rows below a level (points,) in ln above the last lines, where |L| stays below its last value l.

    There |S| is at most 1/(1 - l), |T| and |CS| and |PS| that times l, |C| and l/|C|.
    """
    size, by_C, by_l = _above(e)
    if size.size and np.isfinite(size).any():
        point, k = np.nonzero(np.isfinite(size) & ((size >= size.max() - _NEAR) | _largest(size)))
        p, last = e.p, e.p.line[e.last[point]]
        a, b = (np.asarray(-slope[point, k], dtype=complex) for slope in (by_C, by_l))
        yield Rows(NORM, level[point] - size[point, k], p.f.size + k, point, p.above.start + k, a, last, b)


def _largest(size: Array) -> np.ndarray:
    return np.arange(size.shape[1]) == size.argmax(axis=1)[:, None]


def _above(e: Evaluation) -> tuple[Array, Array, Array]:
    """ln of the norm (points, above) above the last lines, -inf without weights, and its slopes by ln |C| and ln l."""
    s, t, cs, ps = np.moveaxis(weighed(e.p).above, 1, 0)
    c2, l2, room = np.exp(2.0 * e.ln_C[e.p.above]), e.share_above[:, None] ** 2, 1.0 - e.share_above[:, None]
    if not s.size:
        return s, s, s
    parts = np.stack([s, t * l2, cs * c2, ps * l2 / c2])
    total = parts.sum(axis=0)
    with np.errstate(divide="ignore"):
        size = 0.5 * np.log(total) - np.log(room)
    share = parts / np.maximum(total, 1e-300)
    return size, share[2] - share[3], share[1] + share[3] + e.share_above[:, None] / room
