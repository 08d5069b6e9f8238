"""A cascade of biquads whose coefficients follow an operating point, in direct form I.

Its states are past signals, never products with coefficients: where the coefficients change, nothing in the states
does, and a section whose static gain stays the same goes on without a step.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from loopshape.core.kernels.compiled import Array, compiled, compiled_in_line


class Scheduled(NamedTuple):
    """Tables of a scheduled cascade, and where it stands; without sections it is none.

    `knots` (variables, most) rise up to `counts` (variables,); `sections` (nodes, n, 6) hold b0 b1 b2 a0 a1 a2 at each
    node, the last variable fastest. A variable is `picks` (variables, signals) times the signals, behind a lag that
    moves by `share` of what is left in each tick. In place: `at` (variables,), nan before the first tick, the
    coefficients of now (n, 5), and the last two signals in front of and behind each section, `past` (n + 1, 2).
    """

    knots: Array
    counts: np.ndarray
    sections: Array
    picks: Array
    share: float
    at: Array
    now: Array
    past: Array


def none(signals: int) -> Scheduled:
    """What stands where a loop's controller is not scheduled."""
    empty = np.zeros((0, 0))
    counts = np.zeros(0, dtype=np.int64)
    return Scheduled(
        empty, counts, np.zeros((0, 0, 6)), np.zeros((0, signals)), 1.0, np.zeros(0), np.zeros((0, 5)), empty
    )


@compiled_in_line
def interval(knots: Array, count: int, value: float) -> tuple[int, float]:
    """The knot below a value and the share of the way to the next, within the knots."""
    if count == 1 or not value > knots[0]:
        return 0, 0.0
    k = 0
    while k < count - 2 and value >= knots[k + 1]:
        k += 1
    return k, min((value - knots[k]) / (knots[k + 1] - knots[k]), 1.0)


@compiled
def interpolate(s: Scheduled) -> None:
    """Fill `now` with the coefficients at `at`: each of the nodes' six, linear in each variable, over the fourth."""
    variables, n = s.at.size, s.now.shape[0]
    below, share = np.zeros(variables, dtype=np.int64), np.zeros(variables)
    for v in range(variables):
        below[v], share[v] = interval(s.knots[v], s.counts[v], s.at[v])
    six = np.zeros((n, 6))
    for corner in range(1 << variables):
        weight, node = 1.0, 0
        for v in range(variables):
            up = (corner >> v) & 1
            weight *= share[v] if up else 1.0 - share[v]
            node = node * s.counts[v] + min(below[v] + up, s.counts[v] - 1)
        if weight > 0.0:
            for k in range(n):
                for j in range(6):
                    six[k, j] += weight * s.sections[node, k, j]
    for k in range(n):
        for j in range(3):
            s.now[k, j] = six[k, j] / six[k, 3]
        s.now[k, 3], s.now[k, 4] = six[k, 4] / six[k, 3], six[k, 5] / six[k, 3]


@compiled
def follow(s: Scheduled, signals: Array) -> None:
    """Move on to the operating point that the signals show."""
    moved = False
    for v in range(s.at.size):
        value = 0.0
        for j in range(signals.size):
            value += s.picks[v, j] * signals[j]
        step = value - s.at[v]
        if step != 0.0:  # also where it is not a number yet
            s.at[v] = s.at[v] + s.share * step if step == step else value
            moved = True
    if moved:
        interpolate(s)


@compiled
def step(s: Scheduled, value: float) -> float:
    """One sample through the cascade as it stands."""
    for k in range(s.now.shape[0]):
        c = s.now[k]
        out = c[0] * value + c[1] * s.past[k, 0] + c[2] * s.past[k, 1]
        out -= c[3] * s.past[k + 1, 0] + c[4] * s.past[k + 1, 1]
        s.past[k, 1] = s.past[k, 0]
        s.past[k, 0] = value
        value = out
    last = s.past.shape[0] - 1
    s.past[last, 1] = s.past[last, 0]
    s.past[last, 0] = value
    return value


@compiled
def run(s: Scheduled, signals: Array, inputs: Array) -> Array:
    """Outputs (n,) of inputs (n,) while signals (n, signals) tell the operating point."""
    out = np.empty(inputs.size)
    for k in range(inputs.size):
        follow(s, signals[k])
        out[k] = step(s, inputs[k])
    return out
