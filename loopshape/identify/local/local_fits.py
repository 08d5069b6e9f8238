"""Local polynomials and rationals over the lines of a whole record, by least squares at each line.

The transform of a whole record is X(k) = H(k) R(k) + T(k) + V(k): the transient T of start and end is as smooth as H.
Over a window of lines about one, both are polynomials of the distance (Pintelon, Schoukens, Vandersteen, Barbe, MSSP
24, 2010), or share a local denominator, which follows resonances sharper than the window (McKelvey, Guerin,
SYSID 2012).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from loopshape.core.units import Array, ComplexArray
from loopshape.identify.local.local_models import TINY, Fits, Shape, solve, window_moments


@dataclass(frozen=True, order=True)
class Window:
    """Half width in lines, order of the polynomials, and degree of the local denominator (0: none)."""

    half: int
    order: int
    poles: int

    def unknowns(self, instruments: int) -> int:
        """How many numbers are fitted at each line."""
        return (self.order + 1) * (instruments + 1) + self.poles

    @property
    def words(self) -> str:
        """For people."""
        kind = f"rationals of order {self.order}/{self.poles}" if self.poles else f"polynomials of order {self.order}"
        return f"local {kind} over {2 * self.half + 1} lines"


@dataclass(frozen=True, eq=False)
class LocalFit:
    """Fits at n lines: response (n, m, nr), weights (n, m, nr, w) with H = weights . X, first line of each window (n,).

    `scatter` (n, m, m) is the noise's power left over, with `freedom` complex degrees of freedom; `left_out` (n, m) is
    what each line would have been missed by, had it not been among those fitted. `residual` (n, m, w), each over the
    root of one less its leverage, is kept of rationals: what their denominator makes of noise differs along the window,
    and their spread is summed line by line (White 1980; MacKinnon and White 1985, HC2).
    """

    response: ComplexArray
    weights: ComplexArray
    first: np.ndarray
    scatter: ComplexArray
    freedom: int
    left_out: ComplexArray
    residual: ComplexArray | None = None

    @property
    def spread(self) -> ComplexArray:
        """Covariance (n, m nr, m nr) of vec(response), columns stacked."""
        return self.spread_of(self.weights, self.scatter)

    def spread_of(self, weights: ComplexArray, scatter: ComplexArray) -> ComplexArray:
        """Covariance of other sums over the same windows: by the residuals where they are kept, else by `scatter`."""
        if self.residual is None:
            return covariance_of(weights[:, 0], scatter)
        n, m, nr, w = weights.shape
        moved = (weights * self.residual[:, :, None]).transpose(0, 2, 1, 3).reshape(n, nr * m, w)
        return np.asarray(moved @ moved.conj().transpose(0, 2, 1))

    @property
    def independent(self) -> float:
        """How many residuals the spread rests on, in complex numbers: all degrees of freedom, or those weighed."""
        if self.residual is None:
            return float(self.freedom)
        power = np.abs(self.weights[:, 0, 0]) ** 2
        return float(np.median(power.sum(-1) ** 2 / (power**2).sum(-1)))


def covariance_of(weights: ComplexArray, scatter: ComplexArray) -> ComplexArray:
    """Covariance (n, m nr, m nr) of sums weights (n, nr, w) . V with V of power (n, m, m), alike over the window."""
    n, nr, _ = weights.shape
    m = scatter.shape[1]
    power = weights @ weights.conj().transpose(0, 2, 1)
    return np.asarray((power[:, :, None, :, None] * scatter[:, None, :, None, :]).reshape(n, nr * m, nr * m))


def fit_lines(X: ComplexArray, R: ComplexArray, lines: np.ndarray, low: int, high: int, window: Window) -> LocalFit:
    """Fits at `lines` (n,) of transforms X (m, nf) and R (nr, nf), with windows inside [low, high].

    Near an end the window stays inside, and the line is no longer its middle.
    """
    half, m = window.half, X.shape[0]
    centre = np.clip(lines, low + half, high - half)
    rows = centre[:, None] + np.arange(-half, half + 1)
    at = (rows - lines[:, None]) / half
    shared = _columns(R, rows, at if (centre != lines).any() else at[:1], window)
    here = lines - centre + half
    data = X[:, rows]  # (m, n, w)
    if window.poles == 0:
        parts = [_solve(shared, data, R.shape[0], window, here)]
        weights = np.broadcast_to(parts[0][0][:, None], (lines.size, m, R.shape[0], rows.shape[1]))
    else:
        degrees = np.arange(1, window.poles + 1)
        denominators = [-data[i][:, :, None] * at[:, :, None] ** degrees for i in range(m)]
        parts = [
            _solve(np.concatenate([shared, d], axis=-1), data[i : i + 1], R.shape[0], window, here)
            for i, d in enumerate(denominators)
        ]
        weights = np.stack([p[0] for p in parts], axis=1)
    residual = np.concatenate([p[1] for p in parts], axis=-1).transpose(0, 2, 1)  # (n, m, w)
    leverages = np.stack([p[2] for p in parts], axis=1)
    freedom = rows.shape[1] - window.unknowns(R.shape[0])
    n = np.arange(lines.size)
    return LocalFit(
        response=(data.transpose(1, 0, 2)[:, :, None] @ weights.swapaxes(-1, -2))[:, :, 0],
        weights=weights,
        first=rows[:, 0],
        scatter=residual @ residual.conj().swapaxes(-1, -2) / freedom,
        freedom=freedom,
        left_out=np.asarray(residual[n, :, here] / (1.0 - leverages[n, :, here if window.poles else 0]), dtype=complex),
        residual=np.asarray(residual / np.sqrt(1.0 - leverages), dtype=complex) if window.poles else None,
    )


def _columns(R: ComplexArray, rows: np.ndarray, at: Array, window: Window) -> ComplexArray:
    """Columns (n, w, p) of the polynomials of every instrument (nr, nf) and of the transient; `at` (n or 1, w)."""
    terms = window.order + 1
    powers = np.cumprod(np.stack([np.ones_like(at), *[at] * window.order], axis=-1), axis=-1)
    out = np.empty((*rows.shape, (R.shape[0] + 1) * terms), dtype=complex)
    for a in range(R.shape[0]):
        np.multiply(R[a][rows][:, :, None], powers, out=out[:, :, a * terms : (a + 1) * terms])
    out[:, :, -terms:] = powers
    return out


def predicted(
    X: ComplexArray, R: ComplexArray, lines: np.ndarray, low: int, high: int, windows: Sequence[Window]
) -> tuple[ComplexArray, ComplexArray]:
    """Responses (windows, n, m, nr) and left-out residuals (windows, n, m) of `fit_lines`, over several windows of one
    order and degree, narrowest first, from moments: each line of the record is looked at once for all of them."""
    nr, m, half = R.shape[0], X.shape[0], np.array([w.half for w in windows])
    shape = Shape(windows[0].order, windows[0].poles, instruments=nr)
    z = np.concatenate([R, np.ones_like(R[:1]), X]).T
    unit = np.sqrt(np.maximum(np.mean(np.abs(z) ** 2, axis=0), TINY))
    z = np.ascontiguousarray(z / unit)
    middle = np.clip(lines[:, None], low + half, high - half)
    M = window_moments(z, lines, middle - half, middle + half, shape.powers)
    count = np.broadcast_to(2.0 * half + 1.0, M.shape[:2])
    response, left_out = (
        np.empty((half.size, lines.size, m, nr), complex),
        np.empty((half.size, lines.size, m), complex),
    )
    for i in range(m):
        kept = [*range(nr + 1), nr + 1 + i]
        fits = solve(M[..., kept, :][..., kept], count, shape)
        tops = np.arange(nr + 1) * (shape.order + 1)
        at = np.einsum("nka,na->nk", fits.theta[:, :, tops, 0], z[lines][:, : nr + 1])
        leverage = _leverage(fits, tops, z[lines][:, : nr + 1])
        response[:, :, i] = fits.theta[:, :, tops[:nr], 0].swapaxes(0, 1) * (unit[nr + 1 + i] / unit[:nr])
        left_out[:, :, i] = ((z[lines, nr + 1 + i][:, None] - at) / (1.0 - leverage)).T * unit[nr + 1 + i]
    return response, left_out


def _leverage(fits: Fits, tops: np.ndarray, here: ComplexArray) -> Array:
    """Leverage (n, windows) of the lines themselves, where only the lowest coefficients count; `here` (n, nr + 1)."""
    inverse = fits.inverse[:, :, tops[:, None], tops]
    out = np.einsum("na,nkab,nb->nk", here, inverse, here.conj()).real
    if fits.bends.shape[2]:
        own = np.einsum("na,nkpa->nkp", here, fits.bends[:, :, :, tops, 0])
        out = out + np.einsum("nkp,nkpq,nkq->nk", own, fits.forms, own.conj()).real
    return np.asarray(np.minimum(out, 1.0 - 1e-9))


def _solve(
    A: ComplexArray, data: ComplexArray, instruments: int, window: Window, here: np.ndarray
) -> tuple[ComplexArray, ComplexArray, Array]:
    """Weights (n, nr, w) of the responses, residuals (n, w, m), and leverages: (n, w), or (n, 1) those of the line
    itself where there is no denominator."""
    tops = [a * (window.order + 1) for a in range(instruments)]
    stacked, inverse = data.transpose(1, 2, 0), _inverse(A)
    wanted = slice(None) if window.poles else here[:, None]
    if inverse is None:
        return _by_reflections(A, stacked, tops, wanted)
    adjoint = A.conj().transpose(0, 2, 1)
    residual = stacked - A @ (inverse @ (adjoint @ stacked))
    own = A[np.arange(here.size)[:, None], wanted] if window.poles == 0 else A
    leverage = np.einsum("nwp,nwp->nw", own @ inverse, own.conj()).real
    return inverse[:, tops] @ adjoint, residual, np.minimum(leverage, 1.0 - 1e-9)


def _inverse(A: ComplexArray) -> ComplexArray | None:
    """Inverses (n, p, p) of A^H A for A (n, w, p), None where a column of one of them is nearly the others' sum."""
    G = A.conj().transpose(0, 2, 1) @ A
    size = np.sqrt(np.maximum(np.einsum("npp->np", G).real, TINY))
    try:
        root = np.linalg.cholesky(G / (size[:, :, None] * size[:, None, :]))
    except np.linalg.LinAlgError:
        return None
    # a column of which this share or less is its own makes normal equations lose half their digits
    if np.einsum("npp->np", root).real.min() < 1e-2:
        return None
    inverse = np.linalg.inv(root) / size[:, None, :]
    return np.asarray(inverse.conj().transpose(0, 2, 1) @ inverse)


def _by_reflections(
    A: ComplexArray, stacked: ComplexArray, tops: list[int], wanted: slice | np.ndarray
) -> tuple[ComplexArray, ComplexArray, Array]:
    """`_solve` where columns nearly depend on each other."""
    Q, triangle = np.linalg.qr(A)
    adjoint = Q.conj().transpose(0, 2, 1)
    try:
        weights = np.linalg.inv(triangle)[:, tops] @ adjoint
    except np.linalg.LinAlgError:
        weights = np.linalg.pinv(triangle)[:, tops] @ adjoint
    leverage = np.minimum((np.abs(Q) ** 2).sum(-1), 1.0 - 1e-9)
    own = leverage if isinstance(wanted, slice) else np.take_along_axis(leverage, wanted, axis=1)
    return weights, stacked - Q @ (adjoint @ stacked), own
