"""Structured singular value for one complex error a loop: bounds from both sides, at all lines at once.

mu(M) is one over the size of the smallest diagonal complex Delta that makes I - M Delta singular. It lies between the
spectral radius of M U for any diagonal unitary U, whose largest is mu itself, and the largest singular value of
D M D^-1 for any positive diagonal D (Doyle, IEE Proceedings D 129, 1982; Packard and Doyle, Automatica 29, 1993). For
three loops or fewer the least of the latter is mu; beyond, the two bounds say how far apart they are.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from loopshape.core.units import Array, ComplexArray

#: powers of the norms that lead to the largest singular value: the last one is within n^(1/2p) of it
POWERS = (2.0, 8.0, 32.0, 128.0, 512.0)
_FAR = 12.0  # logarithms of D stay within this of each other's mean
_TINY = 1e-300


class Bounds(NamedTuple):
    """Upper and lower bound of mu (nf,), ln D of the upper one (nf, n), Delta / |Delta| of the lower one (nf, n)."""

    upper: Array
    lower: Array
    log_scales: Array
    phases: ComplexArray


def mu_bounds(M: ComplexArray, *, seed: int = 0) -> Bounds:
    """Bounds of mu of M (nf, n, n); for two loops and fewer the upper one is exact to rounding."""
    osborne = _balanced(M)
    phases, log_scales = _power_iteration(M, osborne, seed)
    lower = _radius(M, phases)
    start = _better(M, osborne, log_scales)
    if M.shape[1] > 2:
        upper = _largest(M, start)
        open_ = np.flatnonzero(upper > (1.0 + 1e-5) * lower)
        start = np.array(start)
        start[open_] = _better(M[open_], start[open_], _minimised(M[open_], start[open_]))
    return Bounds(np.maximum(upper_at(M, start), lower), lower, start, phases)


def upper_at(M: ComplexArray, log_scales: Array) -> Array:
    """Upper bound (nf,) of mu with D = exp(log_scales); exact for two loops, whatever the scales."""
    n = M.shape[-1]
    if n == 1:
        return np.abs(M[..., 0, 0])
    return two_loops(M) if n == 2 else _largest(M, log_scales)


def two_loops(M: ComplexArray) -> Array:
    """Mu of M (..., 2, 2): in D M D^-1 the singular values' product stays, the sum of their squares has a minimum."""
    power = np.abs(M[..., 0, 0]) ** 2 + np.abs(M[..., 1, 1]) ** 2 + 2.0 * np.abs(M[..., 0, 1] * M[..., 1, 0])
    product = 2.0 * np.abs(M[..., 0, 0] * M[..., 1, 1] - M[..., 0, 1] * M[..., 1, 0])
    return np.asarray(0.5 * (np.sqrt(power + product) + np.sqrt(np.maximum(power - product, 0.0))))


def refined(M: ComplexArray, log_scales: Array, steps: int = 3) -> Array:
    """Scales (nf, n) a few steps nearer to the best ones, which even out left and right singular vectors."""
    best, tried = np.array(log_scales), np.array(log_scales)
    value, share, slope = np.full(len(M), np.inf), np.full(len(M), 1.0), np.zeros(best.shape)
    for _ in range(steps):
        u, s, vh = np.linalg.svd(scaled(M, tried))
        falls = s[:, 0] < value
        weight = (s / np.maximum(s[:, :1], _TINY)) ** 16.0  # those near the largest count too
        now = np.einsum("fk,fik->fi", weight, np.abs(u) ** 2 - np.abs(vh.transpose(0, 2, 1)) ** 2)
        best, slope = np.where(falls[:, None], tried, best), np.where(falls[:, None], now, slope)
        value, share = np.where(falls, s[:, 0], value), np.where(falls, share, 0.4 * share)
        tried = best - share[:, None] * slope
    return np.asarray(np.where((_largest(M, tried) < value)[:, None], tried, best))


def scaled(M: ComplexArray, log_scales: Array) -> ComplexArray:
    """D M D^-1."""
    d = np.exp(log_scales)
    return np.asarray(M * (d[..., :, None] / d[..., None, :]))


def _largest(M: ComplexArray, log_scales: Array) -> Array:
    return np.asarray(np.linalg.svd(scaled(M, log_scales), compute_uv=False)[..., 0])


def _better(M: ComplexArray, one: Array, two: Array) -> Array:
    """Of two sets of scales the one with the lower bound, line by line."""
    if not M.size:
        return one
    return np.where((_largest(M, one) <= _largest(M, two))[:, None], one, two)


def _centred(log_scales: Array) -> Array:
    return np.clip(log_scales - log_scales.mean(axis=-1, keepdims=True), -_FAR, _FAR)


def _balanced(M: ComplexArray, rounds: int = 40) -> Array:
    """Logarithms of Osborne's scales (Journal of the ACM 7, 1960): least Frobenius norm, one loop after another."""
    nf, n = M.shape[:2]
    power = np.abs(M) ** 2
    power = power * (1.0 - np.eye(n)) + 1e-14 * power.max(axis=(1, 2), keepdims=True) + _TINY
    x = np.zeros((nf, n))
    for k in range(rounds * n):
        i = k % n
        rest = np.arange(n) != i
        row = (power[:, i, rest] * np.exp(2.0 * (x[:, [i]] - x[:, rest]))).sum(axis=1)
        column = (power[:, rest, i] * np.exp(2.0 * (x[:, rest] - x[:, [i]]))).sum(axis=1)
        if n > 1:
            x[:, i] += 0.25 * np.log(column / row)
    return _centred(x)


