"""Closed-loop stability from the data: the Nyquist count with the contour closed.

The count of 1 + L on measured lines alone proves nothing: below the first line an open-loop integrator
carries L along a large arc, above the last one L must have died out, and between two of them a resonance may hide.
The ends are closed here, the first by L ~ 1/s^k with the declared k, what lies between the lines is looked for
(`loopshape.loop.stability.sampling`), and where the data cannot carry the count the answer is "undecided".
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from loopshape.core.kernels.loops import encirclements as kernel
from loopshape.core.kernels.loops.encirclements import FIT_DEG as FIT_DEG
from loopshape.core.outcomes import ClosedLoop
from loopshape.core.units import ComplexArray, deg, hz
from loopshape.data.response.model import TransferFunction
from loopshape.identify.smooth.resonances import Phase, resonances
from loopshape.loop.loop import Loop
from loopshape.loop.margin.between import Path, between_lines, path_of
from loopshape.loop.stability.low_end import (
    BELOW_RATIOS,
    below_lines,
    crossover_below,
    feeds_back_positively,
    holds_below,
    in_sight,
    is_large,
    is_told,
    low_hz,
    low_models,
    order_of,
    poles_at_0,
)
from loopshape.loop.stability.obstacles import Sampling, Undecided, obstacles, sampling
from loopshape.loop.tolerances import TOL

UNKNOWN_POLES = (
    "the number of unstable poles of the plant is not known: declare unstable_poles in the requirements' [[loop]], name"
    " the controller of the recorded loop in the map, or fit a model that leaves nothing but noise"
)
#: a zero this near to a pole, as a share of its size, cancels it
SAME = 1e-3
#: where the first line does not show how L starts, measure down to this share of it
LOWER = 0.1


@dataclass(frozen=True)
class Stability:
    """Whether the closed loop is stable, the number of unstable closed-loop poles counted, and why.

    `band_hz` is the band to measure where it is undecided, None where measuring does not help.
    """

    outcome: ClosedLoop
    unstable_poles: int | None
    reason: str
    band_hz: tuple[float, float] | None = None


def closed_loop_stability(loop: Loop) -> Stability:
    """Nyquist's count for a loop (Nyquist 1932): unstable poles = open-loop ones - encirclements of -1.

    Integrators and unstable poles of the plant are the loop's word; a wrong word gives a wrong answer, and where it is
    missing nothing is decided. The
    contour passes integrators on the right. Below the lowest line the loop's model carries it; without one
    L must start within 75 deg of where its integrators and unstable poles put it, at a positive leading gain; at a
    negative one, over a stable plant, the loop is unstable.
    Undecided where it does not, where L is below 1 at the first line or not yet at the last, where 1 + L
    turns or bends too far between lines, where a resonance that hides between them might encircle -1, where -1 lies
    within the FRF's own 95 % reach, or where its errors together make the count wrong with a chance above 0.5 %.
    A resonance whose tails lie below the noise, or one with less damping than 1e-4, is not seen.
    """
    cancelled = hidden_mode(loop)
    if cancelled:
        return Stability(ClosedLoop.UNSTABLE, None, cancelled)
    f, L = loop.frequency_hz, loop.L
    if loop.integrators is None:
        return _undecided(
            "the number of integrators of the plant is not known: declare integrators in the requirements' [[loop]],"
            " or fit a model that follows the measured FRF"
        )
    if loop.unstable_poles is None:
        return _undecided(UNKNOWN_POLES + _sign_of_one(loop))
    if not in_sight(loop):
        reason = (
            f"|L| is {abs(L[0]):.2g} at the lowest frequency, {f[0]:.3g} Hz: the crossover lies lower, measure there"
        )
        return _undecided(reason, crossover_below(loop))
    poles = unstable_count(loop)
    if (isinstance(poles, Undecided) or poles % 2 == 0) and feeds_back_positively(loop):
        return Stability(
            ClosedLoop.UNSTABLE, None,
            f"the feedback is positive: towards 0 Hz L is -k/s^{poles_at_0(loop)}, k > 0 (phase"
            f" {deg(np.angle(L[0])):.0f} deg at {f[0]:.3g} Hz); turn the controller's sign, by a gain of -1",
        )  # fmt: skip
    if isinstance(poles, Undecided):
        return _undecided(poles.reason, poles.band_hz)
    if poles < 0:
        return _undecided(f"{-poles} encirclements too many for {loop.unstable_poles} unstable poles")
    if poles:
        return Stability(ClosedLoop.UNSTABLE, poles, f"{poles} closed-loop poles in the right half plane")
    return Stability(ClosedLoop.STABLE, 0, "the encirclements of -1 balance the unstable poles")


def hidden_mode(loop: Loop) -> str:
    """What of the closed loop L does not show, in words: a pole that a zero cancels on or right of the imaginary axis.

    Poles at s = 0 by the declarations, others by the fit that says how the plant goes on. Empty where there is none.
    """
    plant, own = loop.integrators or 0, [block.integrators() for block in loop.controller.blocks]
    zero_of_plant, zero_of_own = plant < 0, min(own, default=0) < 0
    if max(own, default=0) > 0 and (zero_of_plant or zero_of_own):
        whose = "plant" if zero_of_plant else "controller"
        return (
            f"a zero of the {whose} at 0 Hz cancels the controller's integrator: its output drifts without bound, and L"
            " does not show it; leave the integrator out"
        )
    if plant > 0 and zero_of_own:
        return "a zero of the controller at 0 Hz cancels the plant's integrator: it drifts, and L does not show it"
    poles = np.zeros(0, dtype=complex) if loop.model is None else unstable_or_undamped(loop.model)
    rows = loop.controller.biquads()
    zeros = np.concatenate([np.roots(row[:3]) for row in rows]) if poles.size and len(rows) else np.zeros(0)
    at = poles / loop.controller.rate_hz
    near = np.abs(zeros[:, None] - np.exp(at)[None, :]) <= SAME * np.abs(at)[None, :]
    if not near.any():
        return ""
    f_hz = float(hz(np.abs(poles[near.any(axis=0)][0])))
    return (
        f"a zero of the controller cancels the plant's pole at {f_hz:.4g} Hz, which is not stable: L does not show it"
    )


def unstable_or_undamped(model: TransferFunction) -> ComplexArray:
    """Poles of a model in rad/s on the imaginary axis or right of it, those at 0 left out."""
    poles = model.poles()
    return np.asarray(poles[(poles.real >= -SAME * np.abs(poles)) & (np.abs(poles) > 0.0)])


def _sign_of_one(loop: Loop) -> str:
    """The resonances that look like unstable pole pairs, in words; empty where there is none."""
    rising = [x.frequency_hz for x in resonances(loop.measured) if x.phase is Phase.RISING]
    if not rising:
        return ""
    at = ", ".join(f"{f:.3g}" for f in rising)
    return f"; the phase rises by 180 deg through the resonance at {at} Hz, as through an unstable pair of poles"


def _undecided(reason: str, band_hz: tuple[float, float] | None = None) -> Stability:
    return Stability(ClosedLoop.UNDECIDED, None, reason, band_hz)


def unstable_count(loop: Loop) -> int | Undecided:
    """Closed-loop poles in the right half plane, or what keeps the lines from telling; integrators must be known.

    Negative where the loop's unstable poles are fewer than those that its encirclements would need.
    """
    if loop.unstable_poles is None:
        return Undecided(UNKNOWN_POLES)
    path, below = path_of(loop), _ways_below(loop)
    between = sampling(loop, path)
    poles = _counted(loop, path, between, below)
    found = next(_obstacles(loop, path, between, below, poles), None)
    if found is not None:
        return found
    return _misfit(loop, poles_at_0(loop)) if poles is None else poles


def _counted(loop: Loop, path: Path, between: Sampling, below: list[ComplexArray]) -> int | None:
    """The count along a path, None where its ways below the lines differ or do not fit the integrators."""
    integrators, unstable = poles_at_0(loop), loop.unstable_poles or 0
    ways, near = below or [np.zeros(0, dtype=complex)], 0.0 if below else swing_near(loop)
    counts = {count_unstable(path.L, integrators, unstable, x, near) for x in ways}
    poles = counts.pop() if len(counts) == 1 else None
    return None if poles is None else poles - 2 * between.turns


def obstacles_of(loop: Loop) -> tuple[Undecided, ...]:
    """All that keeps the lines of a loop with known poles from telling, of which `unstable_count` gives the first."""
    if loop.integrators is None or loop.unstable_poles is None:
        return ()
    path, below = path_of(loop), _ways_below(loop)
    between = sampling(loop, path)
    return tuple(_obstacles(loop, path, between, below, _counted(loop, path, between, below)))


def _obstacles(
    loop: Loop, path: Path, between: Sampling, below: list[ComplexArray], poles: int | None
) -> Iterator[Undecided]:
    first = _doubt_below(loop)
    if first is not None:
        yield first
    odd = (loop.unstable_poles or 0) % 2 == 1
    before = _before_first(path.L, poles_at_0(loop), odd, below[0] if below else np.zeros(0, dtype=complex))
    yield from obstacles(loop, path, between, 1.0 + before)
    if not (is_told(loop) or (poles is not None and holds_below(loop, poles))):
        yield _misfit(loop, poles_at_0(loop)) if poles is None else _unknown_below(loop)


def _ways_below(loop: Loop) -> list[ComplexArray]:
    """L below the first line towards 0 Hz, by each model that tells it; none where what lies there does not matter."""
    fitted = [] if loop.model is None else [loop.controller.response(loop.below_hz) * loop.P_below]
    return fitted if is_large(loop) else fitted + below_lines(loop, low_hz(loop))


@lru_cache(maxsize=256)
def swing_near(loop: Loop) -> float:
    """Angle in rad from the phase of L's integrators to that at its first line: the controller's, as it is known.

    And that of poles of a stable plant below the line, -90 deg for each 20 dB a decade by which it falls faster than
    its integrators (Bode 1945).
    """
    C = loop.controller.response(np.append(low_hz(loop), loop.frequency_hz[0]))
    turn = np.unwrap(np.angle(C))
    phase, slope = order_of(loop)
    agree = abs(phase - slope) < TOL.integrators_agree
    more = max(round(slope - (loop.integrators or 0)), 0) if agree and not loop.unstable_poles else 0
    return float(turn[-1] - turn[0] - 0.5 * np.pi * more)


def _doubt_below(loop: Loop) -> Undecided | None:
    """Where the error of a model of the lowest lines may carry L over -1 below them."""
    if is_large(loop):
        return None
    errors = between_lines(loop).deviations if loop.scatter is None else loop.scatter.deviations
    f = float(loop.frequency_hz[0]) * BELOW_RATIOS[1:]
    C = loop.controller.response(f)
    for model in low_models(loop):
        moved = C * model.deviations(f, errors)
        far = np.abs(1.0 + C * model.response(f)) / np.maximum(np.sqrt(np.mean(np.abs(moved) ** 2, axis=0)), 1e-300)
        if far.min() < TOL.radius_95:
            at, first = float(f[np.argmin(far)]), float(loop.frequency_hz[0])
            reason = f"-1 lies within the uncertainty of L at {at:.3g} Hz, below the first frequency, {first:.3g} Hz"
            return Undecided(f"{reason}: measure lower", (at, first))
    return None


def _unknown_below(loop: Loop) -> Undecided:
    f, L = loop.frequency_hz, loop.L
    reason = f"the lowest lines do not tell how L, {abs(L[0]):.2g} at {f[0]:.3g} Hz, goes on below them: measure lower"
    return Undecided(reason, (LOWER * float(f[0]), float(f[0])))


def _misfit(loop: Loop, integrators: int) -> Undecided:
    f, L = loop.frequency_hz, loop.L
    reason = (
        f"the phase of L at the lowest frequency ({f[0]:.3g} Hz, {deg(np.angle(L[0])):.0f} deg) does not fit"
        f" {integrators} integrators (the controller's included): measure lower, or correct the declaration"
    )
    return Undecided(reason, (LOWER * float(f[0]), float(f[0])))


def _before_first(L: ComplexArray, integrators: int, negative: bool, below: ComplexArray) -> complex:
    """Where L (nf,) comes from to the first line: the model's last value, or along the phase of its integrators."""
    if below.size:
        return complex(below[-1])
    if integrators < 0:
        return 0j
    if not integrators:
        return -abs(L[0].real) if negative else abs(L[0].real)
    return 1e3 * (1.0 + abs(complex(L[0]))) * (-1j) ** integrators * (-1.0 if negative else 1.0)


def count_unstable(
    L: ComplexArray, integrators: int, unstable_poles: int, below: ComplexArray, near: float = 0.0
) -> int | None:
    """Closed-loop poles in the right half plane by the bare count, None where the first value fits badly.

    `below` (nb,) continues L (nf,) towards zero frequency, `near` is what `swing_near` tells. It looks at no
    uncertainty and trusts the sampling. With P unstable open-loop poles and k integrators, passed on the right, the
    turn of 1 + L over s = j0+ ... j inf is pi (P + k/2 - Z) for Z unstable closed-loop poles.
    """
    poles = kernel.count_unstable(
        np.ascontiguousarray(L), integrators, unstable_poles, np.asarray(below, dtype=complex), near
    )
    return None if poles == kernel.NO_FIT else poles
