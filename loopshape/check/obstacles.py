"""What keeps the lines of a loop from carrying a count of encirclements, and the band to measure for it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from loopshape.check.between import bulges, curves_of, turns_of_controller, turns_of_curves, turns_past
from loopshape.check.crossings import chords_to_minus_one
from loopshape.check.doubt import chance_of_error, reach_of
from loopshape.check.holes import hole
from loopshape.check.sampling import SHARPEST, HiddenPole, hidden_poles, roughness, visible_residue
from loopshape.estimate.pooling import FREEDOM, pooled_variance
from loopshape.frf import FRF
from loopshape.loop import Loop
from loopshape.units import Array, ComplexArray, deg

#: between lines 1 + L may turn by this much before the sampling is called too coarse to count, in deg
COARSE_DEG = 135.0
#: a count is not given where the chance that the lines' errors make it wrong is above this
WRONG = 0.005
#: radius of 95 % of a circular error, in sqrt E|d|²
REACH_95 = float(np.sqrt(-np.log(0.05)))
#: a band to measure goes on beyond the lines in question by this factor
ASIDE = 1.05
#: the peak of a resonance a sixth of a gap wide is so many times its tails on the lines beside it
TAILS = 3.0
#: nearer to -1 than this a chord says nothing
ON_IT = 1e-3


@dataclass(frozen=True)
class Obstacle:
    """Why a count cannot be given, and the band in Hz to measure, None where measuring does not help."""

    reason: str
    band_hz: tuple[float, float] | None = None


@dataclass(frozen=True, eq=False)
class Sampling:
    """What lies between lines: whole turns of 1 + L that their chords leave out, and gaps (nf - 1,) where a path was
    followed past a resonance.

    `unclear` is the first gap where the lines allow several answers, None where there is none.
    """

    turns: int
    followed: np.ndarray
    unclear: Obstacle | None


def sampling(loop: Loop) -> Sampling:
    """Turns of 1 + L along curves between lines, and past resonances of plant and controller that lines step over."""
    f, P, L = loop.frequency_hz, measured(loop).siso, loop.L
    if f.size < 2:
        return Sampling(0, np.zeros(0, dtype=bool), None)
    curves = curves_of(loop.controller, f, loop.plant.siso)
    turns, followed, unclear = turns_of_curves(curves), np.zeros(f.size - 1, dtype=bool), None

    def follow(first: int, last: int, left_out: int) -> None:
        turns[first:last] *= followed[first:last]  # a path takes the place of the curves, not of another path
        turns[first] += left_out
        followed[first:last] = True

    for found in turns_of_controller(loop.controller, f, P):
        follow(*found)
    for pole in _hidden(loop):
        first, last, least, most, sure = turns_past(pole, loop.controller, f, P, L)
        follow(first, last, least)
        if (least != most or not sure) and unclear is None:
            unclear = Obstacle(
                f"a resonance between {f[first]:.4g} and {f[last]:.4g} Hz, sharper than the lines, may or may not"
                " encircle -1: measure finer there",
                (float(f[first]), float(f[last])),
            )
    return Sampling(int(turns.sum()), followed, unclear or _rough(loop))


def _rough(loop: Loop) -> Obstacle | None:
    """Gaps about which several resonances between lines, by what they leave of the lines, might encircle -1."""
    f, lines = loop.frequency_hz, measured(loop)
    rough = roughness(f, lines.siso, *_spread(lines), unstable=may_be_oscillatory(loop))
    if not rough.any():
        return None
    g, C = np.abs(1.0 + loop.L), np.abs(loop.C)
    gaps = np.flatnonzero(TAILS * np.maximum(C[1:], C[:-1]) * rough > np.minimum(g[1:], g[:-1]))
    if not gaps.size:
        return None
    low, high = float(f[gaps[0]]), float(f[gaps[-1] + 1])
    reason = (
        f"neither noise nor one resonance explains the lines between {low:.4g} and {high:.4g} Hz: measure finer there"
    )
    return Obstacle(reason, (low, high))


def may_be_oscillatory(loop: Loop) -> bool:
    """Whether a pair of the plant's poles may lie in the right half plane."""
    return loop.unstable_poles is None or loop.unstable_poles > 1


