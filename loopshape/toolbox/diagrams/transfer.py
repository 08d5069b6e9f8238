"""From one signal of a diagram to another, frequency by frequency, with the error of all plants in it."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from loopshape.core.errors import WrongUseError, refuse_unknown
from loopshape.core.units import ComplexArray
from loopshape.data.algebra.propagation import Term, check_operands, invert, result
from loopshape.data.control.controller import Controller
from loopshape.data.response.frf import FRF
from loopshape.toolbox.diagrams.diagram import Diagram
from loopshape.toolbox.learning.taps import Feedforward


def transfer(D: Diagram, source: str, to: str, *, opened: Iterable[str] = (), point: int = 0) -> FRF:
    """The response of signal `to` to what is added at signal `source`, all loops closed but through `opened` blocks.

    With G the blocks (outputs, inputs), M the sums from outputs to inputs and n, m, k those of both signals, it is
    m (I - G M)^-1 G n + k; to first order it errs by m (I - G M)^-1 dG (M (I - G M)^-1 G + I) n, so elements that were
    measured together keep their joint covariance. `point` is the operating point. Lines end below half the controllers'
    rate. Whether the loops are stable no line can say: see `ls.diagrams.equivalent`. Raises WrongUseError for a
    block that is still to be tuned and not opened, and plants on different lines.

    >>> import numpy as np, loopshape as ls
    >>> f_hz = np.geomspace(1.0, 400.0, 80)
    >>> P = ls.FRF.from_arrays(f_hz, 1.0 / (1.0 + 1j * f_hz / 10.0), relative_std=0.01, rate_hz=1000.0)
    >>> C = ls.diagrams.Part("C", "e", "u", ls.controller(ls.gain(4.0), rate_hz=1000.0))
    >>> D = ls.diagrams.Diagram((C, ls.diagrams.Part("P", "u", "y", P)), {"e": "r - y"}, "C")
    >>> print(abs(ls.diagrams.transfer(D, "r", "y").siso[0]).round(2))
    0.8
    """
    refuse_unknown("the diagram has no such signal", source, D.signals)
    plants = {one.name: one.plants[min(point, len(one.plants) - 1)] for one in D.parts if one.plants}
    if D.rate_hz > 0.0:
        plants = {name: p.select(p.frequency_hz < 0.5 * D.rate_hz) for name, p in plants.items()}
    check_operands(tuple(plants.values()), independent=False)
    G, M, every = _blocks(D, plants, set(opened)), *D.wiring()
    n = every[:, D.signals.index(source)]
    m, at = D.reading(to)
    f = next(iter(plants.values())).frequency_hz
    X = invert(np.eye(G.shape[1]) - G @ M, f, "the diagram's I - G M")
    inside = np.einsum("fab,fbc,c->fa", X, G, n)  # what the blocks give out
    entering, seen = inside @ M.T + n, m @ X
    response = inside @ m + at[D.signals.index(source)]
    terms = [
        Term(frf, seen[:, None, rows], entering[:, columns, None])
        for (rows, columns), frf in ((_places(D, name), plants[name]) for name in plants)
    ]
    made = result(f"{source} to {to}", response[:, None, None], (to,), (source,), terms)
    return replace(made, rate_hz=D.rate_hz)


def _places(D: Diagram, name: str) -> tuple[list[int], list[int]]:
    """Where a block's outputs and inputs stand among those of all."""
    before = D.parts[: [one.name for one in D.parts].index(name)]
    part, row, column = D.part(name), sum(len(p.outputs) for p in before), sum(len(p.inputs) for p in before)
    return list(range(row, row + len(part.outputs))), list(range(column, column + len(part.inputs)))


def _blocks(D: Diagram, plants: dict[str, FRF], opened: set[str]) -> ComplexArray:
    """All blocks side by side (nf, outputs, inputs); what is opened is 0."""
    f = next(iter(plants.values())).frequency_hz
    G = np.zeros((f.size, len(D.outputs), sum(len(p.inputs) for p in D.parts)), dtype=complex)
    for one in D.parts:
        if one.name in opened:
            continue
        rows, columns = _places(D, one.name)
        if isinstance(one.what, Controller | Feedforward):
            value = one.what.response(f)[:, None, None]
        elif one.plants:
            value = plants[one.name].response
        else:
            raise WrongUseError(
                f"block {one.name} has no controller yet", "nothing", "tune it, and put it in: D.with_part(name, C)"
            )
        G[:, rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1] = value
    return G
