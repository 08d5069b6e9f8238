"""Tune both controllers and both multirate filters at once: the least worst 3 sigma of nine plants within limits.

Controllers are gains, poles and zeros; every step is a linear programme within a trust region, on slopes by differences
of one factor at a time. Poles keep a least distance from the unit circle; zeros may lie anywhere.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from hdd_benchmark import System
from hdd_forecast import Forecast, run_out_variance
from scipy.optimize import linprog

from loopshape.core.units import TWO_PI, Array, ComplexArray, db, deg

#: least distance of a pole from the unit circle
LEAST = 1e-3
#: a search ends where its radius is below this
SMALLEST = 1e-5
#: up to here |S| is held to the reference's, a little beyond 1 kHz for what lies between nodes
LOW_HZ = 1015.0
#: rows nearer to their limit than this (dB, degrees) are seen by a step
NEAR_DB, NEAR_DEG = 2.5, 25.0


@dataclass(frozen=True)
class Limits:
    """Peak of |S|, gain margin either way, phase margin at every plant; up to 1 kHz |S| (cases, n) at most `low_db`."""

    peak_db: float = 6.39
    gain_db: float = 6.5
    phase_deg: float = 48.0
    low_db: Array | None = None


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


def moved(roots: Sequence[Roots], parameters: Sequence[Parameters], dx: Array) -> list[Roots] | None:
    """Roots after a step; None where a pole leaves its disk."""
    out = [Roots(one.gain, one.zeros.copy(), one.poles.copy()) for one in roots]
    for p, d in zip(parameters, dx, strict=True):
        if p.part == "gain":
            out[p.system] = replace(out[p.system], gain=out[p.system].gain * float(np.exp(d)))
        else:
            getattr(out[p.system], p.part)[p.place] += d * p.step
    for one, before in zip(out, roots, strict=True):
        free = np.abs(before.poles - 1.0) > 2e-4
        if np.any(np.abs(one.poles[free]) > 1.0 - LEAST):
            return None
        for part in ("zeros", "poles"):  # a pair stays a pair
            was, now = getattr(before, part), getattr(one, part)
            if np.any((was.imag > 0.0) & (now.imag <= 1e-6)):
                return None
    return out


@dataclass(frozen=True, eq=False)
class Place:
    """Controllers on the nodes: K, L, the worst 3 sigma's parts and the limits' slacks."""

    roots: list[Roots]
    K: ComplexArray
    L: ComplexArray
    sigma: Array


class Tuner:
    """Linear programmes on nodes under limits."""

    def __init__(self, forecast: Forecast, limits: Limits) -> None:
        self.forecast, self.limits = forecast, limits
        self.run_out = np.zeros(len(forecast.benchmark.cases))

    def place(self, roots: list[Roots]) -> Place:
        """Where the controllers stand."""
        K = self.K(roots)
        L = self.forecast.loops(K)
        return Place(roots, K, L, self.forecast.three_sigma(K, L, self.run_out))

    def K(self, roots: Sequence[Roots]) -> ComplexArray:
        """Controllers with filters (n, 2, 2)."""
        z, half = self.forecast.at
        every = [_response(one, z[:, None] if k < 2 else half) for k, one in enumerate(roots)]
        return np.stack([np.broadcast_to(every[k], half.shape) * every[k + 2] for k in (0, 1)], axis=-1)

    def renewed(self, roots: list[Roots]) -> Place:
        """As `place`, with the run-out's part computed anew."""
        self.run_out = run_out_variance(self.forecast.benchmark, lambda other: Tuner(other, self.limits).K(roots))
        return self.place(roots)

    def rows(self, at: Place) -> tuple[Array, ...]:
        """What rows look at here: cases and nodes of |S|, of 0 dB crossings, of passages of the negative real axis."""
        S, L = -db(np.abs(1.0 + at.L)), at.L
        size = db(np.abs(L))
        sharp = np.argwhere(self._ceiling(S.shape) - S < NEAR_DB)
        unit = np.argwhere(size[:, 1:] * size[:, :-1] < 0.0)
        axis = np.argwhere((L.imag[:, 1:] * L.imag[:, :-1] < 0.0) & (L.real[:, 1:] + L.real[:, :-1] < 0.0))
        return sharp, unit, axis

    def _ceiling(self, shape: tuple[int, ...]) -> Array:
        every = np.full(shape, self.limits.peak_db)
        if self.limits.low_db is not None:
            low = self.forecast.f <= LOW_HZ
            every[:, low] = np.minimum(every[:, low], self.limits.low_db[:, low])
        return every

    def slacks(self, at: Place, rows: tuple[Array, ...], above: Array) -> Array:
        """Slack of each row, in dB or, of angles, in units of 6 degrees."""
        L = at.L
        sharp, unit, axis = ((row[:, 0], row[:, 1]) for row in rows)
        S = self._ceiling(L.shape)[sharp] + db(np.abs(1.0 + L[sharp]))
        after = L[unit[0], unit[1] + 1] / L[unit]
        share = -np.log(np.abs(L[unit])) / np.log(np.abs(after))
        phase = np.abs(np.angle(-L[unit] * np.exp(1j * share * np.angle(after))))
        turned = L[axis[0], axis[1] + 1] / L[axis]
        share = -np.angle(-L[axis]) / np.angle(turned)
        size = db(np.abs(L[axis])) + share * db(np.abs(turned))
        return np.concatenate([S, (deg(phase) - self.limits.phase_deg) / 6.0, above * size - self.limits.gain_db])

    def above(self, at: Place, rows: tuple[Array, ...]) -> Array:
        """Whether |L| is above 1 (1) or below (-1) at passages of the real axis."""
        axis = rows[2]
        return np.where(np.abs(at.L[axis[:, 0], axis[:, 1]]) > 1.0, 1.0, -1.0)

    def worst_miss(self, at: Place) -> float:
        """Largest miss of a limit."""
        rows = self.rows(at)
        return float(max(0.0, -np.min(self.slacks(at, rows, self.above(at, rows)), initial=0.0)))

    def merit(self, at: Place) -> float:
        """What a search makes small."""
        return float(at.sigma.max()) + 10.0 * self.worst_miss(at)

    def step(self, at: Place, parameters: Sequence[Parameters], radius: float) -> tuple[Array, float]:
        """The linear programme's step and the merit that it promises."""
        rows = self.rows(at)
        above = self.above(at, rows)
        slacks = self.slacks(at, rows, above)
        near = slacks < np.where(np.arange(slacks.size) < len(rows[0]), NEAR_DB, NEAR_DEG / 6.0)
        sigma_slopes, slopes = np.empty((at.sigma.size, len(parameters))), np.empty((int(near.sum()), len(parameters)))
        h = 1e-6
        for k, p in enumerate(parameters):
            there = self._nudged(at, p, h)
            sigma_slopes[:, k] = (there.sigma - at.sigma) / h
            slopes[:, k] = (self.slacks(there, rows, above)[near] - slacks[near]) / h
        n = len(parameters)
        A = np.zeros((at.sigma.size + slopes.shape[0], n + 2))
        A[: at.sigma.size, :n], A[: at.sigma.size, n] = sigma_slopes, -1.0
        A[at.sigma.size :, :n], A[at.sigma.size :, n + 1] = -slopes, -1.0
        b = np.concatenate([-at.sigma, slacks[near]])
        cost = np.concatenate([np.zeros(n), [1.0, 10.0]])
        bounds = [(-radius, radius)] * n + [(None, None), (0.0, None)]
        found = linprog(cost, A_ub=A, b_ub=b, bounds=bounds, method="highs")
        if found.x is None:
            return np.zeros(n), 0.0
        return found.x[:n], self.merit(at) - float(found.fun)

    def _nudged(self, at: Place, p: Parameters, h: float) -> Place:
        """The place with one parameter moved by h: one factor of K changes."""
        z, half = self.forecast.at
        K, points = at.K.copy(), (z[:, None] if p.system < 2 else half)
        if p.part == "gain":
            ratio: ComplexArray | float = np.exp(h)
        else:
            root = getattr(at.roots[p.system], p.part)[p.place]
            ratio = _factor(points, root + h * p.step) / _factor(points, root)
            ratio = 1.0 / ratio if p.part == "poles" else ratio
        K[..., p.system % 2] *= ratio
        L = self.forecast.loops(K)
        return Place(at.roots, K, L, self.forecast.three_sigma(K, L, self.run_out))


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
        now = moved(at.roots, parameters, dx)
        there = None if now is None else tuner.place(now)
        gained = -1.0 if there is None else tuner.merit(at) - tuner.merit(there)
        if there is not None and gained > 0.1 * promised:
            at, radius = tuner.renewed(there.roots), min(radius * (1.6 if gained > 0.5 * promised else 1.0), 0.5)
        else:
            radius *= 0.5
        say(f"{k} {at.sigma.max():.3f} % miss {tuner.worst_miss(at):.4f} radius {radius:.4g}")
    return at.roots


def resonators(f_hz: Sequence[float], damping: float) -> ComplexArray:
    """Upper roots in z at Ts of pairs at these frequencies."""
    w = TWO_PI * np.asarray(f_hz) / 50400.0
    return np.exp(-damping * w + 1j * w * np.sqrt(1.0 - damping**2))
