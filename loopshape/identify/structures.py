"""Structures that a fit can take: how parameters make a transfer function, where they start, what they mean."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Protocol

import numpy as np

from loopshape.core.errors import WrongUseError
from loopshape.core.gate import pass_fields
from loopshape.core.units import TWO_PI, Array, ComplexArray, angular, hz
from loopshape.data.response.model import TransferFunction

MAX_DELAY_S = 0.2


class Structure(Protocol):
    """A family of transfer functions over a parameter vector x, scaled to be of order one."""

    @property
    def name(self) -> str:
        """The structure's word."""

    @property
    def names(self) -> tuple[str, ...]:
        """Reported parameters."""

    @property
    def units(self) -> tuple[str, ...]:
        """Units beside them."""

    def start(self, f: Array, response: ComplexArray, weight: Array) -> Array:
        """First guess from the data."""

    def bounds(self) -> tuple[Array, Array]:
        """Lower and upper bounds of x."""

    def model(self, x: Array) -> TransferFunction:
        """The transfer function of x."""

    def meaning(self, x: Array) -> Array:
        """The reported parameters of x, in `names` and `units`."""


@dataclass(frozen=True)
class _Named:
    """A structure of few parameters, kappa first, with a delay behind them if wanted."""

    delay: bool = False
    WORD: ClassVar[str]
    #: name, unit and bounds of each parameter
    OF: ClassVar[tuple[tuple[str, str, float, float], ...]]
    DELAY: ClassVar = ("delay_s", "s", 0.0, MAX_DELAY_S)

    @property
    def name(self) -> str:
        """The structure's word."""
        return self.WORD + "_delay" * self.delay

    @property
    def _each(self) -> tuple[tuple[str, str, float, float], ...]:
        return self.OF + (self.DELAY,) * self.delay

    @property
    def names(self) -> tuple[str, ...]:
        """Reported parameters."""
        return tuple(name for name, *_ in self._each)

    @property
    def units(self) -> tuple[str, ...]:
        """Units beside them."""
        return tuple(unit for _, unit, *_ in self._each)

    def bounds(self) -> tuple[Array, Array]:
        """Wide ones; the delay lies between 0 and 0.2 s."""
        return np.array([low for *_, low, _ in self._each]), np.array([high for *_, high in self._each])


@dataclass(frozen=True)
class ThirdOrder(_Named):
    """kappa/(s³ + 2 zeta w s² + w² s), with a delay if wanted (4.10); x = kappa, ln w, ln zeta, delay."""

    WORD = "third_order"
    OF = (("kappa", "1/s3", -np.inf, np.inf), ("f_hz", "Hz", -20.0, 20.0), ("zeta", "1", -12.0, 3.0))

    def start(self, f: Array, response: ComplexArray, weight: Array) -> Array:
        """The best of a grid over w and zeta, each with its own linear kappa."""
        s = 1j * angular(f)
        w, zeta = np.geomspace(0.5 * angular(f[0]), 2.0 * angular(f[-1]), 60), np.array([0.01, 0.03, 0.1, 0.3, 1.0])
        W, Z = w[:, None, None], zeta[:, None]
        shape = weight / (s * (s * s + 2.0 * Z * W * s + W * W))
        kappa = (shape.conj() * (response * weight)).sum(-1).real / (np.abs(shape) ** 2).sum(-1)
        error = (np.abs(response * weight - kappa[..., None] * shape) ** 2).sum(-1)
        i, j = np.unravel_index(int(np.argmin(error)), error.shape)
        return np.array([kappa[i, j], np.log(w[i]), np.log(zeta[j]), *[1e-3] * self.delay])

    def model(self, x: Array) -> TransferFunction:
        """Transfer function."""
        w, zeta = np.exp(x[1:3])
        return TransferFunction(x[:1], np.array([1.0, 2.0 * zeta * w, w * w, 0.0]), float(x[3]) if self.delay else 0.0)

    def meaning(self, x: Array) -> Array:
        """kappa, f, zeta, delay."""
        w, zeta = np.exp(x[1:3])
        return np.array([x[0], hz(w), zeta, *x[3:]])


@dataclass(frozen=True)
class Integrator(_Named):
    """kappa/s, with a delay if wanted; x = kappa, delay."""

    WORD = "integrator"
    OF = (("kappa", "1/s", -np.inf, np.inf),)

    def start(self, f: Array, response: ComplexArray, weight: Array) -> Array:
        """Median of Re(G s)."""
        return np.array([np.median((response * 1j * angular(f)).real), *[1e-3] * self.delay])

    def model(self, x: Array) -> TransferFunction:
        """Transfer function."""
        return TransferFunction(x[:1], np.array([1.0, 0.0]), float(x[1]) if self.delay else 0.0)

    def meaning(self, x: Array) -> Array:
        """kappa and delay."""
        return np.array(x)


