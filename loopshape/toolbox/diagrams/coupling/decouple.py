"""A constant matrix between the controllers and the plant, from the measured matrix FRF at a frequency.

With W in front of it the plant is P W. Column j of W, 1 on the diagonal, leaves least of column j of P W off its
diagonal: real least squares, each row in proportion to its own |P_ii|. What is left is the part of P_ij/P_ii that a
real number does not cancel (Maciejowski, Multivariable Feedback Design, 1989, on aligning at a frequency).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal, overload

import numpy as np

from loopshape.core.errors import WrongUseError
from loopshape.core.json_ready import Plain
from loopshape.core.units import Array, ComplexArray
from loopshape.data.control.controller import Controller
from loopshape.data.control.shorthand import controller, gain
from loopshape.data.response.frf import FRF
from loopshape.identify.matrix.equivalent_plant import square_part
from loopshape.toolbox.diagrams.coupling.decouple_filters import DynamicDecoupling, behind, decoupling_filters
from loopshape.toolbox.diagrams.diagram import Diagram, Part


@dataclass(frozen=True, eq=False)
class Decoupling(Plain):
    """The matrix (loops, loops) from the controllers' outputs to what enters the plant, and its standard deviation.

    `band_hz` are the lowest and the highest frequency (line) that it was found from.
    """

    loops: tuple[str, ...]
    matrix: Array
    std: Array
    band_hz: tuple[float, float]

    def __repr__(self) -> str:
        """One line: what of which loop enters which, with 95 %."""
        pairs = [
            f"{a} gets {self.matrix[i, j]:.3g} ({1.96 * self.std[i, j]:.2g}) of {b}"
            for i, a in enumerate(self.loops)
            for j, b in enumerate(self.loops)
            if i != j
        ]
        return f"Decoupling at {self.band_hz[0]:.3g} to {self.band_hz[1]:.3g} Hz: {', '.join(pairs)}"

    @property
    def weights(self) -> dict[str, dict[str, float]]:
        """As `ls.rig.measure` takes it and a study's `[[loop]]` writes it: by loop, the weights of all controllers."""
        return {a: {b: float(self.matrix[i, j]) for j, b in enumerate(self.loops)} for i, a in enumerate(self.loops)}

    def applied(self, P: FRF) -> FRF:
        """The plant behind the matrix, P W, with its covariance; W is taken as exact.

        Misleads on the FRF that W was found from: there its error and the plant's are the same.
        """
        plant, _ = square_part(P, self.loops)
        W = np.tile(self.matrix.astype(complex), (plant.frequency_hz.size, 1, 1))
        return behind(plant, W, f"a constant matrix between controllers and plant: {self}")


@overload
def decouple(P: FRF, at_hz: float | tuple[float, float], order: Literal[0] = 0) -> Decoupling: ...
@overload
def decouple(P: FRF, at_hz: float | tuple[float, float], order: int) -> Decoupling | DynamicDecoupling: ...
def decouple(P: FRF, at_hz: float | tuple[float, float], order: int = 0) -> Decoupling | DynamicDecoupling:
    """The constant matrix that decouples a measured plant best at a frequency, or over a band, with its error.

    With an `order` of 1 to 8 filters of that order stand in the place of the numbers off the diagonal, fitted over the
    band: a `DynamicDecoupling`.

    `P` is a square matrix FRF (`ls.frf_matrices`). The result's `applied(P)` is the plant behind the matrix, for
    `ls.interaction` and `ls.check`; its `weights` make a simulated arm or a target run it (`ls.rig.measure`). Of the
    frequencies in a band each counts alike; of a single one the nearest that was measured is taken. For filters they
    count by their variance, those known better than 1 % of the coupling alike. `std` follows from the FRF's covariance
    to first order. Raises WrongUseError for an FRF of a single loop, for a band without lines, and for filters with too
    few of them, without a rate or up to half of it.

    Misleads where the coupling turns with frequency: a constant matrix cancels its real part alone. Filters are stable
    and proper; a coupling whose inverse is neither (a delay less in the coupling than in the loop) they follow as far
    as they can, and above and below the band nothing holds them: look at `response` there.

    >>> import numpy as np, loopshape as ls
    >>> f_hz = np.geomspace(0.5, 20.0, 60)
    >>> g = 1.0 / (1.0 + 1j * f_hz / 3.0)
    >>> H = np.stack([[g, 0.4 * g], [-0.2 * g, 2.0 * g]]).transpose(2, 0, 1)
    >>> P = ls.FRF.from_arrays(f_hz, H, relative_std=0.01, rate_hz=1000.0)
    >>> ls.diagrams.decouple(P, at_hz=1.0).matrix.round(3).tolist()
    [[1.0, -0.4], [0.1, 1.0]]
    >>> ls.diagrams.decouple(P, at_hz=(1.0, 10.0), order=1).filters["u2_1"]["u1_1"]
    Controller u2_1 of u1_1: section at 1000 Hz
    """
    plant, loops = square_part(P)
    used = _lines(plant, at_hz)
    if order:
        return decoupling_filters(plant, loops, used, order)
    n = len(loops)
    matrix, std = np.eye(n), np.zeros((n, n))
    for j in range(n):
        others = [k for k in range(n) if k != j]
        matrix[others, j], std[others, j] = _column(plant.select(used), j, others)
    f = plant.frequency_hz[used]
    return Decoupling(loops, matrix, std, (float(f[0]), float(f[-1])))


def _lines(plant: FRF, at_hz: float | tuple[float, float]) -> np.ndarray:
    """Valid lines (nf,) in a band, or the one nearest to a frequency; refuses none."""
    f, valid = plant.frequency_hz, plant.valid
    if isinstance(at_hz, tuple):
        used = valid & (f >= at_hz[0]) & (f <= at_hz[1])
    else:
        near = np.where(valid, np.abs(np.log(f / at_hz)), np.inf)
        used = (near == near.min()) & valid
    if not used.any():
        raise WrongUseError("no valid frequency to decouple at", f"{at_hz} Hz", "look at the FRF's valid band")
    return np.asarray(used)


def _column(plant: FRF, j: int, others: list[int]) -> tuple[Array, Array]:
    """Weights (n-1,) of the other inputs in column j, and their standard deviations.

    With r the rows i != j of P w, dw = -(Re A^H A)^-1 Re(A^H dr) where r is small; dr is linear in vec(P).
    """
    H = plant.response
    own = np.abs(H[:, others, others])  # |P_ii| of each row
    A, b = H[:, others][:, :, others] / own[:, :, None], H[:, others, j] / own
    normal = np.real(np.einsum("fik,fil->kl", A.conj(), A))
    w = -np.linalg.solve(normal, np.real(np.einsum("fik,fi->k", A.conj(), b)))
    full = np.zeros(H.shape[1])
    full[j], full[others] = 1.0, w
    gains = _slopes(A, own, full, others)
    inverse = np.linalg.inv(normal)
    spread = 0.5 * np.real(np.einsum("fim,fmn,fjn->ij", gains, plant.covariance, gains.conj()))
    return w, np.sqrt(np.diag(inverse @ spread @ inverse) * plant.line_overlap)


def _slopes(A: ComplexArray, own: Array, full: Array, others: list[int]) -> ComplexArray:
    """A^H M of each line (nf, n-1, n n): how d vec(P), columns stacked, enters the normal equations."""
    rows = np.eye(full.size)[others]
    M = np.stack([np.kron(full, rows) / scale[:, None] for scale in own])
    return np.einsum("fik,fim->fkm", A.conj(), M)


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
