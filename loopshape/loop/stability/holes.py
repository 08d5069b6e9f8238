"""Where the lines of a loop leave out too much to be called a measurement: few lines, and wide holes between them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from loopshape.core.units import Array, ComplexArray
from loopshape.data.response.frf import FRF
from loopshape.data.response.frf_arrays import channel_scales
from loopshape.identify import tolerances as estimates
from loopshape.identify.spectra.averages import pooled_variance
from loopshape.loop.loop import Loop, responses, sensitivity
from loopshape.loop.stability.sampling import between_lines
from loopshape.loop.tolerances import TOL

#: fewer lines than this say nothing of what lies between them
FEWEST = 6
#: neighbouring lines may lie this far apart, as a ratio; just above what an even grid's first two lines have
APART = 2.05
#: the known delay of a controller may turn L by so much between neighbouring lines, in cycles
TURN = 0.25
#: L that is smaller than this on both sides of a hole, or larger than its inverse, does not meet -1 within it
FAR = 0.1
#: a gap so many times as wide as the median of this many on either side is a hole, in Hz and in ratio
WIDER, BESIDE = 3.0, 5
#: lines are sparse where those about a gap lie so far apart in the median, in ratio; an even grid's first ones do not
SPARSE = 1.3
#: where lines are missing, or too uncertain, a resonance with so much damping must not be able to encircle -1 unseen
LEAST_DAMPING, POOR_DAMPING = 0.002, 0.005


@dataclass(frozen=True)
class Gap:
    """Two frequencies in Hz between which lines are missing (`missing`) or too uncertain, and the plant at both.

    `residue`, Hz times |P|, is the largest of a resonance between them that the lines about would not show.
    """

    low_hz: float
    high_hz: float
    at_low: complex
    at_high: complex
    residue: float
    missing: bool


def gaps_of(loop: Loop) -> tuple[Gap, ...]:
    """Gaps of a loop's measured lines in which little is known of the plant, whatever its controller."""
    raw = loop.measured
    return _gaps(raw, loop.beyond, loop.unstable_poles is None or loop.unstable_poles > 1)


@lru_cache(maxsize=256)
def _gaps(lines: FRF, beyond: FRF | None, unstable: bool) -> tuple[Gap, ...]:
    f, P, v = lines.frequency_hz, lines.siso, pooled_variance(lines)
    if beyond is not None:
        f, P = np.append(f, beyond.frequency_hz), np.append(P, beyond.siso)
        v = np.append(v, beyond.variance[:, 0, 0])
    if f.size < FEWEST:
        return ()
    missing = _missing(f)
    poor = median_of_five(np.sqrt(v) / np.maximum(np.abs(P), 1e-300)) > TOL.poor_std
    known = np.flatnonzero(~poor)
    little = missing | poor[1:] | poor[:-1]
    little[known[-1] if known.size else 0 :] = False  # above the last line that is known |L| is taken to fall
    gaps = np.flatnonzero(little)
    if not gaps.size:
        return ()
    freedom = max(lines.variance_freedom, estimates.TOL.decided_freedom)
    residue = between_lines(f, P, v, freedom, unstable=unstable).visible_residue.copy()
    residue[[0, -1]] = residue[[1, -2]]  # at the ends no pole is looked for
    return tuple(
        Gap(float(f[k]), float(f[k + 1]), complex(P[k]), complex(P[k + 1]), float(residue[k]), bool(missing[k]))
        for k in gaps
    )


def _missing(f: Array) -> np.ndarray:
    """Gaps (nf - 1,) much wider than those about them, both in Hz and in ratio, and all where lines are `SPARSE`."""
    wide = np.ones(f.size - 1, dtype=bool)
    for gap in (np.diff(f), np.diff(np.log(f))):
        padded = np.pad(gap, BESIDE, constant_values=np.nan)
        about = np.lib.stride_tricks.sliding_window_view(padded, 2 * BESIDE + 1).copy()
        about[:, BESIDE] = np.nan
        usual = np.nanmedian(about, axis=1)
        wide &= gap > WIDER * usual
    return np.asarray(wide | (usual > np.log(SPARSE)))


