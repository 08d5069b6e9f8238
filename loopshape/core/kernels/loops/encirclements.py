"""Nyquist's count with the contour closed, on bare arrays."""

from __future__ import annotations

import numpy as np

from loopshape.core.kernels.compiled import Array, ComplexArray, compiled

#: the count where the first value of L fits neither its integrators nor its unstable poles
NO_FIT = -1_000_000
#: without a model L must start this close to the phase of its integrators, in deg
FIT_DEG = 75.0


@compiled
def _angle(z: complex) -> float:
    """Angle in rad, pi on the negative real axis, whatever the sign of zero."""
    return np.arctan2(z.imag + 0.0, z.real)


@compiled
def whole_turn(before: complex, now: complex) -> float:
    """The whole turn in rad, with its sign, by which the angle jumps where a chord crosses the negative real axis."""
    if (before.imag >= 0.0) == (now.imag >= 0.0):
        return 0.0
    left = before.real * now.imag - before.imag * now.real
    if before.imag >= 0.0 and left > 0.0:
        return 2.0 * np.pi
    if before.imag < 0.0 and left < 0.0:
        return -2.0 * np.pi
    return 0.0


@compiled
def turn_along(L: ComplexArray, turn: float, before: complex) -> tuple[float, complex]:
    """`turn` and the whole turns that 1 + L makes along L (n,) from `before`, with the last value of 1 + L.

    Chords that cross the negative real axis are counted; what the ends' angles add is left to the caller.
    """
    for k in range(L.size):
        now = 1.0 + L[k]
        turn += whole_turn(before, now)
        before = now
    return turn, before


@compiled
def turns(paths: ComplexArray) -> Array:
    """Angles in rad (m,) that paths (m, n) turn about zero, at most half a turn a step; steps onto it count nothing."""
    out = np.empty(len(paths))
    for m in range(len(paths)):
        turn, first, before = 0.0, 0j, 0j
        for k in range(paths.shape[1]):
            now = paths[m, k]
            if now == 0.0:
                continue
            if before == 0.0:
                first = now
            else:
                turn += whole_turn(before, now)
            before = now
        out[m] = turn + _angle(before) - _angle(first)
    return out


@compiled
def turn_to_first(first: complex, integrators: int, negative: bool, either_sign: bool, near: float = 0.0) -> float:
    """Angle in rad that 1 + L turns from s = j0+ to L = `first`, nan where the phase there fits badly.

    `near` is the swing in rad from the phase of the integrators that the slope of L asks for: that of poles and zeros
    below `first`.

    With k integrators L starts infinite at -90 k deg, swings to the phase of `first` and shrinks along it as f^-k;
    without any it starts on the real axis, and with zeros at s = 0 (k below 0) at 0. A stable plant is taken to have a
    positive gain there, one with an odd number of unstable poles a `negative` one (as k/(s - a) has); close to zero
    frequency, where a model leads (`either_sign`), the sign is read off.
    """
    ahead = first
    for _ in range(integrators % 4):
        ahead *= 1j
    if either_sign:
        negative = ahead.real < 0.0
    swing = _angle(-ahead if negative else ahead)
    swing += 2.0 * np.pi * np.round((near - swing) / (2.0 * np.pi))
    if abs(swing - near) > FIT_DEG * np.pi / 180.0:
        return np.nan
    if integrators < 0:  # from L = 0 straight to the first
        return _angle(1.0 + first)
    if integrators > 0:
        return swing + _angle((1.0 + first) / first)
    if negative and not either_sign and first.real > -1.0:
        return np.nan
    if near != 0.0 and abs(first) > 1.0:
        return swing + _angle((1.0 + first) / first)
    side = 1.0 if first.imag >= 0.0 else -1.0
    return _angle(1.0 + first) - (np.pi * side if first.real < -1.0 else 0.0)


@compiled
def count_unstable(
    L: ComplexArray, integrators: int, unstable_poles: int, below: ComplexArray, near: float = 0.0
) -> int:
    """Closed-loop poles in the right half plane by the bare count, `NO_FIT` where the first value fits badly.

    `below` (nb,) continues L (nf,) towards zero frequency. With P unstable open-loop poles and k integrators, passed on
    the right, the turn of 1 + L over s = j0+ ... j inf is pi (P + k/2 - Z) for Z unstable closed-loop poles.
    """
    first = below[0] if below.size else L[0]
    start = turn_to_first(first, integrators, unstable_poles % 2 == 1, below.size > 0, near)
    if np.isnan(start):
        return NO_FIT
    turn, before = turn_along(below, start, 1.0 + first)
    turn, before = turn_along(L, turn, before)  # the ends' angles: that of the last value goes out again as L dies out
    return round(unstable_poles + 0.5 * max(integrators, 0) - (turn - _angle(1.0 + first)) / np.pi)
