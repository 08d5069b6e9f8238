"""Local polynomials and rationals from the moments of their windows (`kernels.local_sums`), many windows at a time.

Over a window an answer's transform is X(k) = (N(t) R(k) + T(t)) / D(t) + V(k) with N and T polynomials of the distance
t from the frequency in question, and D = 1 without poles. With poles the equations are those of D X = N R + T, and all
answers share D: in one loop they have the same poles (McKelvey, Guerin, SYSID 2012).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from loopshape.core.kernels.local_sums import Solved, Windows, influence, moments, shifted
from loopshape.core.units import Array, ComplexArray

#: what keeps equations regular that say the same twice, relative to their own size
REGULAR = 1e-12
TINY = 1e-60


@dataclass(frozen=True)
class Shape:
    """Order of N and T, degree of the denominator, whether a transient is fitted too, and how many instruments."""

    order: int
    poles: int
    transient: bool = True
    instruments: int = 1

    @property
    def powers(self) -> int:
        """How many moments the equations need."""
        return 2 * max(self.order, self.poles) + 1

    @property
    def columns(self) -> tuple[np.ndarray, np.ndarray]:
        """Signal and power of t of each coefficient of N and T."""
        each, signals = np.arange(self.order + 1), self.instruments + int(self.transient)
        return np.repeat(np.arange(signals), each.size), np.tile(each, signals)


@dataclass(frozen=True, eq=False)
class Fits:
    """Fits at (...) windows of q coefficients to m answers.

    `inverse` (..., q, q) of the normal equations, `theta` (..., q, m) the coefficients, N(0) first; `denominator`
    (..., 1 + poles); `bends` (..., poles, q, m) by what coefficients answer to the denominator's; `pull`
    (..., poles, poles, m) by what the denominator answers to residuals, projected, `forms` (..., poles, poles) the
    denominator's covariance over the noise's power where there is one answer. `gain` (..., m) is N(0)'s variance
    over the noise's, `scatter` (..., m, m) the noise's covariance E[v v^H], with `freedom` (...).
    """

    inverse: ComplexArray
    theta: ComplexArray
    denominator: ComplexArray
    bends: ComplexArray
    pull: ComplexArray
    forms: ComplexArray
    gain: Array
    scatter: ComplexArray
    freedom: Array

    @property
    def response(self) -> ComplexArray:
        """H (..., m) to the first instrument at the line in question."""
        return np.asarray(self.theta[..., 0, :])

    @property
    def power(self) -> Array:
        """The noise's power (..., m)."""
        return np.maximum(np.einsum("...xx->...x", self.scatter).real, TINY)


def window_moments(
    z: ComplexArray, lines: np.ndarray, left: np.ndarray, right: np.ndarray, powers: int
) -> ComplexArray:
    """Moments (n, windows, powers, s, s) of z (nf, s) about `lines` (n,), t over half of each window [left, right]."""
    M = np.zeros((lines.size, left.shape[1], powers, z.shape[1], z.shape[1]), dtype=complex)
    moments(z, lines, left, right, powers, M)
    widest = (right - left)[:, -1:] / (right - left)
    M *= widest[:, :, None, None, None] ** np.arange(powers)[:, None, None]
    rows, columns = np.tril_indices(z.shape[1], -1)
    M[..., rows, columns] = M[..., columns, rows].conj()
    return M


def solve(M: ComplexArray, count: Array, shape: Shape, ridge: Array | None = None) -> Fits:
    """Fits to moments M (..., powers, s, s) of windows of `count` (...) lines, with `ridge` (..., order + 1) on T.

    A ridge is the noise's power over the expected power of T's coefficients; the result is then the posterior mean.
    """
    signal, power = shape.columns
    first, m = shape.instruments + 1, M.shape[-1] - shape.instruments - 1
    G = M[..., power[:, None] + power, signal[:, None], signal]
    if ridge is not None:
        held = np.arange(power.size - shape.order - 1, power.size)
        G[..., held, held] += ridge
    a = np.repeat(np.arange(shape.poles + 1), m)
    x = np.tile(np.arange(first, first + m), shape.poles + 1)
    GZ = M[..., power[:, None] + a, signal[:, None], x]
    ZZ = M[..., a[:, None] + a, x[:, None], x]
    inverse = _inverse(G)
    theta = inverse @ GZ
    left = ZZ - GZ.conj().swapaxes(-1, -2) @ theta
    freedom = count - power.size - shape.poles / m
    theta = theta.reshape(*theta.shape[:-1], shape.poles + 1, m)
    left = left.reshape(*left.shape[:-2], shape.poles + 1, m, shape.poles + 1, m)
    if shape.poles == 0:
        return _without_poles(inverse, theta, left, freedom)
    energy = np.einsum("...aa->...a", ZZ).real[..., :m]
    return _with_poles(inverse, theta, left, energy, freedom)