def median_of_five(values: Array) -> Array:
    """Moving median (nf,) over five lines."""
    return np.asarray(np.median(np.lib.stride_tricks.sliding_window_view(np.pad(values, 2, mode="edge"), 5), axis=1))


class Hidden(NamedTuple):
    """What the lines about each gap (gaps,) leave open: a resonance between them may move L by `moved` at most.

    `room` is the least |1 + L| at both ends, `least` the least |L|.
    """

    ends_hz: Array
    missing: np.ndarray
    moved: Array
    room: Array
    least: Array


def hidden_in(loop: Loop) -> Hidden:
    """What may hide in the gaps of a loop."""
    gaps = gaps_of(loop)
    ends, missing = (
        np.reshape([(x.low_hz, x.high_hz) for x in gaps], (-1, 2)),
        np.array([x.missing for x in gaps], bool),
    )
    C = loop.controller.response(ends.ravel()).reshape(ends.shape)
    L = C * np.reshape([(x.at_low, x.at_high) for x in gaps], (-1, 2))
    width = np.where(missing, LEAST_DAMPING, POOR_DAMPING) * np.sqrt(ends.prod(axis=1))
    moved = np.abs(C).max(axis=1) * np.array([x.residue for x in gaps]) / width
    return Hidden(ends, missing, moved, np.abs(1.0 + L).min(axis=1), np.abs(L).min(axis=1))


def _unseen(loop: Loop) -> tuple[str, tuple[float, float]] | None:
    """Where a resonance might encircle -1 between lines that are missing or too uncertain to show it."""
    hidden = hidden_in(loop)
    hides = np.flatnonzero((hidden.least < 1.0 / FAR) & (hidden.moved > hidden.room))
    return _in_words(hidden.ends_hz, hidden.missing, hides) if hides.size else None


def _in_words(ends: Array, missing: np.ndarray, hides: np.ndarray) -> tuple[str, tuple[float, float]]:
    """The first of the gaps that hide something, and those right after it, in words, and the band to measure."""
    last = first = hides[0]
    for k in hides[1:]:  # one measurement for all that lie within an octave of each other
        last = k if ends[k, 0] <= (1.0 if missing[k] else 2.0) * ends[last, 1] else last
    low, high = float(ends[first, 0]), float(ends[last, 1])
    if missing[first] and last == first:
        words = f"no frequency lies between {low:.4g} and {high:.4g} Hz"
        return f"{words}, and a resonance there might encircle -1 without a trace: measure there", (low, high)
    if missing[first]:
        words = f"the lines between {low:.4g} and {high:.4g} Hz lie too far apart to show a resonance that encircles -1"
        return f"{words}: measure finer there", (low, high)
    words = f"the lines between {low:.4g} and {high:.4g} Hz are too uncertain to show whether L encircles -1 there"
    return f"{words}: measure longer or excite more", (low, high)


@dataclass(frozen=True, eq=False)
class HiddenAmong:
    """What holes between the lines of several loops leave open, (gaps,) each.

    A resonance there moves det(I + L) by `moved` of its size at most, and I + L, in even units, by `spread` of its.
    """

    ends_hz: Array
    moved: Array
    spread: Array


