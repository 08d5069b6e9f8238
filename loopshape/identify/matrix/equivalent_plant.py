"""The plant that a loop's controller meets while other loops are closed, and what closing them changes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from loopshape.core.errors import WrongUseError
from loopshape.core.units import Array, ComplexArray, deg
from loopshape.data.algebra.propagation import invert, pick
from loopshape.data.control.controller import Controller
from loopshape.data.response.frf import FRF
from loopshape.data.response.interaction import EquivalentPlant
from loopshape.identify.matrix.magnitude_bounds import magnitude_bounds


def equivalent_plant(
    frf: FRF, names: Sequence[str], loop: str, controllers: Mapping[str, Controller]
) -> EquivalentPlant:
    """P_ii - P_ij K (I + P_jj K)^-1 P_ji of a square FRF whose k-th loop is `names[k]`, with all others closed by K.

    For two loops closed/open = 1 - k_I T_j, with T_j what the other loop makes of its reference. To first order, which
    misleads where I + P_jj K is small beside its error; whether the inner loop is stable no line can say by itself.
    """
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
        name: _spread(slope, C, slope)[:, None, None].astype(complex)
        for name in ("covariance", "noise_covariance")
        if (C := getattr(frf, name)) is not None
    }
    others = tuple(names[k] for k in rest)
    closed = replace(
        own,
        response=value[:, None, None],
        method=f"{frf.method}, with {', '.join(others)} closed",
        open_loop=False,
        **changes,
    )
    return _compared(frf, own, closed, slope, i, others)


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


def _spread(one: ComplexArray, covariance: ComplexArray, two: ComplexArray) -> Array:
    """Real part of one C two^H at each line, not negative where both are one."""
    made = np.real(np.einsum("fi,fij,fj->f", one, covariance, two.conj(), optimize=True))
    return np.asarray(np.maximum(made, 0.0))


def _compared(frf: FRF, own: FRF, closed: FRF, slope: ComplexArray, i: int, others: tuple[str, ...]) -> EquivalentPlant:
    """Closed over open: both err by the same dP, so their relative errors are taken off each other first."""
    by_own = np.zeros_like(slope)
    by_own[:, i * len(frf.outputs) + i] = 1.0
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = closed.siso / own.siso
        # d(closed/open) = (d closed - ratio d open)/open: finite where the closed plant is zero
        deviation = np.sqrt(_spread(s := (slope - ratio[:, None] * by_own) / own.siso[:, None], frf.covariance, s))
        relative = deviation / np.abs(ratio)
    low, high = magnitude_bounds(np.abs(ratio), deviation, frf.variance_freedom)
    reach = np.minimum(high / np.abs(ratio) - 1.0, 1.0)
    reach_deg = np.where((low > 0.0) & (reach < 1.0), deg(np.arcsin(reach)), 180.0)
    return EquivalentPlant(own.loop, others, own, closed, ratio, relative, low, high, reach_deg)
