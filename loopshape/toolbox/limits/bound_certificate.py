"""A proof that no stable Q stays within its regions: a test function that all stable functions are orthogonal to.

For a stable Q the integral of Re h(jw) Q(jw) over w > 0 is zero for every h that is stable too and falls as w^-2
(Cauchy). If Q must lie in the convex regions K(w), the integral is at most that of the support function of K(w) in the
direction of h(jw). Where some h makes this negative no Q exists, of whatever order: h is the certificate. The problem
is that of Helton and Merino, Classical control using H-infinity methods, SIAM 1998; the proof is weak duality.

h is sought among finitely many rational functions by minimising the integral with a smooth maximum (log of a sum of
exponentials) over each polygon's vertices, by Newton's method: either the integral goes below zero, or the minimum
shows that these test functions exclude nothing. A failure to find one proves nothing.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from loopshape.core.units import Array, ComplexArray
from loopshape.toolbox.limits.bound_nodes import weights

#: the integral must lie this far below zero, relative to the integral of |h| times the regions' size
CLEAR = 1e-4

Smooth = tuple[float, Array]


@dataclass(frozen=True, eq=False)
class Poles:
    """Poles of the test functions: real ones in rad/s, and pairs (frequency in rad/s, damping)."""

    real: Array
    pairs: tuple[tuple[float, float], ...]

    def functions(self, s: ComplexArray) -> ComplexArray:
        """Test functions (ns, m) at s: strictly proper fractions, each with one more pole amid the band."""
        columns = [p / (s + p) for p in self.real]
        for w, damping in self.pairs:
            below = s * s + 2.0 * damping * w * s + w * w
            columns += [w * w / below, w * s / below]
        amid = np.sqrt(self.real[0] * self.real[-1])
        return np.array(columns).T * (amid / (s + amid))[:, None]


@dataclass(frozen=True, eq=False)
class Certificate:
    """Coefficients (m,) of a test function, and by how much it excludes (below zero, relative)."""

    poles: Poles
    coefficients: Array
    excess: float

    def test_function(self, s: ComplexArray) -> ComplexArray:
        """h (ns,) at s."""
        return np.asarray(self.poles.functions(s) @ self.coefficients)


def certificate(s: ComplexArray, vertices: ComplexArray, poles: Poles) -> Certificate | None:
    """A certificate that no stable Q lies in the polygons (n, SIDES) at nodes s (n,) = jw, None where none is found."""
    du, dw = weights(s)
    size = np.abs(vertices).max(axis=1)
    functions = poles.functions(s)
    basis, back = _orthonormal(functions * (dw / du)[:, None], np.sqrt(du) * size)
    c = np.zeros(basis.shape[1])
    value, exponents = _smooth(basis, vertices, du, c)
    newton_steps = 60
    for _ in range(newton_steps):
        h = basis @ c
        excess = float(du @ exponents.max(axis=1) / max(du @ (np.abs(h) * size), 1e-300))
        if excess < -CLEAR:
            return Certificate(poles, back @ c, excess)
        step, promised = _newton(basis, vertices, du, exponents)
        if promised < 1e-6:
            return None
        moved = _line_search(partial(_along, basis, vertices, du, c, step), value, promised)
        if moved is None:
            return None
        t, value, exponents = moved
        c = c + t * step
    return None


def _orthonormal(functions: ComplexArray, scale: Array) -> tuple[ComplexArray, Array]:
    """Real combinations of functions (n, m) orthonormal under a scale (n,), and the matrix back to coefficients."""
    scaled = functions * scale[:, None]
    stacked = np.concatenate([scaled.real, scaled.imag])
    norms = np.linalg.norm(stacked, axis=0)
    u, sizes, v = np.linalg.svd(stacked / norms, full_matrices=False)
    kept = sizes > 1e-7 * sizes[0]  # directions in which the test functions differ by less than this are dropped
    back = (v[kept].T / sizes[kept]) / norms[:, None]
    n = scale.size
    return (u[:n, kept] + 1j * u[n:, kept]) / scale[:, None], back


def _smooth(basis: ComplexArray, vertices: ComplexArray, du: Array, c: Array) -> Smooth:
    """Smooth maximum, summed over nodes, and the exponents (n, SIDES) that it is made of."""
    h = basis @ c
    exponents = np.outer(h.real, np.ones(vertices.shape[1])) * vertices.real - h.imag[:, None] * vertices.imag
    top = exponents.max(axis=1)
    return float(du @ (top + np.log(np.exp(exponents - top[:, None]).sum(axis=1)))), exponents


def _along(basis: ComplexArray, vertices: ComplexArray, du: Array, c: Array, step: Array, t: float) -> Smooth:
    return _smooth(basis, vertices, du, c + t * step)


def _newton(basis: ComplexArray, vertices: ComplexArray, du: Array, exponents: Array) -> tuple[Array, float]:
    """Newton's step, and the decrease that it promises (twice what the quadratic model gains)."""
    share = np.exp(exponents - exponents.max(axis=1)[:, None])
    share /= share.sum(axis=1)[:, None]
    mean = (share * vertices).sum(axis=1)
    x, y = vertices.real - mean.real[:, None], vertices.imag - mean.imag[:, None]
    xx, xy, yy = (du * (share * product).sum(axis=1) for product in (x * x, x * y, y * y))
    slope = np.real((du * mean) @ basis)
    re, im = basis.real, basis.imag
    mixed = (re.T * xy) @ im
    curvature = (re.T * xx) @ re - mixed - mixed.T + (im.T * yy) @ im
    curvature[np.diag_indices_from(curvature)] += 1e-9 * np.trace(curvature) / len(curvature) + 1e-300
    step = -cho_solve(cho_factor(curvature), slope)
    return step, float(-slope @ step)


def _line_search(at: Callable[[float], Smooth], value: float, promised: float) -> tuple[float, float, Array] | None:
    """Step length, value and exponents there: halved until it pays, doubled while that pays more; None if never."""
    t, found = 1.0, at(1.0)
    while not found[0] <= value - 0.1 * t * promised:
        t *= 0.5
        if t < 1e-6:
            return None
        found = at(t)
    while 1.0 <= t < 64.0 and (further := at(2.0 * t))[0] < found[0]:
        t, found = 2.0 * t, further
    return t, found[0], found[1]