def _inverse(G: ComplexArray) -> ComplexArray:
    """Inverse (..., q, q) of normal equations, whatever the units of their coefficients."""
    d = 1.0 / np.sqrt(np.maximum(np.einsum("...ii->...i", G).real, TINY))
    unit = d[..., :, None] * G * d[..., None, :] + REGULAR * np.eye(G.shape[-1])
    return np.asarray(d[..., :, None] * np.linalg.inv(unit) * d[..., None, :])


def _without_poles(inverse: ComplexArray, theta: ComplexArray, left: ComplexArray, freedom: Array) -> Fits:
    lead, q, m = theta.shape[:-3], theta.shape[-3], theta.shape[-1]
    return Fits(
        inverse=inverse,
        theta=theta[..., 0, :],
        denominator=np.ones((*lead, 1), dtype=complex),
        bends=np.zeros((*lead, 0, q, m), dtype=complex),
        pull=np.zeros((*lead, 0, 0, m), dtype=complex),
        forms=np.zeros((*lead, 0, 0), dtype=complex),
        gain=np.broadcast_to(inverse[..., 0, 0].real[..., None], (*lead, m)),
        scatter=left[..., 0, :, 0, :].conj() / freedom[..., None, None],
        freedom=freedom,
    )


def _with_poles(inverse: ComplexArray, theta: ComplexArray, left: ComplexArray, energy: Array, freedom: Array) -> Fits:
    """The denominator that leaves least over all answers, each in units of what a denominator of its own leaves."""
    own = np.einsum("...axbx->...xab", left)
    least = np.einsum("...a,...a->...", own[..., 0, :], _denominator(own)).real
    # an answer's noise is taken to be this share of its energy at least, where answers are weighed against each other
    weight = 1.0 / np.maximum(least, 1e-9 * energy + TINY)
    W = np.einsum("...x,...xab->...ab", weight, own)
    V, D = _inverse(W[..., 1:, 1:]), _denominator(W)
    scatter = np.einsum("...a,...axby,...b->...xy", D, left.conj(), D.conj()) / freedom[..., None, None]
    bends = np.moveaxis(theta[..., 1:, :], -3, -2)
    power = np.maximum(np.einsum("...xx->...x", scatter).real, TINY)
    moved = np.einsum("...px,...pl,...lx->...x", bends[..., 0, :], V, bends[..., 0, :].conj()).real
    mean = (weight * power).mean(axis=-1)[..., None]
    return Fits(
        inverse=inverse,
        theta=np.einsum("...qax,...a->...qx", theta, D),
        denominator=D,
        bends=bends,
        pull=-V[..., None] * weight[..., None, None, :],
        forms=V * weight.mean(axis=-1)[..., None, None],
        gain=inverse[..., 0, 0].real[..., None] + moved * mean / power,
        scatter=scatter,
        freedom=freedom,
    )


def _denominator(W: ComplexArray) -> ComplexArray:
    """(1, d) (..., 1 + poles) that leaves least of quadratic forms W (..., 1 + poles, 1 + poles)."""
    d = -(_inverse(W[..., 1:, 1:]) @ W[..., 1:, :1])[..., 0]
    return np.concatenate([np.ones((*d.shape[:-1], 1)), d], axis=-1)


def influences(
    z: ComplexArray, lines: np.ndarray, left: np.ndarray, right: np.ndarray, order: int, fits: Fits
) -> tuple[ComplexArray, Array]:
    """What residuals move responses by: squares (n, m, m), and effective lines (n,).

    Fits over one window [left, right] at each of `lines` (n,); see `kernels.local_sums.influence`.
    """
    n, m = fits.response.shape
    total, effective = np.zeros((n, m, m), dtype=complex), np.empty(n)
    influence(z, Windows(lines, left, right, order), _solved(fits), total, effective)
    return total, effective


def at_gates(
    z: ComplexArray, lines: np.ndarray, left: np.ndarray, right: np.ndarray, order: int, fits: Fits, gates: Array
) -> tuple[ComplexArray, ComplexArray]:
    """What residuals would move responses by at other times, (n, gates, m), and of what fits take away, (n, gates, q).

    Fits over one window [left, right] at each of `lines` (n,); see `kernels.local_sums.shifted`.
    """
    n, q, m = fits.theta.shape
    moves, columns = np.zeros((n, gates.size, m), dtype=complex), np.zeros((n, gates.size, q), dtype=complex)
    shifted(z, Windows(lines, left, right, order), _solved(fits), gates, moves, columns)
    return moves, columns


def _solved(fits: Fits) -> Solved:
    """What the kernels take of fits."""
    return Solved(*(np.ascontiguousarray(getattr(fits, part), dtype=complex) for part in Solved._fields))
