"""The low end of several loops: how det(I + L) goes on below the first line, and whether the lines there tell it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from loopshape.core.units import Array, ComplexArray, deg
from loopshape.data.control.loop import Loop, characteristic_loci
from loopshape.loop.stability.obstacles import Undecided

#: the lowest lines, this ratio of frequencies and four at least, tell the slope there
LOWEST = 1.6
#: phase and slope of the lowest lines that may be left beside the integrators, and how much more for each further loop
FIT_DEG, FIT_SLOPE, MORE = 75.0, 0.75, 0.3
#: without a declaration the slope must be this near to a whole number of integrators, a loop
READ_SLOPE = 0.25
#: a locus below 1 at the first line must not fall faster than this, as a power of frequency, nor all such det(I + L)
FLAT, FLAT_DEG = -0.3, 30.0


class LowEnd(NamedTuple):
    """What the lowest lines say: phase of det(I + L)'s part that rules there, its slope, which loci are large.

    `phase_deg` is on the branch nearest to 90 deg times `slope`, plus 180 deg where det(I + L) starts `negative`;
    that is None where the phase lies between the two. `rest_rad` leads on from there to det(I + L) itself.
    """

    slope: float
    phase_deg: float
    negative: bool | None
    large: np.ndarray
    rest_rad: float


def low_end(f: Array, loci: ComplexArray) -> LowEnd:
    """The lowest lines of characteristic loci (nf, n).

    Loci of size 1 and above rule det(I + L) there by themselves, those below 1 by 1 + lambda.
    """
    count = _lowest(f)
    large = np.abs(loci[0]) >= 1.0
    large |= _mirrored(loci[0], large)
    part = np.where(large, loci[:count], 1.0 + loci[:count])
    size = np.log(np.maximum(np.abs(part), 1e-300)).sum(axis=1)
    slope = float(np.polyfit(np.log(f[:count]), size, 1)[0]) if count > 1 else 0.0
    phase = float(deg(np.angle(part[0])).sum())
    away = _wrapped(phase - 90.0 * slope)
    negative = False if abs(away) <= FIT_DEG else True if abs(away) >= 180.0 - FIT_DEG else None
    branch = 90.0 * slope + (180.0 + _wrapped(away - 180.0) if negative else away)
    first = loci[0][large]
    return LowEnd(slope, branch, negative, large, float(np.angle((1.0 + first) / first).sum()))


def slopes(f: Array, loci: ComplexArray) -> Array:
    """d ln|lambda|/d ln f (n,) of each locus (nf, n) over the lowest lines."""
    count = _lowest(f)
    size = np.log(np.maximum(np.abs(loci[:count]), 1e-300))
    return np.asarray(np.polyfit(np.log(f[:count]), size, 1)[0] if count > 1 else np.zeros(loci.shape[1]))


def _mirrored(first: ComplexArray, large: np.ndarray) -> np.ndarray:
    """Values (n,) that are about the conjugates of large ones: a real plant's pair at low frequency counts as one.

    Not those on the real axis between -1 and 0, of which each is its own.
    """
    pairs = np.abs(first[:, None] - first[None, :].conj()) < 0.1 * np.abs(first)[:, None]
    with np.errstate(divide="ignore", invalid="ignore"):
        apart = np.abs(deg(np.angle((1.0 + first) / first))) < 120.0
    return np.asarray((pairs & large[None, :]).any(axis=1) & apart)


def _wrapped(angle_deg: float) -> float:
    return (angle_deg + 180.0) % 360.0 - 180.0


def read_integrators(loops: Loop) -> tuple[int | None, str]:
    """Integrators of the whole plant by the slope of the lowest lines, None where it is not near a whole number."""
    low = low_end(loops.frequency_hz, characteristic_loci(loops.L_i))
    own = loops.controller_integrators()
    every = round(-low.slope)
    if abs(every + low.slope) > READ_SLOPE * max(int(low.large.sum()), 1) or low.negative is None or every < own:
        return None, f"det(I + L) falls as with {-low.slope:.1f} integrators over its lowest frequencies, {own} of C's"
    word = "integrator" if every - own == 1 else "integrators"
    return every - own, f"plant taken to have {every - own} {word} in all, from the lowest frequencies of det(I + L)"


def low_doubt(loops: Loop, loci: ComplexArray, low: LowEnd) -> Undecided | None:
    """Why the lowest lines do not tell how det(I + L) goes on below them, None where they do."""
    f = loops.frequency_hz
    lower = (0.1 * float(f[0]), float(f[0]))
    if loops.integrators is None:
        way_out = "declare integrators of the whole plant in the requirements' [several]"
        return Undecided(f"the number of integrators of the plant is not known: {way_out}")
    small = _small_doubt(f, loci, low)
    if small is not None:
        return small
    own = loops.controller_integrators()
    every, more = loops.integrators + own, 1.0 + MORE * max(int(low.large.sum()) - 1, 0)
    swing = low.phase_deg + 90.0 * every - (180.0 if low.negative else 0.0)
    if low.negative is None or abs(swing) > FIT_DEG * more or abs(low.slope + every) > FIT_SLOPE * more:
        reason = (
            f"slope ({20.0 * low.slope:.0f} dB a decade) and phase ({low.phase_deg:.0f} deg) of det(I + L) at the first"
            f" lines ({f[0]:.3g} Hz) do not fit {every} integrators ({own} of them the controllers')"
        )
        return Undecided(f"{reason}: measure lower, or declare integrators of the whole plant", lower)
    return None


def _small_doubt(f: Array, loci: ComplexArray, low: LowEnd) -> Undecided | None:
    """Loci below 1 at the first line that may have been above it lower down, or that are near -1."""
    for k in np.flatnonzero(~low.large):
        first = loci[0, k]
        size = f"an eigenvalue of L is {abs(first):.2g} at the lowest frequency already, {f[0]:.3g} Hz"
        slope = slopes(f, loci)[k]
        if slope < FLAT:
            from_hz = float(f[0] * (0.5 * abs(first)) ** (1.0 / max(-slope, 1.0)))
            return Undecided(f"{size}, and falls: its crossover lies lower, measure there", (from_hz, float(f[0])))
    turned = float(deg(np.angle(1.0 + loci[0, ~low.large])).sum())
    if abs(turned) > FLAT_DEG:
        reason = f"eigenvalues of L below 1 turn det(I + L) by {turned:.0f} deg at the lowest frequency, {f[0]:.3g} Hz"
        return Undecided(f"{reason}: measure lower", (0.1 * float(f[0]), float(f[0])))
    return None


def _lowest(f: Array) -> int:
    return min(max(4, int(np.searchsorted(f, LOWEST * f[0]))), f.size)
