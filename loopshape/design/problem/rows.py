"""Rows of a tuning problem: values that are to be at least zero, each with its slopes in short."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TypeVar
from weakref import WeakKeyDictionary

import numpy as np

from loopshape.core.units import Array, ComplexArray, db, deg, rad
from loopshape.data.requirement.requirements import LIMIT_OF
from loopshape.design.problem.problem import Problem

#: how far limits are moved inward, in their own unit ("stability" and the bandwidth of C: in ln of a magnitude): one
#: number, or one for each operating point
Tighten = Mapping[str, float | Array]
#: quantity of the rows that keep the count of encirclements sure: -1 outside the 95 % circles, |L| < 1 beyond
SURE = "stability"
#: quantity of the rows that keep |L| above 1 where it dips below the bandwidth: the first crossing would jump there
DIP = "dip"

#: a ratio or a frequency counts as so much at least: a loop without a crossing has a bandwidth of zero
LEAST = 1e-12


@dataclass(frozen=True, eq=False)
class Rows:
    """Values (m,) of one quantity whose slopes are Re(a d ln C_i/d x + b d ln C_j/d x) with i and j columns.

    `at` is the flat line nearest to each, or, from the number of flat lines on, a column above them; `point` its
    operating point, -1 where it is of C alone.
    """

    what: str
    value: Array
    at: np.ndarray
    point: np.ndarray
    i: np.ndarray
    a: ComplexArray
    j: np.ndarray
    b: ComplexArray


@dataclass(frozen=True, eq=False)
class DenseRows:
    """Values (m,) of one quantity that every line moves: slopes (m, n) are worked out when they are asked for.

    `at` and `point` as in `Rows`.
    """

    what: str
    value: Array
    at: np.ndarray
    point: np.ndarray
    slopes: Callable[[], Array]


def of_kernel(names: Sequence[str], places: np.ndarray, value: Array, ab: ComplexArray) -> Iterator[Rows]:
    """Rows as a kernel of `core.kernels.tuning_rows` writes them, in the order of their quantities."""
    cut = np.searchsorted(places[:, 0], np.arange(len(names) + 1)).tolist()
    at, point, i, j, a, b = *places.T[1:], *ab.T
    for name, m, n in zip(names, cut[:-1], cut[1:], strict=True):
        if m < n:
            yield Rows(name, value[m:n], at[m:n], point[m:n], i[m:n], a[m:n], j[m:n], b[m:n])


Made = TypeVar("Made")


def once(make: Callable[[Problem, Tighten], Made]) -> Callable[[Problem, Tighten], Made]:
    """What is made of a problem and a tightening, kept while the same tightening is asked for."""
    done: WeakKeyDictionary[Problem, tuple[Tighten, Made]] = WeakKeyDictionary()

    def known(p: Problem, tighten: Tighten) -> Made:
        kept = done.get(p)
        if kept is None or kept[0] is not tighten:
            kept = done[p] = tighten, make(p, tighten)
        return kept[1]

    return known


def required(p: Problem, name: str, tighten: Tighten) -> Array:
    """Limit of a quantity at each operating point, tightened, in its own unit; ratios stay above zero."""
    limit = LIMIT_OF[name]
    moved = np.asarray(tighten.get(name, 0.0)) * limit.sign
    every = p.limits[name] + moved
    return every if limit.unit in ("dB", "deg") else np.maximum(every, LEAST)


def scaled(name: str, value: Array) -> Array:
    """A limit as rows count it: ln of a magnitude or a ratio, rad of an angle."""
    unit = LIMIT_OF[name].unit
    if unit == "dB":
        return value * np.log(10.0) / 20.0
    return rad(value) if unit == "deg" else np.log(np.maximum(value, LEAST))


def slack_of(name: str, limit: float | Array, room: float | Array) -> Array:
    """Slack in a quantity's own unit from a row's room against `limit`; negative where it is missed."""
    unit = LIMIT_OF[name].unit
    if unit == "deg":
        return deg(room)
    if unit == "dB":
        return np.asarray(np.sign(room) * db(np.exp(np.abs(room))))
    sign = LIMIT_OF[name].sign
    return np.asarray(sign * np.asarray(limit) * np.expm1(sign * np.asarray(room)))


def in_rows(name: str, limit: float | Array, slack: float | Array) -> Array:
    """A slack as rows count it, to first order."""
    unit = LIMIT_OF[name].unit
    return np.asarray(scaled(name, np.asarray(slack)) if unit in ("dB", "deg") else np.asarray(slack) / limit)
