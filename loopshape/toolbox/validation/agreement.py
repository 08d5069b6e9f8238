"""Whether a measured sensitivity agrees with a predicted one, within what both are known to.

With S1 predicted and S2 measured under one controller, S2 - S1 = C S1 S2 (P1 - P2) exactly: a plant that has not
changed leaves the errors of both measurements, and nothing else. Its variance is

    V = |S2/S1|² V1 + |S1/S2|² V2 = |C S1 S2|² (var P1 + var P2),

right beyond first order where the errors of P1 and P2 are the circular ones, because the factor before them is exact.
With estimated variances q = |S2 - S1|²/V is F-distributed with 2 and nu degrees of freedom (nu after Welch and
Satterthwaite), so that x = (nu/2) ln(1 + 2 q/nu) is exponential with mean 1 at every line, whatever nu. Sums of x over
lines are taken as gamma with their mean and variance; neighbours that share error, or share a variance's estimate, make
that variance larger (`line_overlap`, `variance_pooled`).

One sum over all lines and one over each band are combined after Cauchy (Liu and Xie, JASA 115, 2020), which is exact
for independent p-values and close for small ones of dependent parts; p-values near 1 are truncated (Fang, Chang, Park
and Tseng, Statistica Sinica 33, 2023), for variances on the safe side must not hide a band. A gain that changed shows
in the first, a resonance that moved in one of the others.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.special import gammaincc, ndtri

from loopshape.core.errors import WrongUseError
from loopshape.core.units import Array, ComplexArray, db, from_db
from loopshape.data.algebra import regrid
from loopshape.data.response.frf import FRF
from loopshape.loop.tolerances import TOL
from loopshape.toolbox.validation.nouns import Band

#: a band is this wide at least
BAND_OCTAVES = 0.5
#: p-values are truncated to this range before they are combined
LEAST, MOST = 1e-300, 0.99
#: a tolerance beyond this would let everything pass
MOST_DB = 60.0
_NOTHING = ("no frequency is valid in both",)


class Lines(NamedTuple):
    """Sensitivities S1 and S2 (nf,) on common lines, the variance of their difference (nf,), its degrees of freedom
    (nf,) and the share of it (nf,) that is tolerance, and `spread`: the variance of a sum of x over n lines, over n.

    Of two plants they are P1 and P2; `moved` (nf,) is by how much a change of the plant's gain moves either, relative.
    """

    frequency_hz: Array
    predicted: ComplexArray
    measured: ComplexArray
    variance: Array
    freedom: Array
    slack: Array
    spread: float
    moved: ComplexArray

    @property
    def excess(self) -> Array:
        """x (nf,), exponential with mean 1 where nothing has changed."""
        q = np.abs(self.measured - self.predicted) ** 2 / self.variance
        nu = np.minimum(self.freedom, TOL.freedom_known)
        return np.asarray(0.5 * nu * np.log1p(2.0 * q / nu))


def on_common_lines(predicted: FRF, measured: FRF) -> tuple[FRF, FRF, Array, tuple[str, ...]]:
    """Both FRFs (1 x 1) on lines that both trust, what interpolation may have missed (nf,) as a variance, and notes.

    Lines that are there in both are taken as they are. Where fewer than half of the coarser grid's are, the finer one
    is interpolated (`algebra.regrid`), and what a straight line misses of it is counted as an error: the note says so.
    Empty FRFs do not exist: without a common line the arrays have none, and the FRFs are those given.
    """
    if not (predicted.valid.any() and measured.valid.any()):
        return predicted, measured, np.zeros(0), _NOTHING
    ends_hz = [(frf.frequency_hz[0], frf.frequency_hz[-1]) for frf in (predicted, measured)]
    ends = min(low for low, _ in ends_hz), max(high for _, high in ends_hz)
    one, two = (frf.select(_clear_of_the_ends(frf, *ends)) for frf in (predicted, measured))
    low, high = max(one.frequency_hz[0], two.frequency_hz[0]), min(one.frequency_hz[-1], two.frequency_hz[-1])
    inside = [frf.frequency_hz[(frf.frequency_hz >= low) & (frf.frequency_hz <= high)] for frf in (one, two)]
    fewest = min(f.size for f in inside)
    if not fewest:
        return predicted, measured, np.zeros(0), _NOTHING
    rows, columns = _shared(one.frequency_hz, two.frequency_hz)
    if 2 * rows.size >= fewest:
        thinned = [_thinned(frf, k, f.size) for frf, k, f in ((one, rows, inside[0]), (two, columns, inside[1]))]
        return thinned[0], thinned[1], np.zeros(rows.size), ()
    coarse, fine = (two, one) if inside[1].size <= inside[0].size else (one, two)
    at = coarse.frequency_hz[(coarse.frequency_hz >= low) & (coarse.frequency_hz <= high)]
    moved = regrid(fine, at)
    ratio = max(inside[0].size, inside[1].size) / at.size
    moved = replace(moved, line_overlap=max(1.0, fine.line_overlap / ratio))
    kept = coarse.select(np.isin(coarse.frequency_hz, at))
    missed = np.abs(np.interp(at, fine.frequency_hz, _bends(fine.siso))) ** 2
    note = f"lines differ: {'predicted' if fine is one else 'measured'} {moved.notes[-1]}, counted as an error"
    return (moved, kept, missed, (note,)) if fine is one else (kept, moved, missed, (note,))


def _clear_of_the_ends(frf: FRF, lowest_hz: float, highest_hz: float) -> np.ndarray:
    """Mask (nf,) of the valid lines, without those at an end that the errors themselves decided.

    Where the valid band ends before the lines of either FRF do, it ends at the last line whose estimated variance is
    small enough: among lines of about that error this picks those whose variance came out too small (a sixth, with four
    periods). As many lines as share a variance's estimate are left out there, a quarter of the band at most.
    """
    f, mask, rows = frf.frequency_hz, frf.valid.copy(), np.flatnonzero(frf.valid)
    share = min(round(frf.variance_pooled), rows.size // 4) if frf.variance_freedom < TOL.freedom_known else 0
    if share and f[rows[0]] > lowest_hz * (1.0 + 1e-9):
        mask[rows[:share]] = False
    if share and f[rows[-1]] < highest_hz * (1.0 - 1e-9):
        mask[rows[-share:]] = False
    return mask


def _shared(f: Array, g: Array) -> tuple[np.ndarray, np.ndarray]:
    """Numbers of the lines of f and of g that are the same to 1e-9."""
    nearest = np.clip(np.searchsorted(g, f * (1.0 - 1e-9)), 0, g.size - 1)
    rows = np.flatnonzero(np.abs(g[nearest] - f) <= 1e-9 * f)
    return rows, nearest[rows]


def _thinned(frf: FRF, rows: np.ndarray, there: int) -> FRF:
    """Some of an FRF's lines, which share the less error the fewer they are."""
    return replace(frf.select(rows), line_overlap=max(1.0, frf.line_overlap * rows.size / there))


