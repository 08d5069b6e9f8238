"""Poles of a closed loop as it runs: a fit taken as the sampled plant, delay and all, under a discrete controller."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from loopshape.core.errors import WrongUseError
from loopshape.core.units import TWO_PI, ComplexArray
from loopshape.data.control.controller import Controller
from loopshape.data.response.model import TransferFunction

#: starts of Newton's method: so many sizes, from 1e-9 of the rate on, by so many angles; the smallest are tried
SIZES, ANGLES, TRIED = 400, 61, 2000
#: points of the circle on which the poles within are counted, half of them
AROUND = 20_000
NEWTONS, CONVERGED = 60, 1e-11
Function = Callable[[ComplexArray], tuple[ComplexArray, ComplexArray]]


def closed_loop_poles(model: TransferFunction, controller: Controller) -> ComplexArray:
    """Zeros of den(s) a(z) + num(s) b(z) exp(-s delay), z = exp(s/rate), with |s| < pi rate; slowest first, rad/s.

    A controller's zero that cancels a pole of the plant is among them, as it is among the modes of the loop. With a
    delay their number is infinite: those beyond 40/delay are left out, too. Refuses where Newton's method does not find
    as many as the argument principle counts.
    """
    F = _characteristic(model, controller)
    delay_s = model.delay_s + controller.computation_delay_s
    # poles are looked for up to so many rad over the delay: beyond, a delay's chain of them goes on for ever
    of_the_delay = 40.0
    largest = 0.999 * min(0.5 * TWO_PI * controller.rate_hz, of_the_delay / max(delay_s, 1e-300))
    around = np.unwrap(np.angle(F(largest * np.exp(0.5j * TWO_PI * np.linspace(0.0, 1.0, AROUND)))[0]))
    count = round(2.0 * float(around[-1] - around[0]) / TWO_PI)
    found: list[complex] = []
    for start in _starts(F, largest):
        if len(found) >= count:
            break
        root = _newton(F, start, found)
        if root is not None and abs(root) < largest:
            found += [root] if root.imag == 0.0 else [root, root.conjugate()]
    if len(found) != count:
        raise WrongUseError(
            f"not all poles of the closed loop {controller.loop!r} were found",
            f"{len(found)} of {count} slower than the rate", "see the stability of `ls.check`, which needs none",
        )  # fmt: skip
    return np.array(sorted(found, key=lambda s: (abs(s), s.imag)))


def _characteristic(model: TransferFunction, controller: Controller) -> Function:
    """The function whose zeros are the poles, and the sum of its parts' sizes, for s (n,)."""
    rows = controller.biquads()
    above, below = rows[:, :3], np.column_stack([np.ones(len(rows)), rows[:, 3:]])  # in 1/z

    def F(s: ComplexArray) -> tuple[ComplexArray, ComplexArray]:
        back = np.exp(-s / controller.rate_hz)
        b, a = (np.prod([np.polyval(row[::-1], back) for row in part], axis=0) for part in (above, below))
        late = np.exp(-s * (model.delay_s + controller.computation_delay_s))
        if controller.added_hold:
            late = late * -np.expm1(-s / controller.rate_hz) / (s / controller.rate_hz)
        open_, closing = np.polyval(model.den, s) * a, np.polyval(model.num, s) * b * late
        return open_ + closing, np.abs(open_) + np.abs(closing)

    return F


def _starts(F: Function, largest: float) -> ComplexArray:
    """Places of the upper half plane where the function is small beside its parts, smallest first."""
    sizes, angles = np.geomspace(1e-9, 1.0, SIZES) * largest, np.linspace(0.0, np.pi, ANGLES)
    grid = sizes[:, None] * np.exp(1j * angles)
    value, scale = F(grid.ravel())
    return grid.ravel()[np.argsort(np.abs(value) / np.maximum(scale, 1e-300))][:TRIED]


def _newton(F: Function, s: complex, known: list[complex]) -> complex | None:
    """The zero that Newton's method comes to, none of those known (deflated); real where it is nearly so."""
    for _ in range(NEWTONS):
        h = 1e-6 * max(abs(s), 1e-12)
        (low, value, high), _ = F(np.array([s - h, s, s + h]))
        if value == 0.0:
            break
        with np.errstate(divide="ignore", invalid="ignore"):
            slope = (high - low) / (2.0 * h) / value - sum(1.0 / (s - one) for one in known)
        if not np.isfinite(slope) or slope == 0.0:
            return None
        s = s - 1.0 / complex(slope)
        if not np.isfinite(s):
            return None
        if abs(1.0 / slope) < CONVERGED * abs(s):
            break
    else:
        return None
    s = complex(s)
    return complex(s.real, 0.0) if abs(s.imag) < 1e-7 * abs(s) else s if s.imag > 0.0 else s.conjugate()
