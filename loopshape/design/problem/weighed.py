"""What weights on |S|, |T|, |CS| and |PS| come to at a problem's frequencies, made once for each problem."""

from __future__ import annotations

from dataclasses import dataclass
from weakref import WeakKeyDictionary

import numpy as np

from loopshape.core.units import Array
from loopshape.data.requirement.weight import WEIGHTED, stacked
from loopshape.design.problem.problem import Problem


@dataclass(frozen=True, eq=False)
class Weighed:
    """The squared norm at a frequency is |S|² (`own` + `by_C` |C|²), (nf,) on the flat lines: none without weights.

    `above` (points, 4, above) are the squared weights above each point's last line, 0 below that.
    """

    own: Array
    by_C: Array  # noqa: N815
    above: Array


_WEIGHED: WeakKeyDictionary[Problem, Weighed] = WeakKeyDictionary()


def weighed(p: Problem) -> Weighed:
    """The weights of a problem."""
    if p not in _WEIGHED:
        _WEIGHED[p] = _made(p)
    return _WEIGHED[p]


def _made(p: Problem) -> Weighed:
    weights = p.requirements.weights
    if not weights:
        return Weighed(np.zeros(0), np.zeros(0), np.zeros((p.points, len(WEIGHTED), 0)))
    s, t, cs, ps = stacked(weights, p.f)
    square = np.abs(p.P) ** 2
    last = p.f[p.first[1:] - 1]
    above = stacked(weights, p.f_above) * (p.f_above >= last[:, None])[:, None, :]
    return Weighed(s + ps * square, cs + t * square, above)