def hidden_among(loops: Loop) -> HiddenAmong | None:
    """What may hide where lines of several loops are missing; None where none are."""
    plant, f = loops.measured, loops.measured.frequency_hz
    gaps = np.flatnonzero(_missing(f)) if f.size >= FEWEST else np.array([], dtype=int)
    if not gaps.size:
        return None
    n = len(loops.controllers)
    residue = np.zeros((gaps.size, n, n))
    for i, k in np.ndindex(n, n):
        variance = np.real(plant.variance[:, i, k])
        known = np.maximum(variance, 1e-20 * np.max(np.abs(plant.response[:, i, k])) ** 2)
        if np.any(known):
            own = between_lines(f, plant.response[:, i, k], known, plant.variance_freedom).visible_residue.copy()
            own[[0, -1]] = own[[1, -2]]  # at the ends no pole is looked for
            residue[:, i, k] = own[gaps]
    ends = np.stack([f[gaps], f[gaps + 1]], axis=1)
    height = residue / (LEAST_DAMPING * np.sqrt(ends.prod(axis=1)))[:, None, None]
    c = responses(loops.controllers, f)
    CS = c[:, :, None] * sensitivity(plant.response * c[:, None, :])
    size = np.maximum(np.abs(CS[gaps]), np.abs(CS[gaps + 1]))
    rows, columns = channel_scales(plant.response)
    even = rows[:, None] * columns
    spread = np.linalg.norm(height * even, axis=(1, 2)) * np.linalg.norm(size / even.T, axis=(1, 2))
    return HiddenAmong(ends, np.einsum("gij,gji->g", height, size), spread)


def hole_among(loops: Loop) -> tuple[str, tuple[float, float]] | None:
    """What is missing between the lines of several loops, in words, and the band in Hz to measure."""
    f = loops.frequency_hz
    if f.size < FEWEST:
        return _too_few(loops)
    size = np.abs(loops.determinant - 1.0)
    wide = np.flatnonzero((f[1:] > APART * f[:-1]) & (np.maximum(size[1:], size[:-1]) > FAR))
    if wide.size:
        return _empty(float(f[wide[0]]), float(f[wide[0] + 1]))
    hidden = hidden_among(loops)
    hides = np.flatnonzero(hidden.moved > 1.0) if hidden is not None else np.array([], dtype=int)
    if hidden is None or not hides.size:
        return None
    return _in_words(hidden.ends_hz, np.ones(len(hidden.moved), dtype=bool), hides)


def _too_few(loop: Loop) -> tuple[str, tuple[float, float]]:
    f = loop.frequency_hz
    words = f"{f.size} frequencies are too few to show what lies between them ({FEWEST} at least)"
    return words, (0.5 * float(f[0]), min(2.0 * float(f[-1]), 0.5 * loop.controllers[0].rate_hz))


def _empty(low: float, high: float) -> tuple[str, tuple[float, float]]:
    return f"no frequency lies between {low:.3g} and {high:.3g} Hz, where L may pass -1: measure there", (low, high)


def hole(loop: Loop) -> tuple[str, tuple[float, float]] | None:
    """What is missing between the lines, in words, and the band in Hz to measure; None where they are dense enough.

    A plant may do anything within a hole an octave wide: where |L| is between 1/10 and 10 on either side a count or a
    margin read across it would be a guess. The delay of the controller's computation is known, and lines that it turns
    through more than a quarter of a cycle from one to the next cannot follow it.
    """
    f, L = loop.frequency_hz, loop.L
    if f.size < FEWEST:
        return _too_few(loop)
    near = _near(L)
    wide = np.flatnonzero((f[1:] > APART * f[:-1]) & near)
    if wide.size:
        return _empty(float(f[wide[0]]), float(f[wide[0] + 1]))
    unseen = _unseen(loop)
    if unseen is not None:
        return unseen
    turned = np.flatnonzero((loop.controller.computation_delay_s * np.diff(f) > TURN) & near)
    if turned.size:
        low, high = float(f[turned[0]]), float(f[turned[-1] + 1])
        words = (
            f"the controller's delay of {loop.controller.computation_delay_s:g} s turns L by"
            f" {360.0 * loop.controller.computation_delay_s * (f[turned[0] + 1] - f[turned[0]]):.0f} deg from one"
        )
        return f"{words} frequency to the next: measure finer, or correct the delay", (low, high)
    return None


def _near(L: ComplexArray) -> np.ndarray:
    """Gaps (nf - 1,) in which L may come near -1 by its size on either side."""
    size = np.abs(L)
    larger, smaller = np.maximum(size[1:], size[:-1]), np.minimum(size[1:], size[:-1])
    return np.asarray((larger > FAR) & (smaller < 1.0 / FAR))
