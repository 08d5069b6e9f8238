"""The low end of a measured loop: where the crossover lies below the first line, and how far a model may lead there."""

from __future__ import annotations

import numpy as np

from loopshape.core.units import Array, ComplexArray
from loopshape.data.loop import Loop
from loopshape.data.model import TransferFunction
from loopshape.loop.low_frequency import LowModel, low_frequency_models

Model = TransferFunction | LowModel
#: a model may carry the loop this far below its first line, as a ratio of frequencies
LED = 2.0


def judged_lines(loop: Loop) -> tuple[Array, ComplexArray, ComplexArray] | None:
    """Frequencies in Hz, L and C that margins are read from; None where the crossover is out of sight.

    These are the FRF's lines where |L| starts at 1 or above. Where it starts below, the fit's model may lead to the
    crossover, at most an octave lower; a loop without integrators may have no crossover at all, if the model, or all
    small models of the lowest lines, say so.
    """
    f, L, C = loop.frequency_hz, loop.L, loop.C
    if abs(L[0]) >= 1.0:
        return f, L, C
    models = low_models(loop)
    if not models:
        return None
    below_hz = loop.below_hz if loop.below_hz.size else low_hz(loop)
    C_below = loop.controller.response(below_hz)
    below = np.abs([C_below * model.response(below_hz) for model in models])
    if (loop.integrators or 0) + loop.controller.integrators() <= 0 and below.max() < 1.0:
        return f, L, C
    if loop.model is None:
        return None
    led = led_hz(loop)
    C_led = loop.controller.response(led)
    L_led = C_led * loop.model.response(led)
    if abs(L_led[0]) < 1.0:
        return None
    return np.concatenate([led, f]), np.concatenate([L_led, L]), np.concatenate([C_led, C])


def led_hz(loop: Loop) -> Array:
    """The octave (24,) below the first line, through which a fit may lead."""
    first = float(loop.frequency_hz[0])
    return np.geomspace(first / LED, first, 24, endpoint=False)


def low_models(loop: Loop) -> tuple[Model, ...]:
    """What says how the plant goes on below its first line: the fit, else small models of the lowest lines."""
    if loop.model is not None:
        return (loop.model,)
    if loop.integrators is None:
        return ()
    return low_frequency_models(loop.plant if loop.raw is None else loop.raw, loop.integrators)


def low_hz(loop: Loop) -> Array:
    """Three decades of frequencies below the first line."""
    first = float(loop.frequency_hz[0])
    return np.geomspace(1e-3 * first, first, 60, endpoint=False)


def crossover_below(loop: Loop) -> tuple[float, float]:
    """The band in Hz below the first line where L, continued along its integrators, reaches 1 and twice that."""
    first, slope = loop.frequency_hz[0], max((loop.integrators or 0) + loop.controller.integrators(), 1)
    return float(first * (0.5 * min(abs(loop.L[0]), 1.0)) ** (1.0 / slope)), float(first)
