"""A controller of fixed order by convex-concave programmes on the FRF, written with cvxpy: a peer.

C = X/Y, X and Y sums of 1 and 1/(s/p + 1) with fixed poles p. About the controller of the round before, |Y + P X| and
|P X| are at least what their tangents say, so that the limits are second-order cones (Galdos, Karimi and Longchamp,
IFAC World Congress 2011; Karimi and Kammer, Automatica 85, 2017). Y + P X and Y stay in a half-plane about the last
ones: neither changes how often it turns about 0, and the loop and C stay stable.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import cvxpy
import numpy as np

from loopshape.core.units import TWO_PI, Array, ComplexArray, from_db, rad
from loopshape.data.control.block import series_response
from loopshape.data.control.controller import Controller
from loopshape.data.control.fixed import fixed
from loopshape.data.control.shorthand import controller as made
from loopshape.data.requirement.requirements import Requirements
from loopshape.design.problem.problem import Problem

Unknown, Limit = cvxpy.Variable, cvxpy.Constraint
#: the bandwidth rises by these factors, the last ones where the first can no more; rounds of each try
STEPS, ROUNDS = (1.15, 1.05, 1.015), 12
#: |S| keeps the phase margin where a line lies this near the bandwidth, or |L| this near 1, as ratios
NEAR, CLOSE = 1.12, 1.25
#: no limit, in dB
NOTHING_DB = 120.0
#: nodes between the lines
BETWEEN = 300
#: Y is kept from turning there, a decade below the lines, up to half the rate, at 0 and at the end of all, in rad/s
BEYOND, ENDLESS = 10.0, 1e9


@dataclass(frozen=True, eq=False)
class Last:
    """X and Y (nodes,) of the round before, at the nodes of the programme."""

    X: ComplexArray
    Y: ComplexArray


@dataclass(frozen=True, eq=False)
class Programme:
    """Nodes f (n,) in Hz with s (n,); P (lines,) of all plants with the node of each line, `first` where plants begin.

    `poles` (order,) are in rad/s; `back` is what is kept back in dB.
    """

    f: Array
    P: ComplexArray
    line: np.ndarray
    first: np.ndarray
    s: ComplexArray
    poles: Array
    asked: Requirements
    back: float

    @cached_property
    def basis(self) -> ComplexArray:
        """1 and 1/(s/p + 1) at the nodes."""
        return np.concatenate([np.ones((self.s.size, 1)), 1.0 / (self.s[:, None] / self.poles + 1.0)], axis=1)

    def L(self, last: Last) -> ComplexArray:
        """L (lines,) of the round before."""
        return np.asarray(self.P * last.X[self.line] / last.Y[self.line])

    def round(self, last: Last, bandwidth_hz: float) -> tuple[Array, Array, float] | None:
        """Coefficients of X and Y, and by how much |L| misses 1 below the bandwidth; None where nothing was found."""
        x, y = cvxpy.Variable(self.poles.size + 1), cvxpy.Variable(self.poles.size + 1)
        missed = cvxpy.Variable()
        turned = np.conj(last.Y) / np.abs(last.Y) ** 2
        rows = [np.real(turned[:, None] * self.basis) @ y >= 1e-3, missed >= -0.01]
        rows += [*self._on_lines(last, x, y, bandwidth_hz), *self._above(last, x, y)]
        rows += [self._large(last, x, y, missed, bandwidth_hz), self._large_at_first(last, x, y)]
        problem = cvxpy.Problem(cvxpy.Minimize(missed), rows)
        try:
            with warnings.catch_warnings(action="ignore"):  # of an inaccurate solution, which its status tells
                problem.solve(solver="CLARABEL")
        except cvxpy.error.SolverError:
            return None
        if problem.status != "optimal" or np.real(turned * (self.basis @ y.value)).min() <= 0.0:
            return None
        return np.asarray(x.value), np.asarray(y.value), float(missed.value)

    def _on_lines(self, last: Last, x: Unknown, y: Unknown, bandwidth_hz: float) -> list[Limit]:
        """|S|, |T| and |CS| on the lines; |S| keeps the phase margin about the crossings."""
        n, asked, k = self.P.size, self.asked, self.line
        f, basis, before = self.f[k], self.basis[k], last.Y[k] + self.P * last.X[k]
        scale = np.abs(before)
        own, turn = basis / scale[:, None], (np.conj(before) / scale**2)[:, None]
        ahead = np.real(turn * basis) @ y + np.real(turn * self.P[:, None] * basis) @ x
        S, CS = np.full(n, self._most("sensitivity_peak_db")), np.full(n, self._most("control_peak_db"))
        near = np.abs(np.log(np.abs(self.L(last)))) < np.log(CLOSE)
        near |= (f < NEAR * bandwidth_hz) & (f > bandwidth_hz / NEAR)
        S[near] = np.minimum(S[near], 0.5 / np.sin(0.5 * rad((asked.phase_margin_deg or 0.0) + 4.0 * self.back)))
        high = f >= (asked.control_high_frequency_from_hz or np.inf)
        CS[high] = np.minimum(CS[high], self._most("control_high_frequency_db"))
        return [
            _size(own, y) <= cvxpy.multiply(S, ahead),
            _size(own, x) <= cvxpy.multiply(CS, ahead),
            _size(own * self.P[:, None], x) <= self._most("complementary_peak_db") * ahead,
        ]

    def _above(self, last: Last, x: Unknown, y: Unknown) -> list[Limit]:
        """|CS| above the lines, where |L| may stay as it is at the last of them."""
        if self.asked.control_high_frequency_db is None:
            return []
        end = np.abs(self.L(last)[self.first[1:] - 1]).max()
        most = self._most("control_high_frequency_db") * max(1.0 - end, 0.1)
        beyond = self.f > self.f[self.line].max()
        basis, before = self.basis[beyond], last.Y[beyond]
        ahead = np.real((np.conj(before) / np.abs(before) ** 2)[:, None] * basis) @ y
        return [_size(basis / np.abs(before)[:, None], x) <= most * ahead]

    def _large(self, last: Last, x: Unknown, y: Unknown, missed: Unknown, bandwidth_hz: float) -> Limit:
        """|L| at least 1 up to the bandwidth, but for what is missed."""
        below = self.f[self.line] < bandwidth_hz
        k, P = self.line[below], self.P[below]
        L, basis, over = P * last.X[k], self.basis[k], 1.0 / np.abs(last.Y[k])
        ahead = np.real((np.conj(L) * P / np.abs(L))[:, None] * basis) @ x
        return _size(basis * over[:, None], y) <= cvxpy.multiply(over, ahead) + missed

    def _large_at_first(self, last: Last, x: Unknown, y: Unknown) -> Limit:
        """|L| at least 1 below the lines, were |P| no more than at the first one."""
        first = np.abs(self.P[self.first[:-1]]).min()
        low = self.f < self.f[self.line].min()
        ahead = np.real((np.conj(last.X[low]) / np.abs(last.X[low]))[:, None] * self.basis[low]) @ x
        return _size(self.basis[low], y) <= first * ahead

    def _most(self, name: str) -> float:
        """A limit less what is kept back, as a magnitude; one that nothing misses without one."""
        limit = getattr(self.asked, name)
        return float(from_db(NOTHING_DB if limit is None else limit - self.back))


def _size(rows: ComplexArray, variable: cvxpy.Variable) -> cvxpy.Expression:
    """|rows @ variable| of each row."""
    return cvxpy.norm(cvxpy.vstack([np.real(rows) @ variable, np.imag(rows) @ variable]), axis=0)


def convex_concave(p: Problem, asked: Requirements, start: Controller, order: int, back_db: float) -> Controller:
    """The controller of `order` poles and the largest bandwidth that rounds from `start` come to, for all plants.

    `back_db` is kept back of each limit, for the error of the FRF that the programme does not know.
    """
    f = np.concatenate([p.unique_f, _beyond(p.unique_f, start.rate_hz)])
    s = np.concatenate([start.s_at(f), [0.0, ENDLESS * 1j]])
    poles = np.geomspace(TWO_PI * p.f.min(), TWO_PI * 3.0 * p.f.max(), order)
    f, P = np.concatenate([f, [0.0, np.inf]]), p.P * start.outside(p.f)
    own = Programme(f, P, p.line, p.first, s, poles, asked, back_db)
    last = _begun(own, start)
    best, reached = start, 0.97 * _crossing(own, last)
    for step in STEPS:
        while (found := _raised(own, last, step * reached)) is not None:
            (last, coefficients), reached = found, step * reached
            best = _controller(own, coefficients, start)
    return best


def _raised(own: Programme, last: Last, bandwidth_hz: float) -> tuple[Last, tuple[Array, Array]] | None:
    """Rounds until |L| is 1 or more up to a bandwidth; None where they come to rest before."""
    missed = np.inf
    for x, y, now in _rounds(own, last, bandwidth_hz):
        if (_roots(own, y)[0].real >= 0.0).any():  # Y turned between the nodes
            return None
        if now <= 0.0:
            return Last(own.basis @ x, own.basis @ y), (x, y)
        if now > 0.97 * missed:
            return None
        missed = now
    return None


def _rounds(own: Programme, last: Last, bandwidth_hz: float) -> Iterator[tuple[Array, Array, float]]:
    for _ in range(ROUNDS):
        found = own.round(last, bandwidth_hz)
        if found is None:
            return
        yield found
        last = Last(own.basis @ found[0], own.basis @ found[1])


def _begun(own: Programme, start: Controller) -> Last:
    """The start's numerator and denominator, with what cancels, over the programme's poles."""
    both = [block.section() for block in start.blocks]
    num, den = (np.prod([np.polyval(one[k][::-1], own.s) for one in both], axis=0) for k in (0, 1))
    assert np.allclose(num / den, series_response(start.blocks, own.s))
    rest = np.prod(own.s[:, None] / own.poles[start.order() :] + 1.0, axis=1)
    over = np.prod(own.s[:, None] / own.poles + 1.0, axis=1)
    return Last(num * rest / over, den * rest / over)


def _crossing(own: Programme, last: Last) -> float:
    """The lowest frequency where |L| of a plant is below 1."""
    below = own.f[own.line][np.abs(own.L(last)) < 1.0]
    return float(below.min() if below.size else own.f[own.line].max())


def _beyond(f: Array, rate_hz: float) -> Array:
    """Frequencies below and above the lines, and between them."""
    above = np.geomspace(1.05 * f[-1], 0.4995 * rate_hz, 60)
    return np.concatenate([np.geomspace(f[0] / BEYOND, 0.95 * f[0], 20), np.geomspace(f[0], f[-1], BETWEEN), above])


def _controller(own: Programme, coefficients: tuple[Array, Array], start: Controller) -> Controller:
    """X/Y as sections."""
    (zeros, top), (poles, bottom) = (_roots(own, one) for one in coefficients)
    return made(*fixed((zeros, poles, top / bottom)), rate_hz=start.rate_hz, loop=start.loop)


def _roots(own: Programme, coefficients: Array) -> tuple[ComplexArray, float]:
    """Zeros in rad/s of X or Y, and the leading coefficient in s over their geometric mean."""
    w = float(np.exp(np.log(own.poles).mean()))
    factors = [np.array([w / pole, 1.0]) for pole in own.poles]
    whole = coefficients[0] * _product(factors)
    for k, one in enumerate(coefficients[1:]):
        whole = np.polyadd(whole, one * _product(factors[:k] + factors[k + 1 :]))
    return np.roots(whole) * w, float(whole[0])


def _product(factors: list[Array]) -> Array:
    out = np.ones(1)
    for one in factors:
        out = np.polymul(out, one)
    return out
