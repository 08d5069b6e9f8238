"""Samples of a signal that a sensor or an amplifier spoiled: spikes, clipped peaks.

Each is named by its rows, counted from 0, and times. Steps, square waves, staircases and sharp noise are none of them:
a spike comes back to where it left, far beyond what the signal does elsewhere (cf. Ljung, System Identification,
2nd ed. 1999, 14.2; the limits are ours, set so that Gaussian noise of a million samples shows none).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import reduce

import numpy as np

from loopshape.core.errors import BadSignalError
from loopshape.core.stretches import AT_ONCE, LongSignal, Signal
from loopshape.core.units import Array

#: samples that a spike lasts at most; a longer one is a step there and back
WIDTH = 3
#: a spike's height: over what 98 % of the moves from sample to sample stay below, over the median move, and over the
#: upper quartile of the moves within `AROUND` samples
COMMON, TYPICAL, LOCAL, AROUND = 2.0, 5.0, 3.0, 10
#: a signal of at most so many values is a switched one; of more than the second it is finely resolved
FEW, FINE = 20, 200
#: rows that a sentence names
NAMED = 5


@dataclass(frozen=True, eq=False)
class Fault:
    """Spoiled samples of one signal: `kind` is spikes or saturated; `rows` (k,) rise, counted from 0.

    `size` is the highest spike, the value at which a signal is clipped, in its unit.
    """

    kind: str
    name: str
    rows: np.ndarray
    size: float
    sentence: str


Look = Callable[[Array, float, str, int], "Fault | None"]


def by_stretches(looks: Sequence[Look], signal: Signal, rate_hz: float, name: str) -> list[Fault]:
    """What `looks` (`spikes`, `saturated`) find in a signal (n,); in a long one stretch by stretch, each by itself.

    A long signal is read once for all of them. A fault's sentence is that of the first stretch with it, and says how
    many stretches have it.
    """
    if not isinstance(signal, LongSignal):
        return [fault for look in looks if (fault := look(signal, rate_hz, name, 0)) is not None]
    starts = [max(0, k - 2 * AROUND) for k in range(0, signal.size, AT_ONCE)]
    every: list[list[Fault]] = [[] for _ in looks]
    for start in starts:
        values = signal[start : start + AT_ONCE + 2 * AROUND]
        for look, found in zip(looks, every, strict=True):
            if (fault := look(values, rate_hz, name, start)) is not None:
                found.append(fault)
    return [_together(found, f"{len(found)} of {len(starts)}", rate_hz) for found in every if found]


def _together(found: Sequence[Fault], share: str, rate_hz: float) -> Fault:
    """One fault of several stretches'."""
    rows, size = np.unique(np.concatenate([f.rows for f in found])), max(found, key=lambda f: abs(f.size)).size
    more = f"; so in {share} stretches of {AT_ONCE / rate_hz:.3g} s, this is the first"
    return replace(found[0], rows=rows, size=size, sentence=found[0].sentence + more)


def spikes(values: Array, rate_hz: float, name: str = "the signal", first_row: int = 0) -> Fault | None:
    """Excursions of up to three samples that come back, in a signal (n,) at `rate_hz`; None where there are none.

    Overlooks spikes smaller than twice an ordinary large move of the signal, those in more than about 1 % of the
    samples, and those at the record's very ends. A single sample of a switched signal (at most 20 values) that lands
    on a value where it rests is its own. Impulses that are shorter than four samples by
    intention are taken for spikes. Rows are counted on from `first_row`.
    """
    x = _checked(values, name)
    moves = np.abs(np.diff(x))
    moving = moves[moves > 0.0]
    if x.size < 2 * AROUND or not moving.size:
        return None
    heights = [_heights(x, width) for width in range(1, WIDTH + 1)]
    if np.count_nonzero(moves > max(h.max() for h in heights) / COMMON) > 0.02 * moves.size:
        return None  # that many ordinary moves are larger than half of the largest excursion
    limit = max(COMMON * float(np.quantile(moves, 0.98)), TYPICAL * float(np.median(moving)))
    found = [
        (start, width, float(height[start - 1]))
        for width, height in enumerate(heights, 1)
        for start in (np.flatnonzero(height > limit) + 1).tolist()
        if height[start - 1] > LOCAL * _moves_near(moves, start, width)
    ]
    found = [one for one in found if not _its_own(x, one[0], one[1])]
    if not found:
        return None
    rows = first_row + np.unique(np.concatenate([np.arange(start, start + width) for start, width, _ in found]))
    highest = max(height for *_, height in found)
    words = (
        f"{name} has {_count(rows.size, 'spike sample')} at {_where(rows, rate_hz)}, up to {highest:.3g} beyond both"
        " neighbours: check the cable and the sensor; cut the recording there, or record again"
    )
    return Fault("spikes", name, rows, highest, words)


def _heights(x: Array, width: int) -> Array:
    """How far each stretch of `width` samples, from sample 1 on, lies beyond both of its neighbours."""
    count = x.size - width - 1
    within = [x[1 + k : 1 + k + count] for k in range(width)]
    before, after = x[:count], x[width + 1 :]
    up = reduce(np.minimum, within) - np.maximum(before, after)
    down = np.minimum(before, after) - reduce(np.maximum, within)
    return np.maximum(up, down)


