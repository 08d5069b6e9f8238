"""Closed-loop stability from the data: the Nyquist count with the contour closed.

The count of 1 + L on measured lines alone proves nothing: below the first line an open-loop integrator
carries L along a large arc, above the last one L must have died out, and between two of them a resonance may hide.
The ends are closed here, the first by L ~ 1/s^k with the declared k, what lies between the lines is looked for
(`loopshape.loop.sampling`), and where the data cannot carry the count the answer is "undecided".
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from loopshape.core.kernels import encirclements as kernel
from loopshape.core.kernels.encirclements import FIT_DEG as FIT_DEG
from loopshape.core.units import ComplexArray, deg
from loopshape.data.loop import Loop
from loopshape.identify.resonances import Phase, resonances
from loopshape.loop.between import measured, path_of
from loopshape.loop.low_end import crossover_below, judged_lines, low_hz, low_models
from loopshape.loop.obstacles import Obstacle, obstacle, sampling, unseen_resonance

UNKNOWN_POLES = (
    "the number of unstable poles of the plant is not known: declare unstable_poles in the requirements' [[loop]], name"
    " the controller of the recorded loop in the map, or fit a model that leaves nothing but noise"
)
#: where the first line does not show how L starts, measure down to this share of it
LOWER = 0.1


@dataclass(frozen=True)
class Stability:
    """`stable`, `unstable` or `undecided`, the number of unstable closed-loop poles counted, and why.

    `band_hz` is the band to measure where it is undecided, None where measuring does not help. Where it is decided, a
    resonance between lines with less damping than `unseen_damping` could, at `unseen_at_hz` first, change the count and
    leave no trace on them.
    """

    outcome: str
    unstable_poles: int | None
    reason: str
    band_hz: tuple[float, float] | None = None
    unseen_damping: float = float("nan")
    unseen_at_hz: float = float("nan")


def closed_loop_stability(loop: Loop) -> Stability:
    """Nyquist's count for a loop (Nyquist 1932): unstable poles = open-loop ones - encirclements of -1.

    Integrators and unstable poles of the plant are the loop's word; a wrong word gives a wrong answer, and where it is
    missing nothing is decided. The
    contour passes integrators on the right. Below the lowest line the loop's model carries it; without one
    L must start within 75 deg of where its integrators and unstable poles put it, at a positive leading gain.
    Undecided where it does not, where L is below 1 at the first line or not yet at the last, where 1 + L
    turns or bends too far between lines, where a resonance that hides between them might encircle -1, where -1 lies
    within the FRF's own 95 % reach, or where its errors together make the count wrong with a chance above 0.5 %.
    A resonance whose tails lie below the noise (`unseen_damping`), or one with less damping than 1e-4, is not seen.
    """
    f, L = loop.frequency_hz, loop.L
    if loop.integrators is None:
        return _undecided(
            "the number of integrators of the plant is not known: declare integrators in the requirements' [[loop]],"
            " or fit a model that follows the measured FRF"
        )
    if loop.unstable_poles is None:
        return _undecided(UNKNOWN_POLES + _sign_of_one(loop))
    if judged_lines(loop) is None:
        reason = (
            f"|L| is {abs(L[0]):.2g} at the lowest frequency, {f[0]:.3g} Hz: the crossover lies lower, measure there"
        )
        return _undecided(reason, crossover_below(loop))
    poles = unstable_count(loop)
    if isinstance(poles, Obstacle):
        return _undecided(poles.reason, poles.band_hz)
    if poles < 0:
        return _undecided(f"{-poles} encirclements too many for {loop.unstable_poles} unstable poles")
    unseen = unseen_resonance(loop)
    if poles:
        return Stability("unstable", poles, f"{poles} closed-loop poles in the right half plane", None, *unseen)
    return Stability("stable", 0, "the encirclements of -1 balance the unstable poles", None, *unseen)


def _sign_of_one(loop: Loop) -> str:
    """The resonances that look like unstable pole pairs, in words; empty where there is none."""
    rising = [x.frequency_hz for x in resonances(measured(loop)) if x.phase is Phase.RISING]
    if not rising:
        return ""
    at = ", ".join(f"{f:.3g}" for f in rising)
    return f"; the phase rises by 180 deg through the resonance at {at} Hz, as through an unstable pair of poles"


def _undecided(reason: str, band_hz: tuple[float, float] | None = None) -> Stability:
    return Stability("undecided", None, reason, band_hz)


def unstable_count(loop: Loop) -> int | Obstacle:
    """Closed-loop poles in the right half plane, or what keeps the lines from telling; integrators must be known.

    Negative where the loop's unstable poles are fewer than those that its encirclements would need.
    """
    if loop.unstable_poles is None:
        return Obstacle(UNKNOWN_POLES)
    integrators = (loop.integrators or 0) + loop.controller.integrators()
    path = path_of(loop)
    between = sampling(loop, path)
    below = loop.controller.response(loop.below_hz) * loop.P_below
    odd = loop.unstable_poles % 2 == 1
    found = obstacle(loop, path, between, 1.0 + _before_first(path.L, integrators, odd, below))
    if found is not None:
        return found
    poles = count_unstable(path.L, integrators, loop.unstable_poles, below)
    if poles is None:
        poles = _count_by_low_models(loop, path.L, integrators)
    return _misfit(loop, integrators) if poles is None else poles - 2 * between.turns


def _count_by_low_models(loop: Loop, L: ComplexArray, integrators: int) -> int | None:
    """The count along L (n,) with each small model of the lowest lines; None where there is none or two differ."""
    f = low_hz(loop)
    C, unstable = loop.controller.response(f), loop.unstable_poles or 0
    models = () if loop.model is not None else low_models(loop)
    counts = {count_unstable(L, integrators, unstable, C * model.response(f)) for model in models}
    return counts.pop() if len(counts) == 1 else None


def _misfit(loop: Loop, integrators: int) -> Obstacle:
    f, L = loop.frequency_hz, loop.L
    reason = (
        f"the phase of L at the lowest frequency ({f[0]:.3g} Hz, {deg(np.angle(L[0])):.0f} deg) does not fit"
        f" {integrators} integrators (the controller's included): fit a model, measure lower, or declare"
        " integrators in the requirements' [[loop]]"
    )
    return Obstacle(reason, (LOWER * float(f[0]), float(f[0])))


def _before_first(L: ComplexArray, integrators: int, negative: bool, below: ComplexArray) -> complex:
    """Where L (nf,) comes from to the first line: the model's last value, or along the phase of its integrators."""
    if below.size:
        return complex(below[-1])
    if integrators < 0:
        return 0j
    if not integrators:
        return -abs(L[0].real) if negative else abs(L[0].real)
    return 1e3 * (1.0 + abs(complex(L[0]))) * (-1j) ** integrators * (-1.0 if negative else 1.0)


def count_unstable(L: ComplexArray, integrators: int, unstable_poles: int, below: ComplexArray) -> int | None:
    """Closed-loop poles in the right half plane by the bare count, None where the first value fits badly.

    `below` (nb,) continues L (nf,) towards zero frequency. It looks at no uncertainty and trusts the
    sampling. With P unstable open-loop poles and k integrators, passed on the right, the turn of 1 + L over
    s = j0+ ... j inf is pi (P + k/2 - Z) for Z unstable closed-loop poles.
    """
    poles = kernel.count_unstable(
        np.ascontiguousarray(L), integrators, unstable_poles, np.asarray(below, dtype=complex)
    )
    return None if poles == kernel.NO_FIT else poles
