"""What every operation on FRFs shares: operands that fit together, channels by name, errors to first order."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import combinations
from typing import Any, NamedTuple

import numpy as np

from loopshape.core.errors import WrongUseError
from loopshape.core.units import Array, ComplexArray
from loopshape.data.response.frf import FRF, Hold

CONNECT = ("names", "order")
#: what a measurement says of itself and its channels, and no operation carries on
MEASURED = ("coherence", "input_power", "output_power", "cross_power", "multiple_coherence", "partial_coherence")


class Term(NamedTuple):
    """What an operand's error does to a result's: left (nf, ny, p) dX right (nf, q, nu)."""

    frf: FRF
    left: ComplexArray
    right: ComplexArray


def invert(M: ComplexArray, f: Array, what: str) -> ComplexArray:
    """Inverse at each line; refuses one that is singular to rounding whatever the units, with its frequency."""
    even = M
    for axis in (2, 1, 2, 1):
        even = even / np.maximum(np.abs(even).max(axis=axis, keepdims=True), 1e-300)
    size = np.linalg.svd(even, compute_uv=False)
    bad = np.flatnonzero(~(size[:, -1] > 1e-14 * size[:, 0]))
    if bad.size:
        raise WrongUseError(
            f"{what} has no inverse at every frequency", f"{f[bad[0]]:g} Hz", "leave such frequencies out"
        )
    return np.asarray(np.linalg.inv(M))


def eye(frf: FRF, axis: int) -> ComplexArray:
    """Identity (nf, n, n) as large as an FRF's outputs (1) or inputs (2)."""
    nf, n = frf.response.shape[0], frf.response.shape[axis]
    return np.broadcast_to(np.eye(n, dtype=complex), (nf, n, n))


def pick(frf: FRF, rows: Sequence[int], columns: Sequence[int]) -> FRF:
    """Outputs and inputs by number, with their part of the covariances."""
    rows, columns = list(rows), list(columns)
    ny, nu = len(frf.outputs), len(frf.inputs)
    if rows == list(range(ny)) and columns == list(range(nu)):
        return frf
    vec = np.add.outer(ny * np.array(columns), np.array(rows)).ravel()
    changes: dict[str, Any] = dict.fromkeys(MEASURED)
    for name in ("covariance", "noise_covariance"):
        value = getattr(frf, name)
        changes[name] = None if value is None else value[:, vec[:, None], vec[None, :]]
    if frf.multiple_coherence is not None and len(columns) == nu:
        changes["multiple_coherence"] = frf.multiple_coherence[:, rows]
    if frf.partial_coherence is not None and len(columns) == nu:
        changes["partial_coherence"] = frf.partial_coherence[:, rows][:, :, columns]
    return replace(
        frf, response=frf.response[:, rows][:, :, columns], outputs=tuple(frf.outputs[k] for k in rows),
        inputs=tuple(frf.inputs[k] for k in columns), **changes,
    )  # fmt: skip


def channel_order(have: Sequence[str], want: Sequence[str], connect: str, what: str) -> list[int]:
    """Numbers of `have` in the order of `want`; `part` allows that not all are wanted."""
    if connect not in (*CONNECT, "part"):
        raise WrongUseError("channels are connected by names or by order", repr(connect), f"use {' or '.join(CONNECT)}")
    if connect != "part" and len(have) != len(want):
        raise WrongUseError(f"{what} are not as many", f"{', '.join(have)} and {', '.join(want)}", "pick channels")
    if connect == "order":
        return list(range(len(have)))
    twice = len(set(want)) != len(want) or any(have.count(name) > 1 for name in want)
    if twice or not set(want) <= set(have):
        raise WrongUseError(
            f"{what} go by their names, each once", f"{', '.join(have)} and {', '.join(want)}",
            f"use the names {', '.join(have)}" if connect == "part" else 'rename them, or say connect="order"',
        )  # fmt: skip
    return [have.index(name) for name in want]