def _moves_near(moves: Array, start: int, width: int) -> float:
    """Upper quartile of the moves around a stretch, its own two ends and what lies between left out."""
    near = np.concatenate(
        [moves[max(0, start - 1 - AROUND) : start - 1], moves[start + width : start + width + AROUND]]
    )
    return float(np.quantile(near, 0.75)) if near.size else 0.0


def _its_own(x: Array, start: int, width: int) -> bool:
    """Whether a switched signal went to a value on which it rests elsewhere."""
    if np.unique(x).size > FEW:
        return False
    there = (x == x[start]).astype(int)
    there[start : start + width] = 0
    return any(b - a > WIDTH for a, b in _runs(there.astype(bool)))


def saturated(values: Array, rate_hz: float, name: str = "the signal", first_row: int = 0) -> Fault | None:
    """Samples of a signal (n,) at `rate_hz` that sit on its largest or smallest value as if clipped; None without any.

    Clipped is a run of three or more at an extreme, into or out of which the signal moves at such a speed that the
    peak it would have made is more than three steps of its resolution; or 2 % of all samples at one extreme, and four
    times as many as at the next value. Signals of at most 200 values pass: coarse converters, staircases, square waves.
    A peak clipped for one or two samples, and a signal that creeps into its limit, are overlooked; one that rests on
    its end stop for 2 % of the time is named. Rows are counted on from `first_row`.
    """
    x = _checked(values, name)
    few = max(1, min(FINE, x.size // 2))
    if np.unique(x[: 20 * FINE]).size <= few and np.unique(x).size <= few:
        return None
    moves = np.abs(np.diff(x))
    step = float(moves[moves > 0.0].min())
    many = x.size > 2 * FINE or np.unique(x).size > FINE
    rows, at = [], 0.0
    # equal extreme samples in a row that are a clipped peak, and share of the samples at an extreme that is one
    # anyway
    clipped, clipped_share = 3, 0.02
    for extreme, following in ((x.max(), x[x < x.max()].max()), (x.min(), x[x > x.min()].min())):
        there = x == extreme
        most, next_most = int(there.sum()), int((x == following).sum())
        # and how many times as many these must be as those one step of the resolution lower: a sine's crest has 2.4
        piled = many and most > clipped_share * x.size and most > 4.0 * next_most
        runs = [run for run in _runs(there) if run[1] - run[0] >= clipped]
        if piled or any(_cut_off(x, *run, step) for run in runs):
            rows.append(first_row + np.flatnonzero(there))
            at = float(extreme)
    if not rows:
        return None
    every = np.sort(np.concatenate(rows))
    both = f"{x.max():g} and {x.min():g}" if len(rows) == 2 else f"{at:g}"
    share = 100.0 * every.size / x.size
    percent = f"{share:.1f}" if share >= 1.0 else f"{share:.2g}"
    words = (
        f"{name} sits at {both} for {percent} % of its samples ({_count(every.size, 'sample')} at"
        f" {_where(every, rate_hz)}): saturated? Cut these rows off, or excite less"
    )
    return Fault("saturated", name, every, at, words)


def _cut_off(x: Array, start: int, end: int, step: float) -> bool:
    """Whether a signal enters or leaves x[start:end] too fast for that to be the top of a smooth peak."""
    speeds = []
    if start >= 2:
        speeds.append(abs(float(x[start - 1] - x[start - 2])))
    if end + 2 <= x.size:
        speeds.append(abs(float(x[end + 1] - x[end])))
    return bool(speeds) and 0.25 * (end - start) * min(speeds) > 3.0 * step and min(speeds) > 1.5 * step


def _checked(values: Array, name: str) -> Array:
    x = np.asarray(values, dtype=float)
    bad = np.flatnonzero(~np.isfinite(x))
    if x.ndim != 1 or bad.size:
        what = f"the first in row {bad[0]}" if bad.size else f"an array of shape {x.shape}"
        raise BadSignalError(f"{name} is no row of numbers", what, "repair the recording or leave it out")
    return x


def _runs(mask: np.ndarray) -> list[tuple[int, int]]:
    """Starts and ends (exclusive) of the runs of True."""
    there = np.flatnonzero(mask)
    if not there.size:
        return []
    gaps = np.flatnonzero(np.diff(there) > 1)
    starts, lasts = there[np.append(0, gaps + 1)], there[np.append(gaps, -1)]
    return list(zip(starts.tolist(), (lasts + 1).tolist(), strict=True))


def _count(n: int, what: str) -> str:
    return f"{n} {what}{'s' * (n != 1)}"


def _where(rows: np.ndarray, rate_hz: float) -> str:
    """The first stretches of rows, from 0, with their times."""
    stretches = np.split(rows, np.flatnonzero(np.diff(rows) > 1) + 1)
    words = [f"{s[0]}-{s[-1]}" if s.size > 1 else f"{s[0]}" for s in stretches[:NAMED]]
    rest = len(stretches) - NAMED
    more = f" and {rest} stretch{'es' * (rest > 1)} more" if rest > 0 else ""
    last = stretches[min(len(stretches), NAMED) - 1][-1]
    return (
        f"row{'s' * (rows.size > 1)} {', '.join(words)} (from {rows[0] / rate_hz:.6g} to {last / rate_hz:.6g} s){more}"
    )
