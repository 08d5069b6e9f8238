"""Closed-loop stability from the data: the Nyquist count with the contour closed.

The count of 1 + L on measured lines alone proves nothing: below the first line an open-loop integrator
carries L along a large arc, above the last one L must have died out. Both ends are closed here, the first
by L ~ 1/s^k with the declared k, and where the data cannot carry the count the answer is "undecided".
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from loopshape.check.crossings import nearest_to_minus_one
from loopshape.check.low_end import judged_lines
from loopshape.loop import Loop
from loopshape.units import ComplexArray, deg

#: between lines 1 + L may turn by this much before the sampling is called too coarse to count, in deg
COARSE_DEG = 135.0
#: without a model L must start this close to the phase of its integrators, in deg
FIT_DEG = 75.0


@dataclass(frozen=True)
class Stability:
    """`stable`, `unstable` or `undecided`, the number of unstable closed-loop poles counted, and why."""

    outcome: str
    unstable_poles: int | None
    reason: str


def closed_loop_stability(loop: Loop) -> Stability:
    """Nyquist's count for a loop (Nyquist 1932): unstable poles = open-loop ones - encirclements of -1.

    Integrators and unstable poles of the plant are the loop's word; a wrong word gives a wrong answer. The
    contour passes integrators on the right. Below the lowest line the loop's model carries it; without one
    L must start within 75 deg of where its integrators and unstable poles put it, at a positive leading gain.
    Undecided where it does not, where L is below 1 at the first line or not yet at the last, where 1 + L
    turns too far between lines, or where -1 lies within the FRF's own 95 % reach.
    """
    L, f = loop.L, loop.frequency_hz
    if loop.integrators is None:
        return Stability(
            "undecided",
            None,
            "the number of integrators of the plant is not known: declare integrators in the requirements' [[loop]],"
            " or fit a model that follows the lines",
        )
    integrators = loop.integrators + loop.controller.integrators()
    if judged_lines(loop) is None:
        reason = (
            f"|L| is {abs(L[0]):.2g} at the first line already, {f[0]:.3g} Hz: the crossover lies lower, measure there"
        )
    else:
        reason = uncountable(loop)
    if reason:
        return Stability("undecided", None, reason)
    below = loop.controller.response(loop.below_hz) * loop.P_below
    poles = count_unstable(L, integrators, loop.unstable_poles, below)
    if poles is None:
        return Stability(
            "undecided",
            None,
            f"the phase of L at the first line ({f[0]:.3g} Hz, {deg(np.angle(L[0])):.0f} deg) does not fit"
            f" {integrators} integrators (the controller's included): fit a model, measure lower, or declare"
            " integrators in the requirements' [[loop]]",
        )
    if poles < 0:
        return Stability("undecided", None, f"{-poles} encirclements too many for {loop.unstable_poles} unstable poles")
    if poles:
        return Stability("unstable", poles, f"{poles} closed-loop poles in the right half plane")
    return Stability("stable", 0, "the encirclements of -1 balance the unstable poles")


def uncountable(loop: Loop) -> str:
    """Why the lines cannot carry a count of encirclements, empty where they can."""
    L, f = loop.L, loop.frequency_hz
    if abs(L[-1]) >= 1.0:
        return f"|L| is still {abs(L[-1]):.2g} at the last line, {f[-1]:.3g} Hz: measure higher"
    again = _comes_up_again(loop)
    if again:
        return again
    distance, where = nearest_to_minus_one(f, L)
    if distance < 1e-3:
        return f"L passes -1 within {distance:.1g} at {where:.3g} Hz"
    steps = np.abs(deg(np.angle((1.0 + L[1:]) / (1.0 + L[:-1]))))
    if steps.size and steps.max() > COARSE_DEG:
        k = int(np.argmax(steps))
        return f"1 + L turns by {steps[k]:.0f} deg between {f[k]:.4g} and {f[k + 1]:.4g} Hz: measure finer there"
    reach = 2.45 * np.abs(loop.C) * np.sqrt(0.5 * loop.plant.variance[:, 0, 0])  # radius of 95 % of a circular error
    unclear = np.flatnonzero(np.abs(1.0 + L) < reach)
    if unclear.size:
        return f"-1 lies within the uncertainty of L at {f[unclear[0]]:.3g} Hz: measure longer or excite more"
    return ""


def _comes_up_again(loop: Loop) -> str:
    """Where |L| reaches 1 above the judged lines, as far as less sure lines there show it."""
    if loop.beyond is None:
        return ""
    f = loop.beyond.frequency_hz
    f = f[f < 0.5 * loop.controller.rate_hz]
    size = np.abs(loop.controller.response(f) * loop.beyond.siso[: f.size])
    if not size.size or size.max() < 1.0:
        return ""
    k = int(np.argmax(size))
    return f"|L| reaches {size[k]:.2g} at {f[k]:.3g} Hz, above the band that is known well: excite more there"


def count_unstable(L: ComplexArray, integrators: int, unstable_poles: int, below: ComplexArray) -> int | None:
    """Closed-loop poles in the right half plane by the bare count, None where the first value fits badly.

    `below` (nb,) continues L (nf,) towards zero frequency. It looks at no uncertainty and trusts the
    sampling. With P unstable open-loop poles and k integrators, passed on the right, the turn of 1 + L over
    s = j0+ ... j inf is pi (P + k/2 - Z) for Z unstable closed-loop poles.
    """
    path = 1.0 + np.concatenate([below, L])
    start = _turn_to_first(complex(path[0]) - 1.0, integrators, unstable_poles % 2 == 1, below.size > 0)
    if start is None:
        return None
    turn = start + float(np.sum(np.angle(path[1:] / path[:-1]))) - float(np.angle(path[-1]))
    return round(unstable_poles + 0.5 * integrators - turn / np.pi)


def _turn_to_first(first: complex, integrators: int, negative: bool, either_sign: bool) -> float | None:
    """Angle in rad that 1 + L turns from s = j0+ to L = `first`, None where the phase there fits badly.

    With k integrators L starts infinite at -90 k deg, swings to the phase of `first` and shrinks along it as
    f^-k; without any it starts on the real axis. A stable plant is taken to have a positive gain there, one
    with an odd number of unstable poles a `negative` one (as k/(s - a) has); close to zero frequency, where
    a model leads, the sign is read off.
    """
    ahead = first * 1j**integrators
    if either_sign:
        negative = ahead.real < 0.0
    swing = float(np.angle(-ahead if negative else ahead))
    if abs(deg(swing)) > FIT_DEG:
        return None
    if integrators:
        return swing + float(np.angle((1.0 + first) / first))
    if negative and not either_sign and first.real > -1.0:
        return None
    return float(np.angle(1.0 + first)) - (np.pi if first.real < -1.0 else 0.0) * float(np.sign(first.imag or 1.0))
