"""Many open loops on flat lines: one after the other in one array, loop k from `first`[k] to `first`[k + 1].

What a tuning asks of thousands of controllers, each in one pass over the lines.
"""

from __future__ import annotations

import numpy as np

from loopshape.core.kernels.compiled import Array, ComplexArray, compiled
from loopshape.core.kernels.loops.encirclements import NO_FIT, count_unstable


@compiled
def series(sections: Array, s: ComplexArray) -> ComplexArray:
    """Response (ns,) of sections (n, 6) in series: coefficients of s^0, s^1, s^2, numerator before denominator."""
    out = np.empty(s.size, dtype=np.complex128)
    for k in range(s.size):
        z, num, den = s[k], 1.0 + 0.0j, 1.0 + 0.0j
        for c in sections:
            num *= c[0] + z * (c[1] + z * c[2])
            den *= c[3] + z * (c[4] + z * c[5])
        out[k] = num / den
    return out


@compiled
def log_slopes(sections: Array, changes: Array, block: np.ndarray, s: ComplexArray) -> ComplexArray:
    """d ln C/d x (nx, ns), exact, where x moves section `block` (nx,) by `changes` (nx, 6)."""
    out = np.empty((block.size, s.size), dtype=np.complex128)
    for v in range(block.size):
        c, d = sections[block[v]], changes[v]
        for k in range(s.size):
            z = s[k]
            num, den = c[0] + z * (c[1] + z * c[2]), c[3] + z * (c[4] + z * c[5])
            by_num, by_den = d[0] + z * (d[1] + z * d[2]), d[3] + z * (d[4] + z * d[5])
            out[v, k] = (by_num * den - by_den * num) / (num * den)
    return out


@compiled
def loops(C: ComplexArray, line: np.ndarray, P: ComplexArray) -> tuple[ComplexArray, Array, Array]:
    """L = C P, ln |L| and ln |S| on the flat lines, C being given on columns `line` (nf,)."""
    L, ln_L, ln_S = np.empty(P.size, dtype=np.complex128), np.empty(P.size), np.empty(P.size)
    for k in range(P.size):
        z = C[line[k]] * P[k]
        L[k] = z
        ln_L[k] = 0.5 * np.log(z.real**2 + z.imag**2)
        ln_S[k] = -0.5 * np.log((1.0 + z.real) ** 2 + z.imag**2)
    return L, ln_L, ln_S


@compiled
def mark_peaks(size: Array, above: Array, first: np.ndarray, plateau: float, every: int, chosen: np.ndarray) -> int:
    """Mark flat lines that are local maxima above a level (loops,) or their neighbours, and the largest of each loop.

    Of lines more than `plateau` above the level every so many too. Only where `size` is finite. Returns how many.
    """
    count = 0
    for p in range(first.size - 1):
        a, b, level = first[p], first[p + 1], above[p]
        top = a
        for k in range(a, b):
            here = size[k]
            if here > size[top]:
                top = k
            if not here > level:
                continue
            if here > level + plateau and k % every == 0:
                chosen[k] = True
            if (k == a or here >= size[k - 1]) and (k == b - 1 or here >= size[k + 1]):
                chosen[max(k - 1, a)] = chosen[k] = chosen[min(k + 1, b - 1)] = True
        chosen[top] = True
        for k in range(a, b):
            chosen[k] = chosen[k] and np.isfinite(size[k])
            count += chosen[k]
    return count


@compiled
def all_stable(
    L: ComplexArray,
    first: np.ndarray,
    below: ComplexArray,
    first_below: np.ndarray,
    fitted: np.ndarray,
    integrators: np.ndarray,
    unstable: np.ndarray,
) -> bool:
    """Whether the bare count of unstable closed-loop poles is zero for every loop.

    `below` continues the loops below their first lines: a fit's model where `fitted`, else a model that is only asked
    where the first line does not tell how L starts.
    """
    nothing = np.zeros(0, dtype=np.complex128)
    for p in range(first.size - 1):
        mine, before = L[first[p] : first[p + 1]], below[first_below[p] : first_below[p + 1]]
        poles = count_unstable(mine, integrators[p], unstable[p], before if fitted[p] else nothing, 0.0)
        if poles == NO_FIT and before.size and not fitted[p]:
            poles = count_unstable(mine, integrators[p], unstable[p], before, 0.0)
        if poles != 0:
            return False
    return True


@compiled
def thinned(ln_f: Array, ln_P: Array, phase: Array, off: Array, first: np.ndarray, gap: float) -> np.ndarray:
    """Flat lines between which ln P runs straight over ln f to within `off` (nf,), no farther apart than `gap`.

    `phase` (nf,) is that of P, unwrapped. The first and the last line of each loop are kept.
    """
    keep = np.zeros(ln_f.size, dtype=np.bool_)
    for p in range(first.size - 1):
        a, last = first[p], first[p + 1] - 1
        keep[a] = keep[last] = True
        for k in range(first[p] + 2, last + 1):
            straight = ln_f[k] - ln_f[a] <= gap
            if straight:
                rise, turn = (ln_P[k] - ln_P[a]) / (ln_f[k] - ln_f[a]), (phase[k] - phase[a]) / (ln_f[k] - ln_f[a])
                for j in range(a + 1, k):
                    along = ln_f[j] - ln_f[a]
                    miss = abs(ln_P[j] - ln_P[a] - rise * along) + abs(phase[j] - phase[a] - turn * along)
                    if miss > off[j]:
                        straight = False
                        break
            if not straight:
                a = k - 1
                keep[a] = True
    return np.flatnonzero(keep)
