"""Tune both controllers and both multirate filters at once: the least worst 3 sigma of nine plants within limits.

Controllers are gains, poles and zeros; every step is a linear programme within a trust region, on exact slopes.
Poles keep a least distance from the unit circle; zeros may lie anywhere.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from hdd_benchmark import System
from hdd_forecast import Forecast, run_out_variance
from hdd_rows import Limits, Rows, rows_of
from scipy.optimize import linprog

from loopshape.core.units import TWO_PI, Array, ComplexArray

#: least distance of a pole from the unit circle
LEAST = 1e-3
#: a search ends where its radius is below this
SMALLEST = 1e-5
#: up to here |S| is held to the reference's, a little beyond 1 kHz for what lies between nodes
LOW_HZ = 1015.0
#: points of 3 sigma that a dB of a missed limit weighs
MISSED = 10.0


@dataclass(frozen=True, eq=False)
class Roots:
    """Zeros and poles of one system in z, pairs by their upper half; gain prod(z - zero)/prod(z - pole)."""

    gain: float
    zeros: ComplexArray
    poles: ComplexArray

    @classmethod
    def of(cls, system: System) -> Roots:
        """Of a state space with feedthrough."""
        zeros = np.linalg.eigvals(system.A - np.outer(system.B, system.C) / system.D)
        return cls(system.D, _upper(zeros), _upper(np.linalg.eigvals(system.A)))

    def with_pairs(self, roots: ComplexArray) -> Roots:
        """With pairs of poles under pairs of zeros, which do nothing."""
        return replace(self, zeros=np.append(self.zeros, roots), poles=np.append(self.poles, roots))

    def system(self) -> System:
        """As a chain of sections of second order in one state space."""
        A, B, C, D = np.zeros((0, 0)), np.zeros(0), np.zeros(0), self.gain
        for num, den in zip(_sections(self.zeros), _sections(self.poles), strict=True):
            a = np.array([[-den[1], -den[2]], [1.0, 0.0]])
            c = np.array([num[1] - den[1], num[2] - den[2]])
            A = np.block([[A, np.zeros((len(A), 2))], [np.outer([1.0, 0.0], C), a]])
            B, C = np.append(B, [D, 0.0]), np.append(C, c)
        return System(A, B, C, D)


def _upper(roots: ComplexArray) -> ComplexArray:
    return roots[roots.imag >= 0.0].astype(complex)


def _sections(roots: ComplexArray) -> list[Array]:
    """Polynomials of second order in z, pairs first, then real roots by twos and with a root at 0 where one is left."""
    pairs = [np.array([1.0, -2.0 * r.real, abs(r) ** 2]) for r in roots[roots.imag > 0.0]]
    real = sorted(roots[roots.imag == 0.0].real)
    real = [*real, 0.0] if len(real) % 2 else list(real)
    return pairs + [np.poly([a, b]) for a, b in zip(real[::2], real[1::2], strict=True)]


@dataclass(frozen=True, eq=False)
class Parameters:
    """Which number of which system a parameter moves, and by how much one unit of it does."""

    system: int
    part: str
    place: int
    step: complex | float


def parameters_of(roots: Sequence[Roots]) -> list[Parameters]:
    """All: gains in ln, real roots along the axis, pairs along and across the circle; steps as their distance to it."""
    out = []
    for k, one in enumerate(roots):
        out.append(Parameters(k, "gain", 0, 1.0))
        for part in ("zeros", "poles"):
            for i, root in enumerate(getattr(one, part)):
                size = max(abs(1.0 - abs(root)), 4.0 * LEAST)
                if part == "poles" and abs(root - 1.0) < 2e-4:
                    continue  # an integrator stays one
                if root.imag == 0.0:
                    out.append(Parameters(k, part, i, min(size, 0.3)))
                else:
                    turn = min(size, 0.3) * root / abs(root)
                    out += [Parameters(k, part, i, turn), Parameters(k, part, i, 1j * turn)]
    return out


def moved(roots: Sequence[Roots], parameters: Sequence[Parameters], dx: Array) -> list[Roots]:
    """Roots after a step; poles stop at their disk's edge, and pairs stay pairs."""
    out = [Roots(one.gain, one.zeros.copy(), one.poles.copy()) for one in roots]
    for p, d in zip(parameters, dx, strict=True):
        if p.part == "gain":
            out[p.system] = replace(out[p.system], gain=out[p.system].gain * float(np.exp(d)))
        else:
            getattr(out[p.system], p.part)[p.place] += d * p.step
    for one, before in zip(out, roots, strict=True):
        free = np.abs(before.poles - 1.0) > 2e-4
        one.poles[free] *= np.minimum(1.0, (1.0 - LEAST) / np.maximum(np.abs(one.poles[free]), 1e-12))
        for part in ("zeros", "poles"):
            pairs, now = getattr(before, part).imag > 0.0, getattr(one, part)
            now.imag[pairs] = np.maximum(now.imag[pairs], 1e-5)
    return out


