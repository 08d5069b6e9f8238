"""The low end of a measured loop: where the crossover lies below the first line, and how far a model may lead there."""

from __future__ import annotations

import numpy as np

from loopshape.loop import Loop
from loopshape.units import Array, ComplexArray

#: a model may carry the loop this far below its first line, as a ratio of frequencies
LED = 2.0


def judged_lines(loop: Loop) -> tuple[Array, ComplexArray, ComplexArray] | None:
    """Frequencies in Hz, L and C that margins are read from; None where the crossover is out of sight.

    These are the FRF's lines where |L| starts at 1 or above. Where it starts below, the fit's model may lead
    to the crossover, at most an octave lower; a loop without integrators may have no crossover at all, if the
    model says so.
    """
    f, L, C = loop.frequency_hz, loop.L, loop.C
    if abs(L[0]) >= 1.0:
        return f, L, C
    if loop.model is None:
        return None
    below = loop.controller.response(loop.below_hz) * loop.P_below
    if not (loop.integrators or 0) + loop.controller.integrators() and np.abs(below).max() < 1.0:
        return f, L, C
    led = np.geomspace(f[0] / LED, f[0], 24, endpoint=False)
    C_led = loop.controller.response(led)
    L_led = C_led * loop.model.response(led)
    if abs(L_led[0]) < 1.0:
        return None
    return np.concatenate([led, f]), np.concatenate([L_led, L]), np.concatenate([C_led, C])


def crossover_below(loop: Loop) -> tuple[float, float]:
    """The band in Hz below the first line where L, continued along its integrators, reaches 1 and twice that."""
    first, slope = loop.frequency_hz[0], max((loop.integrators or 0) + loop.controller.integrators(), 1)
    return float(first * (0.5 * min(abs(loop.L[0]), 1.0)) ** (1.0 / slope)), float(first)
