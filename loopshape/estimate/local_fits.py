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

from loopshape.estimate.local_models import TINY, Fits, Shape, solve, window_moments
from loopshape.units import Array, ComplexArray


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
            return covariance_of(weights, scatter)
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
    """Covariance (n, m nr, m nr) of sums weights (n, m, nr, w) . V with V of power (n, m, m), alike over the window."""
    n, m, nr, w = weights.shape
    flat = weights.transpose(0, 2, 1, 3).reshape(n, nr * m, w)
    return np.asarray((flat @ flat.conj().transpose(0, 2, 1)) * np.tile(scatter, (1, nr, nr)))


def fit_lines(X: ComplexArray, R: ComplexArray, lines: np.ndarray, low: int, high: int, window: Window) -> LocalFit:
    """Fits at `lines` (n,) of transforms X (m, nf) and R (nr, nf), with windows inside [low, high].

    Near an end the window stays inside, and the line is no longer its middle.
    """
    half, m = window.half, X.shape[0]
    centre = np.clip(lines, low + half, high - half)
    rows = centre[:, None] + np.arange(-half, half + 1)
    at = (rows - lines[:, None]) / half
    powers = np.stack([at**s for s in range(window.order + 1)], axis=-1)
    shared = [R[a][rows][:, :, None] * powers for a in range(R.shape[0])] + [powers.astype(complex)]
    here = lines - centre + half
    data = X[:, rows]  # (m, n, w)
    if window.poles == 0:
        parts = [_solve(np.concatenate(shared, axis=-1), data, R.shape[0], window, here)]
        weights = np.broadcast_to(parts[0][0][:, None], (lines.size, m, R.shape[0], rows.shape[1]))
    else:
        degrees = np.arange(1, window.poles + 1)
        denominators = [-data[i][:, :, None] * at[:, :, None] ** degrees for i in range(m)]
        parts = [
            _solve(np.concatenate([*shared, d], axis=-1), data[i : i + 1], R.shape[0], window, here)
            for i, d in enumerate(denominators)
        ]
        weights = np.stack([p[0] for p in parts], axis=1)
    residual = np.concatenate([p[1] for p in parts], axis=0)
    leverages = np.stack([p[3] for p in parts], axis=1)
    freedom = rows.shape[1] - window.unknowns(R.shape[0])
    return LocalFit(
        response=np.einsum("niaw,inw->nia", weights, data),
        weights=weights,
        first=rows[:, 0],
        scatter=np.einsum("inw,jnw->nij", residual, residual.conj()) / freedom,
        freedom=freedom,
        left_out=np.concatenate([p[2] for p in parts], axis=1),
        residual=np.asarray(residual.transpose(1, 0, 2) / np.sqrt(1.0 - leverages), dtype=complex)
        if window.poles
        else None,
    )


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
) -> tuple[ComplexArray, ComplexArray, ComplexArray, Array]:
    """Weights (n, nr, w) of the responses, residuals (m, n, w), left-out residuals (n, m) at the line itself, and
    leverages (n, w)."""
    Q, triangle = _qr(A)
    tops = [a * (window.order + 1) for a in range(instruments)]
    adjoint = Q.conj().transpose(0, 2, 1)
    try:
        weights = np.linalg.inv(triangle)[:, tops] @ adjoint
    except np.linalg.LinAlgError:
        weights = np.linalg.pinv(triangle)[:, tops] @ adjoint
    stacked = data.transpose(1, 2, 0)  # (n, w, m)
    residual = stacked - Q @ (adjoint @ stacked)
    n = np.arange(here.size)
    leverage = np.minimum((np.abs(Q) ** 2).sum(-1), 1.0 - 1e-9)
    left_out = residual[n, here] / (1.0 - leverage[n, here])[:, None]
    return weights, residual.transpose(2, 0, 1), left_out, leverage


def _qr(A: ComplexArray) -> tuple[ComplexArray, ComplexArray]:
    """QR of (n, w, p) by two Cholesky factorisations, as exact as reflections where the first succeeds (Yamamoto,
    Nakatsukasa, Yanagisawa, Fukaya, ETNA 44, 2015), and by reflections where it does not."""
    size = np.sqrt(np.maximum(np.einsum("nwp,nwp->np", A, A.conj()).real, TINY))
    try:
        Q, first = _orthogonal(A / size[:, None])
        Q, second = _orthogonal(Q)
    except np.linalg.LinAlgError:
        return np.linalg.qr(A)
    return Q, np.asarray(second @ first * size[:, None], dtype=complex)


def _orthogonal(A: ComplexArray) -> tuple[ComplexArray, ComplexArray]:
    upper = np.linalg.cholesky(A.conj().transpose(0, 2, 1) @ A).conj().transpose(0, 2, 1)
    return np.asarray(A @ np.linalg.inv(upper)), np.asarray(upper)
