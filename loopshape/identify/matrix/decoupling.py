"""Verdicts by band on |k_I| against a limit, with what would decide those that the data leave open."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from scipy.stats import norm

from loopshape.core.errors import WrongUseError
from loopshape.core.units import db, from_db
from loopshape.data.response.frf import FRF
from loopshape.data.response.interaction import BandVerdict
from loopshape.identify.matrix.loop_pair import LoopPair
from loopshape.identify.matrix.magnitude_bounds import TAIL, Reach

Bands = Sequence[tuple[float, float]]

#: ratio of frequencies over which no valid frequency leaves a hole in a band
HOLE = 1.1
_MORE = np.geomspace(1.1, 1000.0, 40)  # times the averages that are tried


def octaves(frf: FRF) -> tuple[tuple[float, float], ...]:
    """Octaves between whole powers of two Hz, cut to the valid band; refuses a FRF without one."""
    low, high = frf.trusted_lines().trusted_band_hz
    whole = 2.0 ** np.arange(np.floor(np.log2(low)) + 1.0, np.ceil(np.log2(high)))
    edges = [low, *whole[(whole > low) & (whole < high)].tolist(), high]
    return tuple(pairwise(edges))


def band_verdicts(pair: LoopPair, loops: tuple[str, str], limit_db: float, bands: Bands) -> tuple[BandVerdict, ...]:
    """A verdict on each closed band in Hz; refuses bands that do not rise.

    decoupled: every valid frequency's upper 95 % bound is below the limit. That all must pass makes the test stricter,
    not looser, so no correction is needed. coupled: some line's lower bound is above it, with the probability 2.5 %
    beyond it shared by all n lines, 1 - 0.975^(1/n) each (Sidak): chance alone then finds one in 2.5 % of bands.
    n is not divided by `line_overlap`: the largest of n errors that overlap by two lines is hardly smaller than of n
    that do not, and dividing would find couplings that are none.
    """
    for low, high in bands:
        if not 0.0 <= low < high:
            raise WrongUseError("a band has two rising frequencies in Hz", f"{low:g} to {high:g}", "write 0.5-4")
    return tuple(_verdict(pair, loops, limit_db, (float(low), float(high))) for low, high in bands)


def _verdict(pair: LoopPair, loops: tuple[str, str], limit_db: float, band: tuple[float, float]) -> BandVerdict:
    f = pair.frequency_hz
    lines = np.flatnonzero(pair.trusted & (f >= band[0]) & (f <= band[1]))
    if not lines.size:
        return BandVerdict(loops, band, "undecided", limit_db, 0, averages_factor=float("inf"), hole_hz=band)
    limit = float(from_db(limit_db))
    hole = _hole(pair, lines, band)
    word, coupled = _word(pair, lines, limit, 1.0)
    if word == "decoupled" and hole is not None:
        word = "undecided"
    low, high = pair.bounds(lines)
    if word == "coupled":
        low = pair.bounds(lines, _shared_tail(lines.size)).low
    k = int(np.argmax(low if word == "coupled" else high))
    factor = _more_averages(pair, lines, limit) if word == "undecided" and hole is None else 1.0
    return BandVerdict(
        loops, band, word, limit_db, int(lines.size), float(f[lines[k]]), float(db(low[k])),
        float(db(pair.coefficient[lines[k]])), float(db(high[k])), tuple(f[lines[coupled]].tolist()), hole, factor,
    )  # fmt: skip


def _shared_tail(lines: int) -> float:
    return float(-np.expm1(np.log1p(-TAIL) / lines))


def _word(pair: LoopPair, lines: np.ndarray, limit: float, more: float) -> tuple[str, np.ndarray]:
    """Verdict on some lines, and which of them are coupled, of so many times the averages."""
    if np.all(_expected(pair, lines, TAIL, more).high < limit):
        return "decoupled", np.zeros(lines.size, dtype=bool)
    coupled = _expected(pair, lines, _shared_tail(lines.size), more).low > limit
    return ("coupled" if coupled.any() else "undecided"), coupled


def _expected(pair: LoopPair, lines: np.ndarray, tail: float, more: float) -> Reach:
    """Ends of |k_I|; of more averages those to be expected if the plant is as estimated, less luck.

    The largest of n estimates is too high by what the largest of n errors is in the median; averages take that away.
    """
    reach = pair.bounds(lines, tail, more)
    luck = norm.ppf(0.5 ** (1.0 / max(lines.size / pair.line_overlap, 1.0)))
    spread = np.minimum(pair.relative_std[lines] / np.sqrt(2.0), 1.0)
    factor = np.exp(-luck * spread * (1.0 - 1.0 / np.sqrt(more)))
    return Reach(reach.low * factor, reach.high * factor)


def _more_averages(pair: LoopPair, lines: np.ndarray, limit: float) -> float:
    """By how much the averages must grow to decide, roughly; infinite beyond a thousand."""
    for more in _MORE:
        if _word(pair, lines, limit, float(more))[0] != "undecided":
            return float(more)
    return float("inf")


def _hole(pair: LoopPair, lines: np.ndarray, band: tuple[float, float]) -> tuple[float, float] | None:
    """Widest stretch (by ratio) of a band that valid frequencies leave out; None where neighbours follow each other."""
    f, last = pair.frequency_hz, pair.frequency_hz.size - 1
    gaps = [(float(f[a]), float(f[b])) for a, b in pairwise(lines) if b > a + 1]
    first, end = int(lines[0]), int(lines[-1])
    if first == 0 or f[first - 1] >= band[0]:
        gaps.append((band[0], float(f[first])))
    if end == last or f[end + 1] <= band[1]:
        gaps.append((float(f[end]), band[1]))
    wide = [gap for gap in gaps if gap[1] > HOLE * gap[0]]
    return max(wide, key=lambda gap: gap[1] / max(gap[0], 1e-12)) if wide else None