def check_operands(frfs: Sequence[FRF], independent: bool) -> None:
    """Refuse other lines, other rates, and an FRF with errors that meets itself."""
    for one, two in combinations(frfs, 2):
        f, g = one.frequency_hz, two.frequency_hz
        n = min(f.size, g.size)
        differ = np.flatnonzero(np.abs(f[:n] - g[:n]) > 1e-9 * f[:n])
        if differ.size or f.size != g.size:
            k = int(differ[0]) if differ.size else n
            at = [f"{x[k]:.10g} Hz" if k < x.size else "nothing" for x in (f, g)]
            raise WrongUseError(
                "FRFs at different frequencies are not combined", f"line {k + 1} at {at[0]} and {at[1]}",
                "bring one onto the other's frequencies: regrid(frf, frequency_hz)",
            )  # fmt: skip
        if not independent and one.covariance.any() and two.covariance.any() and one.digest == two.digest:
            raise WrongUseError(
                "one FRF stands twice, and its errors are not independent of themselves", one.method,
                "use feedback, lower_closure or upper_closure, or say independent=True of two measurements",
            )  # fmt: skip
    rates = sorted({frf.rate_hz for frf in frfs if frf.rate_hz > 0.0})
    if len(rates) > 1:
        raise WrongUseError("FRFs of different rates are not put together", f"{rates} Hz", "hold or measure them alike")


def _covariance(terms: Sequence[Term], name: str) -> ComplexArray:
    """Sum of J C J^H with J = right^T x left, over the terms that have errors."""
    first = terms[0]
    nf, ny, nu = first.left.shape[0], first.left.shape[1], first.right.shape[2]
    total = np.zeros((nf, ny * nu, ny * nu), dtype=complex)
    for frf, left, right in terms:
        if not frf.covariance.any():
            continue
        own = getattr(frf, name)
        J = np.einsum("fab,fdc->fcadb", left, right).reshape(nf, ny * nu, own.shape[1])
        total += J @ own @ J.conj().transpose(0, 2, 1)
    made = np.asarray(0.5 * (total + total.conj().transpose(0, 2, 1)), dtype=complex)
    diagonal = np.einsum("fii->fi", made)
    diagonal[...] = np.maximum(diagonal.real, 0.0)  # rounding
    return made


def result(
    word: str, response: ComplexArray, outputs: Sequence[str], inputs: Sequence[str], terms: Sequence[Term]
) -> FRF:
    """An FRF from its parts: valid where all are, with as much freedom as the least known part has."""
    frfs = [term.frf for term in terms]
    unsure = [frf for frf in frfs if frf.covariance.any()] or frfs
    noisy = all(frf.noise_covariance is not None for frf in unsure)
    return FRF(
        frequency_hz=frfs[0].frequency_hz,
        response=response,
        covariance=_covariance(terms, "covariance"),
        noise_covariance=_covariance(terms, "noise_covariance") if noisy else None,
        valid=np.logical_and.reduce([frf.valid for frf in frfs]),
        inputs=tuple(inputs),
        outputs=tuple(outputs),
        method=f"{word} of " + " and ".join(f"({frf.method})" for frf in frfs),
        recording=_joined([frf.recording for frf in frfs]),
        loop=_joined([frf.loop for frf in frfs]),
        rate_hz=max(frf.rate_hz for frf in frfs),
        operating_point=_common([frf.operating_point for frf in unsure]),
        parameters=_common([frf.parameters for frf in unsure]),
        line_overlap=max(frf.line_overlap for frf in frfs),
        variance_freedom=min(frf.variance_freedom for frf in unsure),
        variance_pooled=max(frf.variance_pooled for frf in frfs),
        hold=Hold.INCLUDED if any(frf.hold is Hold.INCLUDED for frf in frfs) else Hold.UNKNOWN,
        notes=tuple(dict.fromkeys([note for frf in frfs for note in frf.notes] + _shared(unsure))),
    )


def _joined(words: Sequence[str]) -> str:
    return "+".join(dict.fromkeys(word for word in words if word))


def _common(tables: Sequence[Any]) -> dict[str, float]:
    """What all say alike."""
    return {name: v for name, v in tables[0].items() if all(name in t and t[name] == v for t in tables)}


def _shared(frfs: Sequence[FRF]) -> list[str]:
    """A note where two operands with errors come from one recording."""
    names = [set(filter(None, frf.recording.split("+"))) for frf in frfs]
    both = sorted({name for one, two in combinations(names, 2) for name in one & two})
    return [f"two FRFs come from {', '.join(both)}: their errors were taken as independent"] if both else []
