"""Loop -> 95 % bands of its responses, each line by itself."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from loopshape.core.errors import WrongUseError
from loopshape.core.units import Array, ComplexArray, db, deg
from loopshape.data.control.loop import Loop

#: places of a circular error that stand for all of them
PLACES = 300
_GOLDEN_TURN = np.pi * (3.0 - np.sqrt(5.0))
_RESPONSES: Mapping[str, Callable[[ComplexArray, ComplexArray], ComplexArray]] = {
    "P": lambda P, C: P + 0.0 * C,
    "C": lambda P, C: 0.0 * P + C,
    "L": lambda P, C: C * P,
    "S": lambda P, C: 1.0 / (1.0 + C * P),
    "T": lambda P, C: C * P / (1.0 + C * P),
    "CS": lambda P, C: C / (1.0 + C * P),
    "PS": lambda P, C: P / (1.0 + C * P),
}


@dataclass(frozen=True, eq=False)
class Band:
    """Ends (nf,) of a response's 95 % band: magnitude in dB, phase in degrees about the response's own.

    An end of the phase reaches 180 where the error may turn the response round: there the phase is not known.
    """

    low_db: Array
    high_db: Array
    low_deg: Array
    high_deg: Array


def band(loop: Loop, name: str) -> Band:
    """95 % band of "P", "C", "L", "S", "T", "CS" or "PS", on the loop's lines.

    The plant's error is circular, of the variance that `loop.plant` states; places spread evenly over it (a golden
    spiral) are carried through to the response, and quantiles taken: no linearisation, no chance, and neighbouring
    lines give smooth ends. Each line holds the truth in 95 %, all lines together do so less often. It knows the FRF's
    noise alone, and is that of a line, not of a peak: the largest of many lines is another reading (`margins`).
    Refuses other names.
    """
    if name not in _RESPONSES:
        raise WrongUseError(
            "a band is that of one of a loop's responses", f"{name!r}", f"one of {', '.join(_RESPONSES)}"
        )
    of, C, P = _RESPONSES[name], loop.C, loop.plant.siso
    drawn = of(P + np.sqrt(loop.plant.variance[:, 0, 0]) * circular_places()[:, None], C)
    low_db, high_db = np.quantile(db(drawn), (0.025, 0.975), axis=0)
    low_deg, high_deg = np.quantile(deg(np.angle(drawn * np.conj(of(P, C)))), (0.025, 0.975), axis=0)
    return Band(low_db, high_db, low_deg, high_deg)


def circular_places(count: int = PLACES) -> ComplexArray:
    """Places (count,) of equal weight under a circular normal error of variance E|d|² = 1."""
    k = np.arange(count)
    return np.asarray(np.sqrt(-np.log1p(-(k + 0.5) / count)) * np.exp(1j * _GOLDEN_TURN * k))
