"""A small dense linear programme in a box, by the dual simplex method with an explicit inverse.

For a dozen of variables and some hundred rows: a general solver spends most of its time on the way in and out.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from loopshape.core.kernels.compiled import Array, compiled

OPTIMAL, NOT_SOLVED = 0, 1
#: a row counts as violated from here on, and a pivot as one
_SLACK, _PIVOT = 1e-10, 1e-11

# An array into a slice brings along the words of an error that numba compiles for three seconds: loops do not.


@compiled
def boxed_lp(cost: Array, A: Array, b: Array, low: Array, high: Array) -> tuple[Array, Array, int]:
    """min cost y (n,) under A y <= b (m,) and low <= y <= high, all bounds finite: y, multipliers of the rows, outcome.

    Starts at the corner of the box that the cost likes best, where all multipliers are right, and brings in the row
    violated most until none is (Lemke's dual method; Goldfarb and Idnani's for a linear cost). `NOT_SOLVED` where no
    point satisfies the rows, or 50 steps a variable did not do: y is then of no use.
    """
    n, m = cost.size, b.size
    inverse = np.zeros((n, n))  # of the matrix of active rows, kept as its transpose: row p belongs to active row p
    active = np.empty(n, dtype=np.int64)  # below m: a row of A; m + k: y_k <= high; m + n + k: -y_k <= -low
    y, weight = np.empty(n), np.abs(cost)
    for k in range(n):
        at_high = cost[k] < 0.0
        y[k] = high[k] if at_high else low[k]
        inverse[k, k] = 1.0 if at_high else -1.0
        active[k] = m + k if at_high else m + n + k
    outcome = NOT_SOLVED
    row = np.empty(n)
    for _ in range(50 * n):
        over = A @ y - b
        q = np.argmax(over) if m else 0
        worst = over[q] if m else 0.0
        up, down = np.argmax(y - high), np.argmax(low - y)
        if y[up] - high[up] > max(worst, low[down] - y[down]):
            q, worst = m + up, y[up] - high[up]
        elif low[down] - y[down] > worst:
            q, worst = m + n + down, low[down] - y[down]
        if worst <= _SLACK:
            outcome = OPTIMAL
            break
        row[:] = 0.0
        if q < m:
            for k in range(n):
                row[k] = A[q, k]
        elif q < m + n:
            row[q - m] = 1.0
        else:
            row[q - m - n] = -1.0
        parts = inverse @ row  # of the entering row in the active ones
        leaving, least = -1, np.inf
        for k in range(n):
            if parts[k] > _PIVOT and weight[k] < least * parts[k]:
                leaving, least = k, weight[k] / parts[k]
        if leaving < 0:
            break
        pivot = inverse[leaving] / parts[leaving]
        y -= worst * pivot
        for k in range(n):
            if k != leaving:
                mine = inverse[k]
                mine -= parts[k] * pivot
                weight[k] = max(weight[k] - least * parts[k], 0.0)
        for k in range(n):
            inverse[leaving, k] = pivot[k]
        weight[leaving] = least
        active[leaving] = q
    multipliers = np.zeros(m)
    for k in range(n):
        if active[k] < m:
            multipliers[active[k]] = weight[k]
    return y, multipliers, outcome


class Terms(NamedTuple):
    """Terms that are each made large, of `weights` (terms,): values (k,), which move by `slopes` (k, n).

    A term is no larger than its values, those of which `term` (k,) is its number.
    """

    value: Array
    slopes: Array
    term: np.ndarray
    weights: Array


class Rooms(NamedTuple):
    """Rooms (m,) of limits, which move by `slopes` (m, n): below zero by the soft miss at most where `soft` (m,)."""

    value: Array
    slopes: Array
    soft: np.ndarray


@compiled
def linearised(
    made_large: Terms, rooms: Rooms, low: Array, high: Array, penalty: float
) -> tuple[Array, Array, Array, Array, Array]:
    """Cost, A, b, low and high of a linear programme in y = (dx, terms, soft miss, hard miss), as `boxed_lp` takes it.

    Rooms that are not soft fall below zero by the hard miss at most, which costs `penalty`. Those that no dx between
    `low` and `high` (n,) brings below zero are left out.
    """
    value, slopes, term, weights = made_large
    room, room_slopes, soft = rooms
    n, terms, m = low.size, weights.size, room.size
    deepest, kept = 0.0, np.empty(m, dtype=np.bool_)
    for k in range(m):
        least = room[k]
        for v in range(n):
            least += min(room_slopes[k, v] * low[v], room_slopes[k, v] * high[v])
        kept[k] = least < 0.0
        deepest = min(deepest, least)
    A, b = np.zeros((value.size + kept.sum(), n + terms + 2)), np.empty(value.size + kept.sum())
    lows, highs = np.zeros(n + terms + 2), np.full(n + terms + 2, 1.0 - deepest)
    cost = np.zeros(n + terms + 2)
    cost[n + terms], cost[n + terms + 1] = 1.0, penalty
    for v in range(n):
        lows[v], highs[v] = low[v], high[v]
    for t in range(terms):
        lows[n + t], highs[n + t], cost[n + t] = np.inf, -np.inf, -weights[t]
    largest, farthest = np.zeros(terms), max(-low.min(), high.max())
    for k in range(value.size):
        largest[term[k]] = max(largest[term[k]], np.abs(slopes[k]).sum() * farthest)
        A[k, n + term[k]], b[k] = 1.0, value[k]
        for v in range(n):
            A[k, v] = -slopes[k, v]
        lows[n + term[k]], highs[n + term[k]] = min(lows[n + term[k]], value[k]), max(highs[n + term[k]], value[k])
    for t in range(terms):
        lows[n + t] -= largest[t] + 1.0
        highs[n + t] += largest[t] + 1.0
    row = value.size
    for k in range(m):
        if kept[k]:
            A[row, n + terms + (0 if soft[k] else 1)], b[row] = -1.0, room[k]
            for v in range(n):
                A[row, v] = -room_slopes[k, v]
            row += 1
    return cost, A, b, lows, highs
