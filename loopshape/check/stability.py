"""Closed-loop stability from the data: the Nyquist count with the contour closed.

The count of 1 + L on measured lines alone proves nothing: below the first line an open-loop integrator
carries L along a large arc, above the last one L must have died out. Both ends are closed here, the first
by L ~ 1/s^k with the declared k, and where the data cannot carry the count the answer is "undecided".
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from loopshape.check.crossings import nearest_to_minus_one
from loopshape.loop import Loop
from loopshape.units import Array, ComplexArray, deg

#: between lines 1 + L may turn by this much before the sampling is called too coarse to count, in deg
COARSE_DEG = 135.0


@dataclass(frozen=True)
class Stability:
    """`stable`, `unstable` or `undecided`, the number of unstable closed-loop poles counted, and why."""

    outcome: str
    unstable_poles: int | None
    reason: str


def closed_loop_stability(loop: Loop) -> Stability:
    """Nyquist's count for a loop (Nyquist 1932): unstable poles = open-loop ones - encirclements of -1.

    Integrators and unstable poles of the plant are the loop's word; a wrong word gives a wrong answer. The
    contour passes integrators on the right. Undecided where L has not fallen below 1 at the last line, where
    1 + L turns too far between lines, or where -1 lies within the FRF's own 95 % reach.
    """
    L, f = loop.L, loop.frequency_hz
    integrators = loop.integrators + loop.controller.integrators()
    reason = _undecidable(loop, L, f)
    if reason:
        return Stability("undecided", None, reason)
    start = _turn_to_first_line(L[0], integrators)
    if start is None:
        return Stability(
            "undecided",
            None,
            f"the phase of L at the first line ({f[0]:.3g} Hz, {deg(np.angle(L[0])):.0f} deg) does not fit"
            f" {integrators} integrators: measure lower or declare their number",
        )
    poles = _count(start, L, loop.unstable_poles, integrators)
    if poles < 0:
        return Stability("undecided", None, f"{-poles} encirclements too many for {loop.unstable_poles} unstable poles")
    if poles:
        return Stability("unstable", poles, f"{poles} closed-loop poles in the right half plane")
    return Stability("stable", 0, "the encirclements of -1 balance the unstable poles")


def _undecidable(loop: Loop, L: ComplexArray, f: Array) -> str:
    if abs(L[-1]) >= 1.0:
        return f"|L| is still {abs(L[-1]):.2g} at the last line, {f[-1]:.3g} Hz: measure higher"
    steps = np.abs(deg(np.angle((1.0 + L[1:]) / (1.0 + L[:-1]))))
    if steps.size and steps.max() > COARSE_DEG:
        k = int(np.argmax(steps))
        return f"1 + L turns by {steps[k]:.0f} deg between {f[k]:.4g} and {f[k + 1]:.4g} Hz: measure finer there"
    reach = 2.45 * np.abs(loop.C) * np.sqrt(0.5 * loop.plant.variance[:, 0, 0])  # radius of 95 % of a circular error
    unclear = np.flatnonzero(np.abs(1.0 + L) < reach)
    if unclear.size:
        return f"-1 lies within the uncertainty of L at {f[unclear[0]]:.3g} Hz: measure longer or excite more"
    distance, where = nearest_to_minus_one(f, L)
    if distance < 1e-3:
        return f"L passes -1 within {distance:.1g} at {where:.3g} Hz"
    return ""


def count_unstable(L: ComplexArray, integrators: int, unstable_poles: int) -> int | None:
    """Closed-loop poles in the right half plane by the bare count, None where the first line fits badly.

    For inner loops of a search: it looks at no uncertainty and trusts the sampling.
    """
    start = _turn_to_first_line(L[0], integrators)
    return None if start is None else _count(start, L, unstable_poles, integrators)


def _count(start: float, L: ComplexArray, unstable_poles: int, integrators: int) -> int:
    """Nyquist's count from the turn of 1 + L over s = j0+ ... j inf; the arc around zero turns it by -180 k deg."""
    path = 1.0 + L
    turn = start + float(np.sum(np.angle(path[1:] / path[:-1]))) - float(np.angle(path[-1]))
    return round(unstable_poles + 0.5 * integrators - turn / np.pi)


def _turn_to_first_line(first: complex, integrators: int) -> float | None:
    """Angle in rad that 1 + L turns from s = j0+ to the first line, None where the phase there fits badly.

    With k integrators L starts infinite at -90 k deg (turned by 180 where the gain is negative), swings to
    the phase of `first` and shrinks along it as f^-k. Without any, 1 + L starts on the real axis.
    """
    if integrators == 0:
        return _swing(1.0 + first)
    swing = _swing(first * 1j**integrators)
    return None if swing is None else swing + float(np.angle((1.0 + first) / first))


def _swing(value: complex, limit_deg: float = 75.0) -> float | None:
    """Angle in rad from the nearer end of the real axis to `value`, None where it lies near neither."""
    angle = float(np.angle(value if value.real >= 0.0 else -value))
    return angle if abs(deg(angle)) <= limit_deg else None