def measured(loop: Loop) -> FRF:
    """The lines as they were measured: what is smoothed over lines does not show what lies between them."""
    return loop.plant if loop.raw is None else loop.raw


def _spread(lines: FRF) -> tuple[Array, float]:
    """Variance (nf,) of lines and its degrees of freedom, pooled where few are known."""
    return pooled_variance(lines), max(lines.variance_freedom, FREEDOM)


def _hidden(loop: Loop) -> tuple[HiddenPole, ...]:
    lines = measured(loop)
    return hidden_poles(lines.frequency_hz, lines.siso, *_spread(lines), unstable=may_be_oscillatory(loop))


def unseen_resonance(loop: Loop) -> tuple[float, float]:
    """Damping below which a resonance between lines could encircle -1 and leave no trace, and where, in Hz.

    Its peak |C r|/w must be |1 + L| at least, and its tails, r/(j (f - f0)), within the noise; where w is more than
    half a gap the lines meet its peak. Not said of the first and the last gap; nan for fewer than ten lines.
    """
    f, lines = loop.frequency_hz, measured(loop)
    residue = visible_residue(f, lines.siso, *_spread(lines), unstable=may_be_oscillatory(loop))
    if not np.isfinite(residue).any():
        return float("nan"), float("nan")
    g, C, middle = np.abs(1.0 + loop.L), np.abs(loop.C), 0.5 * (f[1:] + f[:-1])
    with np.errstate(divide="ignore"):
        width = np.maximum(C[1:], C[:-1]) * residue / np.minimum(g[1:], g[:-1])
    damping = np.where(np.isfinite(residue), np.minimum(width, 0.5 * np.diff(f)), 0.0) / middle
    k = int(np.argmax(damping))
    return max(float(damping[k]), SHARPEST), float(middle[k])


def obstacle(loop: Loop, between: Sampling, before: complex) -> Obstacle | None:
    """The first thing that keeps the lines from carrying a count; 1 + L comes from `before` to the first line."""
    return next((x for x in _obstacles(loop, between, before) if x is not None), None)


def _obstacles(loop: Loop, between: Sampling, before: complex) -> Iterator[Obstacle | None]:
    L, f = loop.L, loop.frequency_hz
    yield _too_short(loop, L, f)
    yield comes_up_again(loop)
    gaps = list(_gaps(loop, between.followed))
    yield gaps[0]
    yield _noise(loop, 1.0 + L, before)
    yield from gaps[1:]
    yield between.unclear
    missing = hole(loop)
    yield None if missing is None else Obstacle(*missing)


def _too_short(loop: Loop, L: ComplexArray, f: Array) -> Obstacle | None:
    if abs(L[-1]) < 1.0:
        return None
    top = min(f[-1] * (2.0 * abs(L[-1])) ** (1.0 / max(slope_at_end(f, L), 1.0)), 0.5 * loop.controller.rate_hz)
    reason = f"|L| is still {abs(L[-1]):.2g} at the last line, {f[-1]:.3g} Hz: measure higher"
    return Obstacle(reason, (float(f[-1]), max(float(top), float(f[-1]))))


def slope_at_end(f: Array, L: ComplexArray) -> float:
    """How steeply |L| falls over the highest lines, 1 for 20 dB a decade; taken as 1 where fewer than three tell."""
    tail = slice(int(np.searchsorted(f, 0.6 * f[-1])), None)
    if f[tail].size < 3:
        return 1.0
    return float(-np.polyfit(np.log(f[tail]), np.log(np.maximum(np.abs(L[tail]), 1e-300)), 1)[0])


def comes_up_again(loop: Loop) -> Obstacle | None:
    """Where |L| reaches 1 above the judged lines, as far as less sure lines there show it."""
    if loop.beyond is None:
        return None
    f = loop.beyond.frequency_hz
    f = f[f < 0.5 * loop.controller.rate_hz]
    size = np.abs(loop.controller.response(f) * loop.beyond.siso[: f.size])
    if not size.size or size.max() < 1.0:
        return None
    k = int(np.argmax(size))
    reason = f"|L| reaches {size[k]:.2g} at {f[k]:.3g} Hz, above the band that is known well: excite more there"
    return Obstacle(reason, _around(f, np.flatnonzero(size >= 1.0)))