def _power_iteration(M: ComplexArray, log_scales: Array, seed: int) -> tuple[ComplexArray, Array]:
    """Phases (nf, n) of the best of some starts, and the scales that their eigenvectors tell.

    Source: Packard, Fan and Doyle, A power method for the structured singular value (CDC 1988). Where it has converged
    on a simple largest singular value, d_i = sqrt(|y_i / x_i|) of left and right eigenvector of M U is the best D.
    """
    nf, n = M.shape[:2]
    u, _, vh = np.linalg.svd(scaled(M, log_scales))
    d = np.exp(log_scales)
    starts = [(vh[:, 0].conj() / d, u[:, :, 0] * d)]
    random = np.random.default_rng(seed)
    for _ in range(3 if n > 1 else 0):
        b, w = random.normal(size=(2, n, 2)) @ np.array([1.0, 1j])
        starts.append((np.tile(b, (nf, 1)), np.tile(w, (nf, 1))))
    best, phases, scales = np.full(nf, -1.0), np.ones((nf, n), dtype=complex), np.zeros((nf, n))
    for b, w in starts:
        a, w = _iterated(M, b.astype(complex), w.astype(complex))
        found = _sign(a.conj() * w)
        size = _radius(M, found)
        better = size > best
        best = np.where(better, size, best)
        phases[better] = found[better]
        ratio = np.log(np.maximum(np.abs(w), 1e-12) / np.maximum(np.abs(a), 1e-12))
        scales[better] = 0.5 * ratio[better]
    return phases, _centred(scales)


def _iterated(M: ComplexArray, b: ComplexArray, w: ComplexArray) -> tuple[ComplexArray, ComplexArray]:
    """Right and left vectors a, w (nf, n) after some rounds."""
    adjoint = M.conj().transpose(0, 2, 1)
    a = b
    for _ in range(60):  # of the power iteration
        a = _unit(np.einsum("fij,fj->fi", M, b))
        z = _sign(w.conj() * a) * w
        w = _unit(np.einsum("fij,fj->fi", adjoint, z))
        b = _sign(a.conj() * w) * a
    return a, w


def _unit(v: ComplexArray) -> ComplexArray:
    return np.asarray(v / np.maximum(np.linalg.norm(v, axis=1, keepdims=True), _TINY))


def _sign(v: ComplexArray) -> ComplexArray:
    """v / |v|, 1 where v is zero."""
    size = np.abs(v)
    return np.where(size > _TINY, v / np.maximum(size, _TINY), 1.0)


def _radius(M: ComplexArray, phases: ComplexArray) -> Array:
    """Spectral radius (nf,) of M U."""
    return np.asarray(np.abs(np.linalg.eigvals(M * phases[:, None, :])).max(axis=1))


def _minimised(M: ComplexArray, log_scales: Array) -> Array:
    """Scales of about the least largest singular value, by Newton's steps on Schatten norms of rising power.

    ln of any unitarily invariant norm of e^X M e^-X is convex in a real diagonal X (three lines theorem).
    """
    x = np.array(log_scales)
    if not len(x):
        return x
    newton = 5  # steps at each power
    for power in POWERS:
        for _ in range(newton):
            x = _stepped(M, x, power)
    return _centred(x)


def _stepped(M: ComplexArray, x: Array, power: float) -> Array:
    """A Newton step, halved until the norm falls; slopes' slopes by differences."""
    n, h = x.shape[1], 1e-4 / power
    value, slope = _norm(M, x, power)
    curve = np.stack(
        [(_norm(M, x + h * e, power)[1] - _norm(M, x - h * e, power)[1]) / (2.0 * h) for e in np.eye(n)], 1
    )
    curve = 0.5 * (curve + curve.transpose(0, 2, 1))
    size = np.maximum(np.trace(curve, axis1=1, axis2=2), 1e-6)[:, None, None]
    curve = curve + size * (1e-6 * np.eye(n) + np.ones((n, n)) / n)  # a common factor of D does nothing
    step = -np.linalg.solve(curve, slope[:, :, None])[:, :, 0]
    step = step / np.maximum(1.0, np.abs(step).max(axis=1, keepdims=True) / 2.0)
    share, out = np.ones(len(x)), x
    for _ in range(8):
        tried = x + share[:, None] * step
        falls = _norm(M, tried, power)[0] < value
        out = np.where((falls & (share > 0.0))[:, None], tried, out)
        share = np.where(falls, 0.0, 0.5 * share)
        if not share.any():
            break
    return out


def _norm(M: ComplexArray, x: Array, power: float) -> tuple[Array, Array]:
    """Ln of the Schatten norm of order 2 power of D M D^-1 (nf,), and its slopes by x (nf, n)."""
    u, s, vh = np.linalg.svd(scaled(M, x))
    top = np.maximum(s[:, :1], _TINY)
    weight = (s / top) ** (2.0 * power)
    total = weight.sum(axis=1)
    difference = np.abs(u) ** 2 - np.abs(vh.transpose(0, 2, 1)) ** 2
    slope = np.einsum("fk,fik->fi", weight / total[:, None], difference)
    return np.log(top[:, 0]) + np.log(total) / (2.0 * power), slope