@dataclass(frozen=True, eq=False)
class Place:
    """Controllers on the nodes: K, L, 3 sigma of each case, and the limits' rows."""

    roots: list[Roots]
    K: ComplexArray
    L: ComplexArray
    sigma: Array
    rows: Rows

    @property
    def worst_miss(self) -> float:
        """Largest miss of a limit."""
        return float(max(0.0, -np.min(self.rows.slack, initial=0.0)))

    @property
    def merit(self) -> float:
        """What a search makes small."""
        return float(self.sigma.max()) + MISSED * self.worst_miss


class Tuner:
    """Linear programmes on nodes under limits."""

    def __init__(self, forecast: Forecast, limits: Limits) -> None:
        self.forecast, self.limits = forecast, limits
        self.run_out = np.zeros(len(forecast.benchmark.cases))

    def place(self, roots: list[Roots]) -> Place:
        """Where the controllers stand."""
        K = self.K(roots)
        L = self.forecast.loops(K)
        sigma = self.forecast.three_sigma(K, L, self.run_out)
        return Place(roots, K, L, sigma, rows_of(L, self.limits, self._ceiling(L.shape)))

    def K(self, roots: Sequence[Roots]) -> ComplexArray:
        """Controllers with filters (n, 2, 2)."""
        z, half = self.forecast.at
        every = [_response(one, z[:, None] if k < 2 else half) for k, one in enumerate(roots)]
        return np.stack([np.broadcast_to(every[k], half.shape) * every[k + 2] for k in (0, 1)], axis=-1)

    def renewed(self, roots: list[Roots]) -> Place:
        """As `place`, with the run-out's part computed anew."""
        self.run_out = run_out_variance(self.forecast.benchmark, lambda other: Tuner(other, self.limits).K(roots))
        return self.place(roots)

    def _ceiling(self, shape: tuple[int, ...]) -> Array:
        every = np.full(shape, self.limits.peak_db)
        if self.limits.low_db is not None:
            low = self.forecast.f <= LOW_HZ
            every[:, low] = np.minimum(every[:, low], self.limits.low_db[:, low])
        return every

    def slopes(self, at: Place, parameters: Sequence[Parameters]) -> tuple[Array, Array]:
        """Slopes of 3 sigma (cases, parameters), without the run-out's, and of the rows' slacks (m, parameters)."""
        pull = self.forecast.variance_slopes(at.K, at.L) * at.K
        share = self.forecast.sampled * at.K / at.L[..., None, None]
        sigma, slack = np.empty((at.sigma.size, len(parameters))), np.empty((at.rows.slack.size, len(parameters)))
        for actuator in (0, 1):
            own = np.array([k for k, p in enumerate(parameters) if p.system % 2 == actuator])
            D = np.array([self._change(at.roots, parameters[k]) for k in own])
            sigma[:, own] = np.real(np.tensordot(pull[..., actuator], D, axes=((1, 2), (1, 2))))
            slack[:, own] = sum(self._at(at.rows, share[..., actuator], D, k) for k in (0, 1))
        scale = 0.5 * (300.0 / self.forecast.benchmark.numbers["track_pitch_m"]) ** 2
        return scale * sigma / at.sigma[:, None], slack

    @staticmethod
    def _at(rows: Rows, share: ComplexArray, D: ComplexArray, beside: int) -> Array:
        """What the rows' first or second nodes add to the slopes."""
        weight = rows.b if beside else rows.a
        used = np.flatnonzero(weight)
        i = rows.i[used] + beside
        out = np.zeros((rows.slack.size, len(D)))
        out[used] = np.real(np.einsum("mp,kmp->mk", weight[used, None] * share[rows.case[used], i], D[:, i]))
        return out

    def _change(self, roots: Sequence[Roots], p: Parameters) -> ComplexArray:
        """d ln K (n, 2) of one actuator by a parameter."""
        z, half = self.forecast.at
        points = z[:, None] if p.system < 2 else half
        if p.part == "gain":
            return np.ones(half.shape, dtype=complex)
        root, step = getattr(roots[p.system], p.part)[p.place], p.step
        if root.imag == 0.0:
            change: ComplexArray = -step / (points - root)
        else:
            step = complex(step)
            change = 2.0 * ((np.conj(root) * step).real - step.real * points) / _factor(points, root)
        return np.broadcast_to(-change if p.part == "poles" else change, half.shape)

    def step(self, at: Place, parameters: Sequence[Parameters], radius: float) -> tuple[Array, float]:
        """The linear programme's step and the merit that it promises."""
        sigma_slopes, slopes = self.slopes(at, parameters)
        binds = at.rows.slack < radius * np.abs(slopes).sum(axis=1)
        n, m = len(parameters), at.sigma.size
        A = np.zeros((m + int(binds.sum()), n + 2))
        A[:m, :n], A[:m, n] = sigma_slopes, -1.0
        A[m:, :n], A[m:, n + 1] = -slopes[binds], -1.0
        b = np.concatenate([-at.sigma, at.rows.slack[binds]])
        cost = np.concatenate([np.zeros(n), [1.0, MISSED]])
        bounds = [(-radius, radius)] * n + [(None, None), (0.0, None)]
        found = linprog(cost, A_ub=A, b_ub=b, bounds=bounds, method="highs")
        return (np.zeros(n), 0.0) if found.x is None else (found.x[:n], at.merit - float(found.fun))


