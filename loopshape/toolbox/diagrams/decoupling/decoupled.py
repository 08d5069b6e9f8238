"""Decoupled loops as a block diagram: controllers, the matrix or the filters, the plant, and every loop closed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

from loopshape.core.errors import WrongUseError
from loopshape.data.control.controller import Controller
from loopshape.data.control.shorthand import controller, gain
from loopshape.data.response.frf import FRF
from loopshape.identify.matrix.interaction import square_part
from loopshape.toolbox.diagrams.decoupling.decouple import Decoupling
from loopshape.toolbox.diagrams.decoupling.decouple_filters import DynamicDecoupling
from loopshape.toolbox.diagrams.diagram import Diagram, Part


def decoupled(
    P: FRF | Sequence[FRF],
    W: Decoupling | DynamicDecoupling,
    controllers: Mapping[str, Controller] | None = None,
    tuned: str | None = None,
) -> Diagram:
    """All loops of a plant behind a constant matrix or filters, each closed by its controller, one of them tuned.

    `P` is a matrix FRF, or one for each operating point; `controllers` are named by loop (None, or one left out: to be
    put in by `with_part`). `tuned` is one of the loops, the first by default. Signals of loop k, from 1: the setpoint
    `rk`, the error `ek`, what its controller gives `vk`, what enters the plant `uk` and the output `yk`. Take it to
    `ls.diagrams.simulate`, `ls.formats.export` ("c" or "json") and `ls.check`. Raises WrongUseError for loops that W
    does not have.

    >>> import numpy as np, loopshape as ls
    >>> f_hz = np.geomspace(0.5, 20.0, 60)
    >>> g = 1.0 / (1.0 + 1j * f_hz / 3.0)
    >>> H = np.stack([[g, 0.4 * g / (1.0 + 1j * f_hz / 5.0)], [0.0 * g, g]]).transpose(2, 0, 1)
    >>> P = ls.FRF.from_arrays(f_hz, H, relative_std=0.01, rate_hz=1000.0)
    >>> ls.diagrams.decoupled(P, ls.diagrams.decouple(P, at_hz=(0.5, 20.0), order=1))
    Diagram decoupled: u1_1, u2_1, u1_1 of u2_1, u2_1 of u1_1, P; u1_1 is tuned, from outside: r1, r2
    """
    plants = (P,) if isinstance(P, FRF) else tuple(P)
    given, loops = dict(controllers or {}), W.loops
    named = given if tuned is None else {**given, tuned: None}
    if strange := [name for name in named if name not in loops]:
        raise WrongUseError("a loop is not among those decoupled", ", ".join(strange), f"they are {', '.join(loops)}")
    numbers = range(1, len(loops) + 1)
    parts = [Part(name, f"e{k}", f"v{k}", given.get(name)) for k, name in zip(numbers, loops, strict=True)]
    sums = {f"e{k}": f"r{k} - y{k}" for k in numbers}
    filters = _filters(W, plants[0].rate_hz)
    for k in numbers:
        into = [(m, filters[k - 1][m - 1]) for m in numbers]
        parts += [Part(f"{loops[k - 1]} of {loops[m - 1]}", f"v{m}", f"w{k}{m}", one) for m, one in into if one]
        sums[f"u{k}"] = " + ".join([f"v{k}", *(f"w{k}{m}" for m, one in into if one)])
    square = tuple(square_part(one, loops)[0] for one in plants)
    parts.append(Part("P", [f"u{k}" for k in numbers], [f"y{k}" for k in numbers], square))
    return Diagram(tuple(parts), sums, tuned or loops[0], "decoupled")


def _filters(W: Decoupling | DynamicDecoupling, rate_hz: float) -> list[list[Controller | None]]:
    """What each loop gets of each, a gain for each number of a constant matrix; None on the diagonal."""
    rows: list[list[Controller | None]] = []
    for i, a in enumerate(W.loops):
        if isinstance(W, DynamicDecoupling):
            rows.append([None if a == b else W.filters[a][b] for b in W.loops])
            continue
        gains = [controller(gain(float(one)), rate_hz=rate_hz) for one in W.matrix[i]]
        rows.append([None if a == b else replace(g, loop=f"{a} of {b}") for b, g in zip(W.loops, gains, strict=True)])
    return rows