def _bends(S: ComplexArray) -> Array:
    """What a straight line between neighbours may miss at each line: how far lines lie off it, the worst of three.

    That is |second difference|/2, of which a curve that the lines resolve misses a quarter between them; one that they
    do not resolve, all. Where too few lines tell, all of S.
    """
    if S.size < 4:
        return np.abs(S)
    off = np.pad(np.abs(np.diff(S, 2)) / 2.0, 2, mode="edge")
    return np.asarray(np.maximum(np.maximum(off[:-2], off[1:-1]), off[2:]))


def paired(predicted: FRF, measured: FRF, missed: Array, tolerance_db: float = 0.0, plants: bool = False) -> Lines:
    """S1 and S2 on the same lines with the variance of their difference; refuses lines that differ.

    Of `plants` the variance is the sum of both. With `tolerance_db` the first counts as unsure by so much of |S| at
    every line besides: deviations of that rms size are then no contradiction. Refuses one that is not of 0 .. 60 dB.
    """
    if not 0.0 <= tolerance_db <= MOST_DB:
        raise WrongUseError(
            f"a tolerance of |S| is of 0 .. {MOST_DB:g} dB", f"{tolerance_db:g} dB", "give how far off |S| may be"
        )
    f, g = predicted.frequency_hz, measured.frequency_hz
    if f.size != g.size or np.any(np.abs(f - g) > 1e-9 * f):
        raise WrongUseError("sensitivities are compared at the same frequencies", f"{f.size} and {g.size} lines")
    S1, S2 = predicted.siso, measured.siso
    turned = np.ones(f.size) if plants else np.abs(S2 / S1) ** 2
    V1, V2 = turned * predicted.variance[:, 0, 0], measured.variance[:, 0, 0] / turned
    slack = (float(from_db(tolerance_db)) - 1.0) ** 2 * np.abs(S1) ** 2
    total = np.maximum(V1 + V2 + slack + missed, np.finfo(float).tiny)
    n1, n2 = (min(frf.variance_freedom, 10.0 * TOL.freedom_known) for frf in (predicted, measured))
    a1, a2 = float(np.mean(V1 / total)), float(np.mean(V2 / total))
    together = a1 * np.sqrt(predicted.line_overlap) + a2 * np.sqrt(measured.line_overlap) + max(1.0 - a1 - a2, 0.0)
    spread = together**2 + a1**2 * _shared_variance(predicted, n1) + a2**2 * _shared_variance(measured, n2)
    with np.errstate(divide="ignore", over="ignore"):
        freedom = np.minimum(total**2 / np.maximum(V1**2 / n1 + V2**2 / n2, 1e-300), 10.0 * TOL.freedom_known)
    return Lines(f, S1, S2, total, freedom, slack / total, float(spread), S1 if plants else S1 * (1.0 - S1))