def _factor(points: ComplexArray, root: complex) -> ComplexArray:
    return points - root if root.imag == 0.0 else points * points - 2.0 * root.real * points + abs(root) ** 2


def _response(one: Roots, points: ComplexArray) -> ComplexArray:
    out = np.full(points.shape, one.gain, dtype=complex)
    for root in one.zeros:
        out *= _factor(points, complex(root))
    for root in one.poles:
        out /= _factor(points, complex(root))
    return out


def search(
    tuner: Tuner, roots: list[Roots], most: int, radius: float = 0.05, say: Callable[[str], None] = lambda word: None
) -> list[Roots]:
    """The best within `most` steps."""
    at = tuner.renewed(roots)
    for k in range(most):
        parameters = parameters_of(at.roots)
        dx, promised = tuner.step(at, parameters, radius)
        if promised < 1e-4 or radius < SMALLEST:
            break
        there = tuner.place(moved(at.roots, parameters, dx))
        gained = at.merit - there.merit
        if gained > 0.1 * promised:
            at, radius = tuner.renewed(there.roots), min(radius * (1.6 if gained > 0.5 * promised else 1.0), 0.5)
        else:
            radius *= 0.5
        say(f"{k} {at.sigma.max():.3f} % miss {at.worst_miss:.4f} radius {radius:.4g}")
    return at.roots


def resonators(f_hz: Sequence[float], damping: float) -> ComplexArray:
    """Upper roots in z at Ts of pairs at these frequencies."""
    w = TWO_PI * np.asarray(f_hz) / 50400.0
    return np.exp(-damping * w + 1j * w * np.sqrt(1.0 - damping**2))