def _gaps(loop: Loop, followed: np.ndarray) -> tuple[Obstacle | None, Obstacle | None]:
    """Gaps where L passes -1 too near, and where it turns or bends too much; not where a path was followed."""
    f, L = loop.frequency_hz, loop.L
    if f.size < 2:
        return None, None
    chord, share = chords_to_minus_one(L)
    curves = curves_of(loop.controller, f, loop.plant.siso)
    curve = chords_to_minus_one(curves)[0].min(axis=1)
    near = np.where(followed, np.inf, np.minimum(chord, curve))
    k = int(np.argmin(near))
    at = f[k] + share[k] * (f[k + 1] - f[k])
    on_it = Obstacle(f"L passes -1 within {near[k]:.1g} at {at:.3g} Hz", _gap(f, k)) if near[k] < ON_IT else None
    largest = np.abs(loop.controller.response(f))
    bulge = bulges(f, loop.plant.siso) * np.maximum(largest[1:], largest[:-1])  # the controller is known in between
    return on_it, _unsure_gap(f, L, np.where(followed, np.inf, curve), bulge)


def _unsure_gap(f: Array, L: ComplexArray, curve: Array, bulge: Array) -> Obstacle | None:
    """The gap where L, `curve` (nf - 1,) off -1, turns or bends by `bulge` too much to tell on which side it passes."""
    with np.errstate(divide="ignore", invalid="ignore"):
        steps = np.nan_to_num(np.abs(deg(np.angle((1.0 + L[1:]) / (1.0 + L[:-1])))))
    coarse = np.flatnonzero((steps > COARSE_DEG) & (curve < 2.0 * bulge))
    if coarse.size:
        k = int(coarse[np.argmax(steps[coarse])])
        where = f"{f[k]:.4g} and {f[k + 1]:.4g} Hz"
        return Obstacle(f"1 + L turns by {steps[k]:.0f} deg between {where}: measure finer there", _gap(f, k))
    k = int(np.argmin(curve - bulge))
    if curve[k] > bulge[k]:
        return None
    where = f"{f[k]:.4g} and {f[k + 1]:.4g} Hz"
    return Obstacle(
        f"L bends too much between {where} to tell on which side it passes -1: measure finer there", _gap(f, k)
    )


def _gap(f: Array, k: int) -> tuple[float, float]:
    return float(f[k]), float(f[k + 1])


def _noise(loop: Loop, g: ComplexArray, before: complex) -> Obstacle | None:
    """Lines whose errors may carry L over -1: one whose 95 % circle holds it, or all of them together.

    Where L starts on the real axis, that start is as unsure as the first line.
    """
    f, std = loop.frequency_hz, np.abs(loop.C) * np.sqrt(loop.plant.variance[:, 0, 0])
    freedom = loop.plant.variance_freedom if loop.raw is None else np.inf
    reach = reach_of(g, std, freedom)
    if loop.model is None:
        reach[0] = min(reach[0], float(reach_of(np.array([before]), std[:1], freedom)[0]))
    k = int(np.argmin(reach))
    if reach[k] < REACH_95:
        reason = f"-1 lies within the uncertainty of L at {f[k]:.3g} Hz: measure longer or excite more"
        return Obstacle(reason, _around(f, np.flatnonzero(reach < REACH_95)))
    chance, share = chance_of_error(g, reach, before, 1.0, loop.plant.line_overlap)
    if chance <= WRONG:
        return None
    reason = f"errors of L may carry it over -1 (chance {100.0 * chance:.1g} %): measure longer or excite more"
    return Obstacle(reason, _around(f, np.flatnonzero(share > 0.1 * share.max())))


def _around(f: Array, lines: np.ndarray) -> tuple[float, float]:
    """From the first to the last of some lines in Hz, and a line more on either side or as far as `ASIDE` goes."""
    low, high = f[max(int(lines[0]) - 1, 0)], f[min(int(lines[-1]) + 1, f.size - 1)]
    return float(max(min(low, f[lines[0]] / ASIDE), f[0])), float(min(max(high, f[lines[-1]] * ASIDE), f[-1]))
