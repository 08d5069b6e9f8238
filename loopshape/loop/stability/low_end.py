"""The low end of a measured loop: where the crossover lies below the first line, and how far a model may lead there."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np

from loopshape.core.kernels.loops.margins import LARGE
from loopshape.core.units import Array, ComplexArray, deg
from loopshape.data.control.loop import Loop
from loopshape.data.response.frf import FRF
from loopshape.loop.margin.low_frequency import LowModel, low_frequency_models

#: models may carry the loop this far below its first line, as a ratio of frequencies
LED = 1.3
#: slope and phase of the lowest lines that agree this well, in integrators, leave nothing to be seen below them
AGREE = 0.3
#: noise widens that to this at most
MOST_ROOM = 0.75
#: so many parameters at most has a model that tells where unstable poles lie, or a crossover below the lines
SIMPLE = 4
#: below this |L| is far from 1, whichever model says so
SMALL = 0.1
#: where L is read below its first line, as shares of its frequency: the first stands for 0 Hz
DOWN = np.concatenate([[1e-6], np.geomspace(0.01, 1.0, 24, endpoint=False)])


def poles_at_0(loop: Loop) -> int:
    """Poles of L at s = 0, less its zeros there."""
    return (loop.integrators or 0) + loop.controller.integrators()


def in_sight(loop: Loop) -> bool:
    """Whether the lines show where |L| falls through 1 for the first time, or tell that it does not do so below them.

    They do where |L| starts at 1 or above. Where it starts below, all small models of the lowest lines, one of them
    simple unless L falls to 0 Hz and stays `SMALL`, must have it reach 1 at most a third of an octave lower, or stay
    below 1 down to 0 Hz in a loop without integrators.
    """
    if abs(loop.L[0]) >= 1.0:
        return True
    below = [np.abs(L) for L in below_lines(loop, low_hz(loop))]
    largest = max((x.max() for x in below), default=np.inf)
    falls = poles_at_0(loop) < 0 and largest < SMALL
    if not falls and not any(is_simple(model) for model in low_models(loop)):
        return False
    if poles_at_0(loop) <= 0 and largest < 1.0:
        return True
    octave = low_hz(loop) >= float(loop.frequency_hz[0]) / LED
    return all(x[octave].max() >= 1.0 for x in below)


def below_lines(loop: Loop, f: Array) -> list[ComplexArray]:
    """L (n,) at frequencies f (n,) in Hz below the first line, by each small model of the lowest lines."""
    C = loop.controller.response(f)
    return [C * model.response(f) for model in low_models(loop)]


def low_models(loop: Loop) -> tuple[LowModel, ...]:
    """Small models of the lowest lines, which say how the plant goes on below them."""
    if loop.integrators is None:
        return ()
    return low_frequency_models(loop.plant if loop.raw is None else loop.raw, loop.integrators)


def low_hz(loop: Loop) -> Array:
    """Three decades of frequencies below the first line."""
    first = float(loop.frequency_hz[0])
    return np.geomspace(1e-3 * first, first, 60, endpoint=False)


def is_large(loop: Loop) -> bool:
    """Whether L starts so large, and does not fall towards 0 Hz, that nothing below its first line comes near -1."""
    return abs(loop.L[0]) >= LARGE and poles_at_0(loop) >= 0 and slope_of(loop) > -AGREE


@lru_cache(maxsize=256)
def slope_of(loop: Loop) -> float:
    """-slope/20 dB a decade of L over the lowest lines of a loop."""
    lines = loop.plant if loop.raw is None else loop.raw
    return low_order(
        replace(lines, response=lines.response * loop.controller.response(lines.frequency_hz)[:, None, None])
    )[1]


def is_told(loop: Loop) -> bool:
    """Whether the lowest lines tell how L goes on below them.

    Models do, simple ones where the plant has unstable poles, and on a stable plant so does a large L; else slope and
    phase must agree with each other there, and L not fall towards 0 Hz.
    """
    models = low_models(loop)
    if loop.unstable_poles and loop.model is None:  # below the lines they may turn L once more about 0
        return any(is_simple(model) for model in models)
    if loop.model is not None or models:
        return True
    lines = loop.plant if loop.raw is None else loop.raw
    phase, slope = low_order(lines)
    if is_large(loop) and abs(phase - slope) < 1.0:  # no pair of poles lies below that the phase does not show
        return True
    return (
        loop.unstable_poles == 0
        and poles_at_0(loop) >= 0
        and abs(phase - slope) < room_of(lines)
        and slope_of(loop) > -AGREE
    )


def holds_below(loop: Loop, poles: int) -> bool:
    """Whether a count of `poles` has the right outcome where `is_told` leaves open how L goes on below its lines.

    A large L that falls as its declared integrators do has as many zeros as other poles below them, and an even number
    of those are unstable, or its phase were turned over. Each leaves one unstable closed-loop pole less to the lines
    than was counted (Nyquist 1932), which changes the outcome where none is left, and is impossible below none.
    """
    lines = loop.plant if loop.raw is None else loop.raw
    as_declared = is_large(loop) and round(low_order(lines)[1]) == (loop.integrators or 0)
    return as_declared and (poles == 0 or poles % 2 == 1 or poles > (loop.unstable_poles or 0))


def is_simple(model: LowModel) -> bool:
    """Whether a model has few enough parameters to tell where unstable poles lie."""
    return model.num.size + model.den.size - 1 <= SIMPLE


def low_order(lines: FRF) -> tuple[float, float]:
    """-phase/90 deg and -slope/20 dB a decade over the lowest lines (a factor of 1.6 in frequency, four at least)."""
    f = lines.frequency_hz
    count = max(4, int(np.searchsorted(f, 1.6 * f[0])))
    lowest = lines.siso[:count]
    phase = float(deg(np.angle(np.mean(lowest / np.abs(lowest)))))
    slope = np.polyfit(np.log(f[: lowest.size]), np.log(np.abs(lowest)), 1)[0] if lowest.size > 1 else 0.0
    return -phase / 90.0 + (4.0 if phase > 45.0 else 0.0), float(-slope)


def room_of(lines: FRF) -> float:
    """How far slope and phase of the lowest lines may differ and still agree, by the scatter of the lines; below 1.

    One more pole below the lines, which the phase does not show, would part them by 1.
    """
    f = lines.frequency_hz
    count = max(4, int(np.searchsorted(f, 1.6 * f[0])))
    x = np.log(f[:count])
    if x.size < 4:
        return AGREE
    relative = np.sqrt(lines.variance[:count, 0, 0]) / np.maximum(np.abs(lines.siso[:count]), 1e-300)
    std = np.median(relative) / (2.0 * x.std())  # neighbours are smoothed together: four of them are independent
    return float(min(AGREE + 2.0 * std, MOST_ROOM))


def crossover_below(loop: Loop) -> tuple[float, float]:
    """The band in Hz below the first line where L, continued along its integrators, reaches 1 and twice that."""
    first, slope = loop.frequency_hz[0], max((loop.integrators or 0) + loop.controller.integrators(), 1)
    return float(first * (0.5 * min(abs(loop.L[0]), 1.0)) ** (1.0 / slope)), float(first)