@dataclass(frozen=True)
class Rational:
    """Ratio of polynomials of chosen orders, with poles at zero and a delay if wanted.

    x holds the numerator's and the monic denominator's coefficients in s/w0 with w0 in the middle of the
    band; reported are the coefficients in s. `fit.modes` gives zeros and poles with their spread. With `stable` the
    poles but those at zero lie in the left half plane: x then holds p² + a p + b (and p + c of an odd number) with
    positive numbers in the place of the denominator's coefficients.
    """

    numerator: int
    denominator: int
    integrators: int = 0
    delay: bool = False
    w0: float = TWO_PI
    stable: bool = False

    def __post_init__(self) -> None:
        pass_fields(self)
        if not 0 <= self.numerator <= self.denominator <= 20 or not 0 <= self.integrators <= self.denominator:
            raise WrongUseError(
                "a rational structure has 0 <= numerator <= denominator <= 20 and no more integrators than poles",
                f"numerator {self.numerator}, denominator {self.denominator}, integrators {self.integrators}",
            )

    @property
    def name(self) -> str:
        """The structure's word."""
        poles = f"rational {self.numerator}/{self.denominator}"
        poles += f" with {self.integrators} at zero" if self.integrators else ""
        return poles + (" and delay" if self.delay else "") + (", stable" if self.stable else "")

    @property
    def names(self) -> tuple[str, ...]:
        """Coefficients of s^k, numerator first."""
        num = tuple(f"b{k}" for k in range(self.numerator, -1, -1))
        den = tuple(f"a{k}" for k in range(self.denominator - 1, self.integrators - 1, -1))
        return num + den + (("delay_s",) if self.delay else ())

    @property
    def units(self) -> tuple[str, ...]:
        """Coefficients carry mixed units: those of s^k."""
        return tuple("s" if n == "delay_s" else "SI" for n in self.names)

    def start(self, f: Array, response: ComplexArray, weight: Array) -> Array:
        """By Sanathanan and Koerner's iteration."""
        m = levy(f, response, weight, self.numerator, self.denominator, self.integrators, iterations=30)
        num = m.num * self.w0 ** (np.arange(self.numerator, -1, -1) - self.denominator)
        powers = np.arange(self.denominator - 1, self.integrators - 1, -1) - self.denominator
        den = self.placed(m.den[1 : 1 + powers.size] * self.w0 ** powers.astype(float))
        return np.concatenate([num, den, [1e-4] if self.delay else []])

    def bounds(self) -> tuple[Array, Array]:
        """Free coefficients; the delay lies between 0 and 0.2 s."""
        n, k = len(self.names), self.numerator + 1
        low, high = np.full(n, -np.inf), np.full(n, np.inf)
        if self.stable:
            low[k : k + self.denominator - self.integrators] = 0.0
        if self.delay:
            low[-1], high[-1] = 0.0, MAX_DELAY_S
        return low, high

    def model(self, x: Array) -> TransferFunction:
        """Transfer function in s."""
        values = self.meaning(x)
        k = self.numerator + 1
        free = self.denominator - self.integrators
        den = np.concatenate([[1.0], values[k : k + free], np.zeros(self.integrators)])
        return TransferFunction(values[:k], den, float(x[-1]) if self.delay else 0.0)

    def meaning(self, x: Array) -> Array:
        """Coefficients in s."""
        powers = [self.denominator - k for k in range(self.numerator, -1, -1)]
        powers += [self.denominator - k for k in range(self.denominator - 1, self.integrators - 1, -1)]
        powers += [0] if self.delay else []
        return self._coefficients(x) * self.w0 ** np.array(powers, dtype=float)

    def placed(self, tail: Array) -> Array:
        """What stands in x for the coefficients of a monic denominator in s/w0; unstable poles are mirrored."""
        if not self.stable or not tail.size:
            return tail
        roots = np.roots(np.concatenate([[1.0], tail]))
        roots = -np.abs(roots.real) - 1e-3 * np.abs(roots) + 1j * roots.imag
        pairs = [np.array([-2.0 * r.real, abs(r) ** 2]) for r in roots if r.imag > 0.0]
        real = np.sort(roots[roots.imag == 0.0].real)
        pairs += [np.array([-a - b, a * b]) for a, b in zip(real[0::2], real[1::2], strict=False)]
        return np.concatenate([*pairs, -real[-1:]] if real.size % 2 else pairs)

    def _factors(self, x: Array) -> list[Array]:
        """Factors of the denominator in s/w0 without the poles at zero, as `stable` has them."""
        k, free = self.numerator + 1, self.denominator - self.integrators
        own = x[k : k + free]
        factors = [np.concatenate([[1.0], own[2 * i : 2 * i + 2]]) for i in range(free // 2)]
        return factors + ([np.array([1.0, own[-1]])] if free % 2 else [])

    def _product(self, x: Array) -> Array:
        whole: Array = np.ones(1)
        for factor in self._factors(x):
            whole = np.asarray(np.polymul(whole, factor))
        return whole

    def _coefficients(self, x: Array) -> Array:
        """Numerator's and monic denominator's coefficients in s/w0, and the delay."""
        if not self.stable:
            return np.array(x)
        k, free = self.numerator + 1, self.denominator - self.integrators
        return np.concatenate([x[:k], self._product(x)[1:], x[k + free :]])

    def response(self, x: Array, f: Array) -> ComplexArray:
        """Response (nf,) of x."""
        return self._parts(x, f)[0]

    def slopes(self, x: Array, f: Array) -> ComplexArray:
        """Derivatives (nf, parameters) of the response with respect to x."""
        G, den, turn, p = self._parts(x, f)
        top = turn[:, None] * p[:, None] ** np.arange(self.numerator, -1, -1) / den[:, None]
        by_delay = [(-1j * angular(f) * G)[:, None]] if self.delay else []
        if not self.stable:
            below = p[:, None] ** np.arange(self.denominator - 1, self.integrators - 1, -1)
            return np.hstack([top, -(G / den)[:, None] * below, *by_delay])
        by_factor = [
            (-G / np.polyval(factor, p))[:, None] * p[:, None] ** np.arange(factor.size - 2, -1, -1)
            for factor in self._factors(x)
        ]
        return np.hstack([top, *by_factor, *by_delay])

    def _parts(self, x: Array, f: Array) -> tuple[ComplexArray, ComplexArray, ComplexArray, ComplexArray]:
        """Response, denominator, the delay's turn, and s/w0, at each frequency."""
        p, values, k = 1j * angular(f) / self.w0, self._coefficients(x), self.numerator + 1
        free = self.denominator - self.integrators
        den = np.polyval(np.concatenate([[1.0], values[k : k + free]]), p) * p**self.integrators
        turn = np.exp(-1j * angular(f) * values[-1]) if self.delay else np.ones(f.size, dtype=complex)
        return np.asarray(np.polyval(values[:k], p) * turn / den), np.asarray(den), np.asarray(turn), np.asarray(p)


def levy(
    f: Array,
    response: ComplexArray,
    weight: Array,
    numerator: int,
    denominator: int,
    integrators: int = 0,
    iterations: int = 10,
) -> TransferFunction:
    """Rational first guess of a response (nf,) by linear equations, weighted by `weight` (nf,) >= 0.

    Source: Levy, 1959; reweighted after Sanathanan and Koerner, 1963.

    The denominator is monic with `integrators` roots at zero. Each iteration divides the equation by the
    last denominator, and the iterate with the least weighted error is kept: the iteration need not converge.
    """
    w0 = float(np.exp(np.mean(np.log(angular(f)))))
    s = 1j * angular(f) / w0
    b_terms = np.stack([s**k for k in range(numerator, -1, -1)], axis=1)
    a_terms = s[:, None] ** np.arange(denominator - 1, integrators - 1, -1)
    top = s**denominator
    shape = 1.0 / np.abs(top)
    best, best_error = None, np.inf
    for _ in range(iterations):
        scale = weight * shape
        left = np.hstack([b_terms, -response[:, None] * a_terms]) * scale[:, None]
        right = response * top * scale
        x = np.linalg.lstsq(np.vstack([left.real, left.imag]), np.concatenate([right.real, right.imag]), rcond=None)[0]
        b, a = x[: numerator + 1], x[numerator + 1 :]
        den = top + a_terms @ a
        error = float(np.sum((weight * np.abs(b_terms @ b / den - response)) ** 2))
        if error < best_error:
            best, best_error = (b, a), error
        shape = 1.0 / np.abs(den)
    assert best is not None
    b, a = best
    num = b * w0 ** (denominator - np.arange(numerator, -1, -1.0))
    tail = a * w0 ** (denominator - np.arange(denominator - 1, integrators - 1, -1.0))
    return TransferFunction(num, np.concatenate([[1.0], tail, np.zeros(integrators)]))
