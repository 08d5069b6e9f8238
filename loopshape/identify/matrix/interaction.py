"""From a matrix FRF to how its loops meet: which rows and columns, k_I of each pair, and everything in one call."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import combinations

import numpy as np

from loopshape.core.errors import WrongUseError
from loopshape.core.units import Array, ComplexArray
from loopshape.data.algebra import channels
from loopshape.data.algebra.propagation import invert
from loopshape.data.control.controller import Controller
from loopshape.data.response.frf import FRF
from loopshape.data.response.interaction import Coefficient, Interaction, RelativeGain
from loopshape.data.signal.channel import Channel
from loopshape.identify.matrix.decoupling import Bands, band_verdicts, octaves
from loopshape.identify.matrix.equivalent_plant import equivalent_plant
from loopshape.identify.matrix.loop_pair import LoopPair

#: below it the source takes two joints as decoupled: H.7 of van den Brink, DCT 2007.002
LIMIT_DB = -20.0


def interaction(
    frf: FRF,
    loops: Sequence[str] | None = None,
    controllers: Mapping[str, Controller] | None = None,
    *,
    outputs: Sequence[str] | None = None,
    limit_db: float = LIMIT_DB,
    bands: Bands | None = None,
) -> Interaction:
    """How the loops of a matrix FRF meet: k_I of each pair, RGA, equivalent plants, verdicts.

    `loops` chooses by name (None: all), `outputs` their rows where names do not tell; `controllers` by loop close the
    others for the equivalent plants; `bands` in Hz are closed, octaves of the valid band by default. Each pair and
    band is judged by itself at 95 %: of twenty that lie on the limit, one may be judged wrong.
    """
    if not np.isfinite(limit_db):
        raise WrongUseError("a limit of the interaction is a number of dB", f"{limit_db!r}", "use -20, the source's")
    square, names = square_part(frf, loops, outputs)
    known = controllers or {}
    stray = sorted(set(known) - set(frf.loop.split("+")) - set(names))
    if stray:
        raise WrongUseError(
            "a controller is of no loop of this FRF", ", ".join(stray), f"name them by loop: {', '.join(names)}"
        )
    square.trusted_lines()  # refuses a FRF without any
    pairs = list(combinations(range(len(names)), 2))
    chosen = tuple(bands) if bands is not None else octaves(square)
    return Interaction(
        frf=square,
        loops=names,
        limit_db=float(limit_db),
        coefficients=tuple(interaction_coefficient(square, i, j, (names[i], names[j])) for i, j in pairs),
        relative_gain=relative_gain(square),
        equivalents=tuple(
            equivalent_plant(square, names, name, known) for name in names if set(names) - {name} <= set(known)
        ),
        verdicts=tuple(
            verdict
            for i, j in pairs
            for verdict in band_verdicts(LoopPair(square, i, j), (names[i], names[j]), float(limit_db), chosen)
        ),
    )


def square_part(
    frf: FRF, loops: Sequence[str] | None = None, outputs: Sequence[str] | None = None
) -> tuple[FRF, tuple[str, ...]]:
    """The part of a matrix FRF that loops make, and their names: loop k goes from input k to output k.

    A column is known by its loop's name where the FRF tells its loops, by its input's name otherwise. A row is known by
    `outputs`, by a channel of the loop's name, or, where the FRF is square, by its place. Loops of the FRF that are
    left out are open; those that it does not have are as they were when it was measured. Refuses fewer than two
    loops, names that are not there, and rows that cannot be told.
    """
    told = tuple(frf.loop.split("+")) if len(frf.loop.split("+")) == len(frf.inputs) else frf.inputs
    names = tuple(loops) if loops else told
    if len(names) < 2 or len(set(names)) < len(names):
        raise WrongUseError(
            "interaction is between two loops at least, each once", ", ".join(names),
            "measure several and estimate their matrix: loopshape frf RUN --matrix",
        )  # fmt: skip
    unknown = [name for name in names if name not in told]
    if unknown:
        raise WrongUseError("a loop is not in the FRF", ", ".join(unknown), f"it has {', '.join(told)}")
    columns = [told.index(name) for name in names]
    rows = _rows(frf, names, columns) if outputs is None else tuple(outputs)
    if len(rows) != len(names):
        raise WrongUseError("each loop has one output", f"{len(rows)} outputs for {len(names)} loops", "name as many")
    return channels(frf, rows, tuple(frf.inputs[k] for k in columns)), names


def _rows(frf: FRF, names: Sequence[str], columns: Sequence[int]) -> tuple[str, ...]:
    by_name = {_bare(output): output for output in frf.outputs}
    if all(name in by_name for name in names):
        return tuple(by_name[name] for name in names)
    if len(frf.outputs) == len(frf.inputs):
        return tuple(frf.outputs[k] for k in columns)
    raise WrongUseError(
        "interaction needs one output for each loop, and the names do not say which",
        f"{len(frf.outputs)} outputs ({', '.join(frf.outputs)}) for the loops {', '.join(names)}",
        "name the outputs in the loops' order",
    )


def _bare(column: str) -> str:
    try:
        return Channel.from_column(column).name
    except WrongUseError:
        return column


def interaction_coefficient(frf: FRF, i: int, j: int, loops: tuple[str, str]) -> Coefficient:
    """k_I of loops i and j of a square FRF, with bounds of |k_I| that hold at any ratio of signal to noise.

    k_I is as fragile as its four factors together: with independent errors of 4 % (sqrt(E|d|²)) in each, k_I has 8 %,
    its magnitude 5.7 %, and the 95 % interval of that is 11 % to each side; 16 % if all four err the worst way.
    """
    pair = LoopPair(frf, i, j)
    low, high = pair.bounds(np.arange(frf.frequency_hz.size))
    return Coefficient(loops, frf.frequency_hz, pair.coefficient, pair.relative_std, low, high, frf.trusted)


def relative_gain(frf: FRF) -> RelativeGain:
    """RGA = H .* inv(H)^T of a square FRF; refuses others, and one that is singular at a line.

    With G = inv(H), dG = -G dH G, so d RGA_ij = G_ji dH_ij - H_ij sum over k, l of G_jk dH_kl G_li.
    Source: Bristol, IEEE Trans. Automatic Control 11, 1966; dynamic as in Skogestad and Postlethwaite, 3.4.
    """
    if len(frf.inputs) != len(frf.outputs):
        raise WrongUseError(
            "relative gains are those of a square FRF", f"{len(frf.outputs)} x {len(frf.inputs)}", "pick channels"
        )
    H = frf.response
    G = invert(H, frf.frequency_hz, "a FRF")
    gain = H * G.transpose(0, 2, 1)
    std = np.stack([_deviation(h, g, c) for h, g, c in zip(H, G, frf.covariance, strict=True)])
    return RelativeGain(frf.outputs, frf.inputs, frf.frequency_hz, gain, std, frf.trusted)


def _deviation(H: ComplexArray, G: ComplexArray, C: ComplexArray) -> Array:
    """sqrt(E|d RGA|²) (n, n) at one line, from the covariance C of vec(H), columns stacked."""
    n = H.shape[0]
    slope = -np.einsum("ij,jk,li->ijlk", H, G, G)  # by element i, j and by dH_kl, l slowest as in vec
    i, j = np.indices((n, n))
    slope[i, j, j, i] += G.T
    J = slope.reshape(n * n, n * n)
    variance = np.real(np.einsum("ab,bc,ac->a", J, C, J.conj(), optimize=True))
    return np.sqrt(np.maximum(variance, 0.0)).reshape(n, n)
