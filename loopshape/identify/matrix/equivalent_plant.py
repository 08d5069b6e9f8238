"""The loops of a matrix FRF: its square part, and the plant that a loop's controller meets with others closed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from loopshape.core.errors import WrongUseError
from loopshape.core.units import Array, ComplexArray
from loopshape.data.algebra import channels
from loopshape.data.algebra.propagation import invert, pick
from loopshape.data.control.controller import Controller
from loopshape.data.response.frf import FRF
from loopshape.data.signal.channel import Channel


def equivalent_plant(frf: FRF, names: Sequence[str], loop: str, controllers: Mapping[str, Controller]) -> FRF:
    """P_ii - P_ij K (I + P_jj K)^-1 P_ji of a square FRF whose k-th loop is `names[k]`, with all others closed by K.

    For two loops closed/open = 1 - k_I T_j, with T_j what the other loop makes of its reference. To first order, which
    misleads where I + P_jj K is small beside its error; whether the inner loop is stable no line can say by itself.
    """
    return with_slopes(frf, names, loop, controllers)[0]


def with_slopes(
    frf: FRF, names: Sequence[str], loop: str, controllers: Mapping[str, Controller]
) -> tuple[FRF, ComplexArray]:
    """The equivalent plant, and its slopes (nf, n²) by vec(P), columns stacked."""
    if loop not in names:
        raise WrongUseError("a loop is not in the FRF", loop, f"it has {', '.join(names)}")
    i = list(names).index(loop)
    rest = [k for k in range(len(names)) if k != i]
    missing = [names[k] for k in rest if names[k] not in controllers]
    if missing:
        raise WrongUseError(
            f"the plant that {loop} meets needs the other loops' controllers", f"none of {', '.join(missing)}",
            "give them by loop",
        )  # fmt: skip
    own = replace(pick(frf, [i], [i]), loop=loop)
    K = _diagonal([controllers[names[k]] for k in rest], frf.frequency_hz)
    value, slope = _closure(frf.response, K, i, rest, frf.frequency_hz)
    changes: dict[str, Any] = {
        name: spread(slope, C)[:, None, None].astype(complex)
        for name in ("covariance", "noise_covariance")
        if (C := getattr(frf, name)) is not None
    }
    method = f"{frf.method}, with {', '.join(names[k] for k in rest)} closed"
    return replace(own, response=value[:, None, None], method=method, open_loop=False, **changes), slope


def _diagonal(controllers: Sequence[Controller], f: Array) -> ComplexArray:
    K = np.zeros((f.size, len(controllers), len(controllers)), dtype=complex)
    for k, one in enumerate(controllers):
        K[:, k, k] = one.response(f)
    return K


def _closure(P: ComplexArray, K: ComplexArray, i: int, rest: Sequence[int], f: Array) -> tuple[ComplexArray, ...]:
    """Equivalent plant (nf,) and its slopes (nf, n²) by vec(P), columns stacked.

    dP_e = [1, -P_ij X] dP [1; -X P_ji] with X = K (I + P_jj K)^-1: from outside, z_i and what it makes of the others.
    """
    inner = P[:, rest][:, :, rest]
    X = K @ invert(np.eye(len(rest)) + inner @ K, f, "I + P K of the other loops")
    left, right = (np.zeros(P.shape[:2], dtype=complex) for _ in range(2))
    left[:, i] = right[:, i] = 1.0
    left[:, rest] = -np.einsum("fj,fjk->fk", P[:, i, rest], X)
    right[:, rest] = -np.einsum("fjk,fk->fj", X, P[:, rest, i])
    value = P[:, i, i] + np.einsum("fj,fj->f", left[:, rest], P[:, rest, i])
    return value, np.einsum("fl,fk->flk", right, left).reshape(P.shape[0], -1)


def spread(slope: ComplexArray, covariance: ComplexArray) -> Array:
    """Variance (nf,) of what has slopes (nf, m) by values of a covariance (nf, m, m)."""
    made = np.real(np.einsum("fi,fij,fj->f", slope, covariance, slope.conj(), optimize=True))
    return np.asarray(np.maximum(made, 0.0))


def square_part(
    frf: FRF, loops: Sequence[str] | None = None, outputs: Sequence[str] | None = None, *, least: int = 2
) -> tuple[FRF, tuple[str, ...]]:
    """The part of a matrix FRF that loops make, and their names: loop k goes from input k to output k.

    A column is known by its loop's name where the FRF tells its loops, by its input's name otherwise. A row is known by
    `outputs`, by a channel of the loop's name, or, where the FRF is square, by its place. Loops of the FRF that are
    left out are open; those that it does not have are as they were when it was measured. Refuses fewer than
    `least` loops, names that are not there, and rows that cannot be told.
    """
    known = tuple(frf.loop.split("+")) if len(frf.loop.split("+")) == len(frf.inputs) else frf.inputs
    names = tuple(loops) if loops else known
    if len(names) < least or len(set(names)) < len(names):
        raise WrongUseError(
            "interaction is between two loops at least, each once", ", ".join(names),
            "measure several and estimate their matrix: loopshape frf RUN --matrix",
        )  # fmt: skip
    unknown = [name for name in names if name not in known]
    if unknown:
        raise WrongUseError("a loop is not in the FRF", ", ".join(unknown), f"it has {', '.join(known)}")
    columns = [known.index(name) for name in names]
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
        "each loop needs one output, and the names do not say which",
        f"{len(frf.outputs)} outputs ({', '.join(frf.outputs)}) for the loops {', '.join(names)}",
        "name the outputs in the loops' order",
    )


def _bare(column: str) -> str:
    try:
        return Channel.from_column(column).name
    except WrongUseError:
        return column
