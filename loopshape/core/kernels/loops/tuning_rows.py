"""Rows of a tuning: the room that each limit leaves wherever it may bind, with how it moves with ln C, in one pass.

A row's slopes are Re(a d ln C_i + b d ln C_j) with i and j columns of C.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from loopshape.core.kernels.compiled import Array, ComplexArray, compiled, compiled_in_line
from loopshape.core.kernels.loops.flat_loops import mark_peaks

#: magnitudes that a limit is on: of S, T, CS, PS, the disk (1 - L)/(1 + L), L, its inverse, CS times P's reach, and the
#: norm of the weighted loop
S, T, CS, PS, DISK, LOOP, FLOOR, SURE, NORM = range(9)
#: how a limit goes on above the last line: not at all, or as |L| stays below its last value there
NOT, STAYS = 0, 1
#: |L| at the last lines is taken to be no closer to 1 than this (ln)
_CLOSE = 1e-6
#: rows of |C| above the last lines come from this close (ln) to the largest where there is least room
_NEAR = 0.05
#: ends of L are kept this far (ln or rad) on the sure side
_SURE = 1e-3
_TINY = 1e-300


class Out(NamedTuple):
    """Rows that are filled: quantity, line, point, i and j (m, 5); value (m,); a and b (m, 2)."""

    places: np.ndarray
    value: Array
    ab: ComplexArray


class Flat(NamedTuple):
    """The lines of all operating points: L, ln |L|, ln |S| and ln |P| (nf,), and ln |C| on the columns.

    `line` (nf,) is the column of each line, `first` (points + 1,) where operating points begin, `below` (points,) how
    many lines a model leads there. Above the last line C is known on columns `above` .. `above` + f_above.size. The
    squared norm of the weighted loop is |S|² (`own` + `by_C` |C|²), (nf,), or none where nothing is weighted.
    """

    f: Array
    ln_f: Array
    L: ComplexArray
    ln_L: Array  # noqa: N815
    ln_S: Array  # noqa: N815
    ln_P: Array  # noqa: N815
    ln_C: Array  # noqa: N815
    ln_circle: Array
    line: np.ndarray
    first: np.ndarray
    below: np.ndarray
    f_above: Array
    above: int
    own: Array
    by_C: Array  # noqa: N815


class Magnitudes(NamedTuple):
    """Limits on magnitudes: `kinds` (nq,) below `level` (nq, points), in ln, from `from_hz` (nq,) on.

    Quantity q is held against row `masked`[q] of `masks` (ln), none below 0, and goes on above the last lines as
    `above`[q] says.
    """

    kinds: np.ndarray
    level: Array
    from_hz: Array
    above: np.ndarray
    masks: Array
    masked: np.ndarray


class Place(NamedTuple):
    """Where a row lies: quantity, flat line and operating point."""

    q: int
    at: int
    p: int


class Crossing(NamedTuple):
    """Where ln |L| passes 0: after flat line `at` of point `p`, at a `share` of the way to the next.

    L turns by `turn` rad over `span` in ln f there. The crossing lies at `ln_f` and moves by Re(move d ln C).
    """

    at: int
    p: int
    share: float
    turn: float
    span: float
    ln_f: float
    move: float


@compiled
def _put(out: Out, n: int, place: Place, value: float, i: int, a: complex, j: int, b: complex) -> int:
    row = out.places[n]
    row[0], row[1], row[2], row[3], row[4] = place.q, place.at, place.p, i, j
    out.value[n] = value
    out.ab[n, 0], out.ab[n, 1] = a, b
    return n + 1


@compiled_in_line
def _control_part(x: Flat, k: int) -> float:
    """What |C| brings into the squared norm of the weighted loop at a line, over |S|²."""
    return x.by_C[k] * np.exp(2.0 * x.ln_C[x.line[k]])


@compiled_in_line
def _norm_by_ln_C(x: Flat, k: int) -> complex:
    """-d ln norm/d ln C at a line."""
    part = _control_part(x, k)
    return x.L[k] / (1.0 + x.L[k]) - part / max(x.own[k] + part, _TINY)


@compiled
def _sizes(x: Flat, kind: int, from_hz: float, mask: Array, out: Array) -> float:
    """ln of a magnitude less a mask (nf,), none where that is empty, into `out` (nf,); -inf below a frequency.

    Returns the largest.
    """
    largest, up = -np.inf, -1.0 if kind == FLOOR else 1.0
    for k in range(out.size):
        if x.f[k] < from_hz:
            out[k] = -np.inf
            continue
        size = _size(x, kind, k)
        out[k] = size - up * mask[k] if mask.size else size
        largest = max(largest, out[k])
    return largest


@compiled_in_line
def _size(x: Flat, kind: int, k: int) -> float:
    """ln of a magnitude at a line."""
    if kind == T:
        return x.ln_L[k] + x.ln_S[k]
    if kind == CS:
        return x.ln_C[x.line[k]] + x.ln_S[k]
    if kind == SURE:
        return x.ln_C[x.line[k]] + x.ln_S[k] + x.ln_circle[k]
    if kind == NORM:
        return 0.5 * np.log(max(x.own[k] + _control_part(x, k), _TINY)) + x.ln_S[k]
    if kind == PS:
        return x.ln_P[k] + x.ln_S[k]
    if kind == DISK:
        return 0.5 * np.log((1.0 - x.L[k].real) ** 2 + x.L[k].imag ** 2) + x.ln_S[k]
    if kind == LOOP:
        return x.ln_L[k]
    return -x.ln_L[k] if kind == FLOOR else x.ln_S[k]


@compiled_in_line
def _by_ln_L(kind: int, L: complex) -> complex:
    """-d ln magnitude/d ln L."""
    if kind in (S, PS):
        return L / (1.0 + L)
    if kind in (T, CS, SURE):
        return -1.0 / (1.0 + L)
    if kind == DISK:
        return 2.0 * L / (1.0 - L * L)
    return -1.0 + 0.0j if kind == LOOP else 1.0 + 0.0j


@compiled
def _stays(x: Flat, kind: int, level: float, last: int) -> tuple[float, float]:
    """Room and its slope by ln C at the last line where |L| stays below its value there, of |S|, |T| or the disk."""
    share = np.exp(min(x.ln_L[last], -_CLOSE))
    worst, slope = -np.log1p(-share), share / (1.0 - share)
    if kind == S:
        return level - worst, -slope
    if kind == T:
        return level - np.log(share) - worst, -1.0 - slope
    return level - np.log1p(share) - worst, -2.0 * share / (1.0 - share**2)


@compiled
def _control_above(x: Flat, q: int, level: Array, from_hz: float, out: Out, n: int) -> int:
    """Rows of |CS| above the last lines, |C|/(1 - l): the highest of each point, and more where there is least room."""
    points, above = x.first.size - 1, x.f_above.size
    top, best = above - 1, np.empty(above, dtype=np.int64)
    for k in range(above - 1, -1, -1):
        if x.ln_C[x.above + k] >= x.ln_C[x.above + top]:
            top = k
        best[k] = top
    tightest, least, start_there, slope_there = -1, np.inf, 0, 0.0
    for p in range(points):
        last = x.first[p + 1] - 1
        share = np.exp(min(x.ln_L[last], -_CLOSE))
        left, slope = level[p] + np.log1p(-share), share / (1.0 - share)
        start = np.searchsorted(x.f_above, max(x.f[last], from_hz) * (1.0 - 1e-12))
        if left < least:
            tightest, least, start_there, slope_there = p, left, start, slope
        if start < above:
            k = best[start]
            place, room = Place(q, x.f.size + k, p), left - x.ln_C[x.above + k]
            n = _put(out, n, place, room, x.above + k, -1.0 + 0.0j, x.line[last], complex(-slope))
    last = x.first[tightest + 1] - 1
    if start_there < above:
        most = x.ln_C[x.above + best[start_there]]
        for k in range(start_there, above):
            size = x.ln_C[x.above + k]
            if size > most - _NEAR:
                place = Place(q, x.f.size + k, tightest)
                n = _put(out, n, place, least - size, x.above + k, -1.0 + 0.0j, x.line[last], complex(-slope_there))
    return n


@compiled
def magnitude_rows(
    x: Flat, limits: Magnitudes, far: float, plateau: float, every: int
) -> tuple[np.ndarray, Array, ComplexArray]:
    """Rows of limits on magnitudes, at peaks no more than `far` below the level, as `mark_peaks` chooses."""
    kinds, level, from_hz, above, masks, masked = limits
    lines, points = x.ln_L.size, x.first.size - 1
    sizes, chosen = np.empty((kinds.size, lines)), np.zeros((kinds.size, lines), dtype=np.bool_)
    room, none = kinds.size * 2 * (points + x.f_above.size), np.empty(0)
    for q in range(kinds.size):
        largest = _sizes(x, kinds[q], from_hz[q], masks[masked[q]] if masked[q] >= 0 else none, sizes[q])
        if kinds[q] != SURE or largest > level[q].min() - far:
            room += mark_peaks(sizes[q], level[q] - far, x.first, plateau, every, chosen[q])
    out = Out(np.empty((room, 5), dtype=np.int64), np.empty(room), np.empty((room, 2), dtype=np.complex128))
    n, first, line, L = 0, x.first, x.line, x.L
    for q in range(kinds.size):
        mine = chosen[q]
        for p in range(points):
            for k in range(first[p], first[p + 1]):
                if mine[k]:
                    column = line[k]
                    a = _norm_by_ln_C(x, k) if kinds[q] == NORM else _by_ln_L(kinds[q], L[k])
                    n = _put(out, n, Place(q, k, p), level[q, p] - sizes[q, k], column, a, column, 0.0j)
            if above[q] == STAYS and kinds[q] != CS:
                last = x.first[p + 1] - 1
                value, slope = _stays(x, kinds[q], level[q, p], last)
                n = _put(out, n, Place(q, last, p), value, x.line[last], complex(slope), x.line[last], 0.0j)
        if above[q] == STAYS and kinds[q] == CS and x.f_above.size:
            n = _control_above(x, q, level[q], from_hz[q], out, n)
    return out.places[:n].copy(), out.value[:n].copy(), out.ab[:n].copy()


@compiled
def end_rows(
    x: Flat, q: int, blind: np.ndarray, unfitted: np.ndarray, integrators: np.ndarray, unstable: np.ndarray, fit: float
) -> tuple[np.ndarray, Array, ComplexArray]:
    """Rows that keep both ends of L countable: |L| below 1 at the last lines, above 1 at the first ones `unfitted`.

    Where nothing leads on from the first line (`blind`) L lies there within `fit` rad of its integrators' phase.
    """
    points = x.first.size - 1
    room, n = 3 * points, 0
    out = Out(np.empty((room, 5), dtype=np.int64), np.empty(room), np.empty((room, 2), dtype=np.complex128))
    for p in range(points):
        k = x.first[p + 1] - 1
        n = _put(out, n, Place(q, k, p), -_SURE - x.ln_L[k], x.line[k], -1.0 + 0.0j, x.line[k], 0.0j)
        k = x.first[p] + x.below[p]
        column = x.line[k]
        if blind[p]:
            ahead = x.L[k]
            for _ in range(integrators[p] % 4):
                ahead *= 1j
            if unstable[p] % 2 == 1:
                ahead = -ahead
            swing = np.arctan2(ahead.imag, ahead.real)
            n = _put(out, n, Place(q, k, p), fit - _SURE - abs(swing), column, 1j * np.sign(swing), column, 0.0j)
        if unfitted[p]:
            n = _put(out, n, Place(q, k, p), x.ln_L[k] - _SURE, column, 1.0 + 0.0j, column, 0.0j)
    return out.places[:n].copy(), out.value[:n].copy(), out.ab[:n].copy()


@compiled
def _put_between(x: Flat, out: Out, n: int, place: Place, value: float, share: float, by: complex) -> int:
    """A row at a share of the way from its flat line to the next, moving with ln C there by a factor."""
    j = x.line[min(place.at + 1, x.ln_L.size - 1)]
    return _put(out, n, place, value, x.line[place.at], (1.0 - share) * by, j, share * by)


@compiled_in_line
def _angle(z: complex) -> float:
    return np.arctan2(z.imag, z.real)


@compiled
def crossing_rows(
    x: Flat, phase: Array, delay: Array, gain: Array, reduction: Array, dip: Array, shallow: float,
    integrators: np.ndarray,
) -> tuple[np.ndarray, Array, ComplexArray, Array, np.ndarray, ComplexArray]:  # fmt: skip
    """Rows 0 to 4 of phase, delay, gain and reduction margins (rad and ln) and of dips, and those of ln bandwidth.

    Limits are (points,), nan without one. ln L is linear in ln f between lines. Dips are local minima of ln |L| below
    `shallow` before it first falls below 0. Of the bandwidths value (points,), places (points, 4), a and b.
    """
    lines, points = x.ln_L.size, x.first.size - 1
    room = 4 * lines + points
    out = Out(np.empty((room, 5), dtype=np.int64), np.empty(room), np.empty((room, 2), dtype=np.complex128))
    wide, wide_at = np.empty(points), np.empty((points, 4), dtype=np.int64)
    wide_ab = np.empty((points, 2), dtype=np.complex128)
    n = 0
    for p in range(points):
        a, b = x.first[p], x.first[p + 1]
        order = max(integrators[p], 1)
        at, share, value, move = a, 0.0, x.ln_f[a] + x.ln_L[a] / order, 1.0 / order
        crossed = fallen = False
        for k in range(a, b):
            here = x.ln_L[k]
            if here < 0.0:
                fallen = True
            if k == b - 1:
                break
            ahead = x.ln_L[k + 1]
            if not fallen and k > a and 0.0 < here < shallow and here <= x.ln_L[k - 1] and here < ahead:
                n = _put_between(x, out, n, Place(4, k, p), here - dip[p], 0.0, 1.0 + 0.0j)
            if here * ahead < 0.0:
                rise, span = ahead - here, x.ln_f[k + 1] - x.ln_f[k]
                s, turn = -here / rise, _angle(x.L[k + 1] / x.L[k])
                ln_f, by = x.ln_f[k] + s * span, -span / rise
                if not crossed and x.ln_L[a] >= 0.0:
                    at, share, value, move = k, s, ln_f, by
                crossed = True
                n = _phase_rows(x, out, n, Crossing(k, p, s, turn, span, ln_f, by), phase[p], delay[p])
            y0, y1 = x.L[k].imag, x.L[k + 1].imag
            if y0 * y1 <= 0.0 and (x.L[k].real < 0.0 or x.L[k + 1].real < 0.0):
                n = _gain_rows(x, out, n, k, p, gain[p], reduction[p])
        if not np.isnan(gain[p]):
            n = _put_between(x, out, n, Place(2, b - 1, p), -x.ln_L[b - 1] - gain[p], 0.0, -1.0 + 0.0j)
        wide[p] = value
        j = min(at + 1, lines - 1)
        wide_at[p, 0], wide_at[p, 1], wide_at[p, 2], wide_at[p, 3] = at, p, x.line[at], x.line[j]
        wide_ab[p, 0], wide_ab[p, 1] = (1.0 - share) * move, share * move
    return out.places[:n].copy(), out.value[:n].copy(), out.ab[:n].copy(), wide, wide_at, wide_ab


@compiled
def _phase_rows(x: Flat, out: Out, n: int, crossing: Crossing, phase: float, delay: float) -> int:
    """Rows of the phase and the delay margin at a 0 dB crossing."""
    k, p, share, turn, span, ln_f, move = crossing
    ahead = (_angle(x.L[k]) + share * turn + np.pi) % (2.0 * np.pi)  # rotation by lag onto -1
    by = -1j + turn / span * move  # d phase = Re(by d ln C)
    if not np.isnan(phase):
        if ahead <= np.pi:
            n = _put_between(x, out, n, Place(0, k, p), ahead - phase, share, by)
        else:
            n = _put_between(x, out, n, Place(0, k, p), 2.0 * np.pi - ahead - phase, share, -by)
    if not np.isnan(delay):
        ahead = max(ahead, 1e-12)
        value = np.log(ahead / (2.0 * np.pi)) - ln_f - delay
        n = _put_between(x, out, n, Place(1, k, p), value, share, by / ahead - move)
    return n


@compiled
def _gain_rows(x: Flat, out: Out, n: int, k: int, p: int, gain: float, reduction: float) -> int:
    """A row of the gain or the reduction margin where L passes the negative real axis."""
    to_axis, turn = _angle(-x.L[k]), _angle(x.L[k + 1] / x.L[k])
    if turn == 0.0 or abs(to_axis) >= 0.75 * np.pi:
        return n
    share = -to_axis / turn
    if not 0.0 <= share <= 1.0:
        return n
    rise = x.ln_L[k + 1] - x.ln_L[k]
    value, by = x.ln_L[k] + share * rise, 1.0 + 1j * rise / turn
    if value <= 0.0 and not np.isnan(gain):
        return _put_between(x, out, n, Place(2, k, p), -value - gain, share, -by)
    if value > 0.0 and not np.isnan(reduction):
        return _put_between(x, out, n, Place(3, k, p), value - reduction, share, by)
    return n


@compiled
def row_slopes(
    sections: Array, changes: Array, block: np.ndarray, s: ComplexArray, places: np.ndarray, ab: ComplexArray
) -> Array:
    """Slopes (m, nx) of rows whose columns i and j are `places` (m, 2), where x moves section `block` by `changes`."""
    out = np.empty((len(places), block.size))
    num, den = np.empty(len(sections), dtype=np.complex128), np.empty(len(sections), dtype=np.complex128)
    for m in range(len(places)):
        out[m, :] = 0.0
        for side in range(2):
            factor = ab[m, side]
            if factor == 0.0:
                continue
            z = s[places[m, side]]
            for c in range(len(sections)):
                num[c] = sections[c, 0] + z * (sections[c, 1] + z * sections[c, 2])
                den[c] = sections[c, 3] + z * (sections[c, 4] + z * sections[c, 5])
                num[c], den[c] = 1.0 / num[c], 1.0 / den[c]
            for v in range(block.size):
                d, c = changes[v], block[v]
                by = (d[0] + z * (d[1] + z * d[2])) * num[c] - (d[3] + z * (d[4] + z * d[5])) * den[c]
                out[m, v] += factor.real * by.real - factor.imag * by.imag
    return out
