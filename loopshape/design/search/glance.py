"""Starts of a tuning at first sight: each with its gain as large as allowed, read by the kernel of `check`.

Thousands of starts are looked at so and few are followed; these are then measured by rows.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from loopshape.core.kernels.loops import margins as columns
from loopshape.core.kernels.loops.glance import Glanced, glance
from loopshape.core.units import Array
from loopshape.data.requirement.requirements import LIMIT_OF
from loopshape.data.requirement.weight import over
from loopshape.design.problem.evaluation import Evaluation
from loopshape.design.problem.measures import low_weights
from loopshape.design.problem.problem import Problem
from loopshape.design.problem.rows import scaled
from loopshape.design.search.search import PENALTY
from loopshape.loop.margin.margins import LOGARITHMS, PLAIN

#: at most so many ranges of the gain between passages of -1, the widest ones, are tried for a stable start
RANGES = 8


@dataclass(frozen=True, eq=False)
class Sight:
    """What is seen of a start: its merit, infinite where a loop is unstable, and x."""

    merit: float
    x: Array


def glanced(p: Problem) -> Glanced:
    """A problem's plants and limits as the kernel takes them."""
    level, sign, factor = _limits(p)
    last = p.f[p.first[1:] - 1]
    cut = zip(p.each, p.first[:-1], p.first[1:], strict=True)
    masks = [over(one.masks, one.weights, p.f[a:b]) for one, a, b in cut]
    weighed = any(one.masks or one.weights for one in p.each)
    wish = p.requirements.objective
    return Glanced(
        f=p.f,
        P=p.P,
        reach=p.reach,
        first=p.first,
        measured=p.first[:-1] + p.led,
        line=p.line,
        first_below=p.first_below,
        fitted=p.fitted,
        integrators=p.integrators,
        unstable=p.unstable,
        f_above=p.f_above,
        first_above=np.searchsorted(p.f_above, last),
        from_hz=p.requirements.control_high_frequency_from_hz or np.inf,
        masks=np.concatenate(masks, axis=1)[: None if weighed else 0],
        masks_above=np.stack([over(one.masks, one.weights, p.f_above) for one in p.each]),
        level=level,
        sign=sign,
        factor=factor,
        low=low_weights(p) if wish.disturbance else np.zeros(p.f.size),
        bandwidth=float(wish.bandwidth),
        disturbance=float(wish.disturbance),
        weighted_norm=float(wish.weighted_norm),
        penalty=PENALTY,
    )


def _limits(p: Problem) -> tuple[Array, Array, Array]:
    """Levels (points, columns) of the limits in the kernel's units, nan without one; signs and factors of rooms."""
    level = np.full((p.points, columns.COLUMNS), np.nan)
    sign, factor = np.ones(columns.COLUMNS), np.ones(columns.COLUMNS)
    for name, limit in p.limits.items():
        if name == "sensitivity_peak_db":  # the kernel reads its inverse
            level[:, columns.LN_MODULUS] = np.fmax(level[:, columns.LN_MODULUS], -scaled(name, limit))
        elif name in LOGARITHMS:
            k = LOGARITHMS[name]
            level[:, k] = np.fmax(level[:, k], scaled(name, limit))
            sign[k] = 1.0 if LIMIT_OF[name].sense == "at_least" else -1.0
        elif name in PLAIN:
            k = PLAIN[name]
            level[:, k], factor[k] = limit, scaled(name, np.array(2.0)) - scaled(name, np.array(1.0))
            sign[k] = 1.0 if LIMIT_OF[name].sense == "at_least" else -1.0
    return level, sign, factor


def scaled_start(p: Problem, q: Glanced, x: Array, halvings: int = 6) -> Sight:
    """A start from x, its first free gain (where there is one) about as large as all requirements allow, by halving.

    Where halving meets no stable loop the gain may have to be larger: an unstable plant needs a least gain.
    """
    e = Evaluation(p, x)

    C_above = e.C[p.above]

    def look(shift: float, enough: float = np.inf) -> tuple[float, bool]:
        return glance(q, float(np.exp(shift)), e.C, C_above, e.below, enough)

    k = next((k for k, v in enumerate(p.variables) if v.name == "gain"), None)
    best, shift = look(0.0)[0], 0.0
    if k is None:
        return Sight(best, x)
    low, high = float(p.low[k] - x[k]), float(p.high[k] - x[k])
    for _ in range(halvings):
        trial = 0.5 * (low + high)
        merit, holds = look(trial, best)
        low, high = (trial, high) if holds else (low, trial)
        if merit < best:
            best, shift = merit, trial
    if np.isinf(best):
        for trial in _between_passages(e, float(p.low[k] - x[k]), float(p.high[k] - x[k])):
            merit, _ = look(trial, best)
            if merit < best:
                best, shift = merit, trial
    return Sight(best, np.where(np.arange(x.size) == k, x + shift, x))


def _between_passages(e: Evaluation, low: float, high: float) -> Array:
    """Changes of ln gain in the middle of each range in which no L passes -1, the widest ranges first.

    A gain moves every passage of the negative real axis alike, and within such a range the count does not change.
    """
    at = e.axis[e.L.real[e.axis] < 0.0]
    passes = -e.ln_L[np.concatenate([at, e.p.first[:-1]])]  # change at which each lies at -1
    edges = np.unique(np.clip([low, *passes, high], low, high))
    widest = np.argsort(edges[:-1] - edges[1:], kind="stable")[:RANGES]
    return np.asarray(0.5 * (edges[widest] + edges[widest + 1]))