def _shared_variance(frf: FRF, freedom: float) -> float:
    """What neighbours that share a variance's estimate add to the variance of a sum over n lines, over n."""
    return 2.0 * (max(float(frf.variance_pooled), frf.line_overlap) - 1.0) / freedom


def tail(x: Array, spread: float) -> float:
    """Probability that n values, exponential and correlated so that their sum varies by n `spread`, sum to more."""
    return float(gammaincc(x.size / spread, x.sum() / spread))


def bands_of(lines: Lines) -> list[slice]:
    """Neighbouring lines in bands of half an octave at least, each with four independent lines at least."""
    f, least = lines.frequency_hz, max(int(np.ceil(TOL.band_lines * lines.spread)), 1)
    starts = [0]
    for k in range(1, f.size):
        if k - starts[-1] >= least and f[k] >= f[starts[-1]] * 2.0**BAND_OCTAVES and f.size - k >= least:
            starts.append(k)
    if len(starts) > 1 and f[-1] < f[starts[-1]] * 2.0 ** (0.5 * BAND_OCTAVES):
        starts.pop()
    return [slice(a, b) for a, b in zip(starts, [*starts[1:], f.size], strict=True)]


def tested(lines: Lines) -> tuple[float, tuple[Band, ...]]:
    """p-value that nothing but both measurements' errors lies between S1 and S2, and each band's."""
    x = lines.excess
    bands = tuple(_band(lines, x, rows) for rows in bands_of(lines))
    parts = np.array([tail(x, lines.spread), *(band.p_value for band in bands)])
    weights = np.array([0.5, *(0.5 / len(bands) for _ in bands)])
    return combined(parts, weights), bands


def combined(p_values: Array, weights: Array) -> float:
    """One p-value from several, not necessarily independent, with weights that sum to 1; after Cauchy, truncated."""
    p = np.clip(p_values, LEAST, MOST)
    small = p < 1e-8  # tan loses its digits there, where it is 1/(pi p)
    terms = np.where(small, 1.0 / (np.pi * p), np.tan((0.5 - np.where(small, 0.5, p)) * np.pi))
    total = float(weights @ terms)
    return 1.0 / (np.pi * total) if total > 1e8 else float(0.5 - np.arctan(total) / np.pi)


def _band(lines: Lines, x: Array, rows: slice) -> Band:
    f, S1, S2, V = lines.frequency_hz[rows], lines.predicted[rows], lines.measured[rows], lines.variance[rows]
    sensitivity, std = _mean_ratio_db(S1, S2, V, lines.spread)
    complementary, _ = _mean_ratio_db(1.0 - S1, 1.0 - S2, V, lines.spread)
    p = tail(x[rows], lines.spread)
    return Band(float(f[0]), float(f[-1]), f.size, p, sensitivity, complementary, std)


def _mean_ratio_db(one: ComplexArray, two: ComplexArray, variance: Array, spread: float) -> tuple[float, float]:
    """Mean of |two/one| in dB, each line with its weight, and its standard deviation."""
    weight = np.abs(one) ** 2 / variance
    with np.errstate(divide="ignore"):
        mean = float(weight @ np.log(np.maximum(np.abs(two), 1e-300) / np.maximum(np.abs(one), 1e-300)) / weight.sum())
    return float(db(np.exp(mean))), float(db(np.exp(np.sqrt(0.5 * spread / weight.sum()))))


def noticed_db(lines: Lines, level: float) -> float:
    """The change of the plant's gain, in dB, that the sum over all lines or over a band would notice 4 times in 5.

    A small change e of the gain moves S by -S T e. Normal approximation of the sums, each at its share of the level;
    what a tolerance takes must be overcome first.
    """
    bands = bands_of(lines)
    parts = [(slice(None), 0.5 * level), *((rows, 0.5 * level / len(bands)) for rows in bands)]
    return float(db(1.0 + np.sqrt(min(_noticed(lines, rows, share) for rows, share in parts))))


def _noticed(lines: Lines, rows: slice, level: float) -> float:
    """The square of the relative change of the gain that a sum over some lines notices."""
    moved, V = lines.moved[rows], lines.variance[rows]
    per = float(np.sum(np.abs(moved) ** 2 / V))
    wanted = float(ndtri(TOL.power) - ndtri(level)) * np.sqrt(lines.spread * V.size) + float(lines.slack[rows].sum())
    return wanted / max(per, 1e-300)
