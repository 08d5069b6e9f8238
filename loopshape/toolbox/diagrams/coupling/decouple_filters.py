"""Filters between the controllers and the plant that decouple it over a band: stable rationals, as they run.

With W in front of it the plant is P W. W is 1 on its diagonal, and off it the filters that come nearest to
-P_oo^-1 P_oj, which leaves column j of P W nothing outside its own row (Skogestad and Postlethwaite, Multivariable
Feedback Control, 2005, 10.6, on dynamic decoupling). They are fitted in Tustin's warped frequency, with poles that are
stable by construction, so that what is fitted is what runs.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import least_squares

from loopshape.core.errors import WrongUseError
from loopshape.core.json_ready import Plain, keys
from loopshape.core.units import TWO_PI, Array, ComplexArray
from loopshape.data.control.controller import Controller
from loopshape.data.control.fixed import fixed
from loopshape.data.control.shorthand import controller, gain
from loopshape.data.response.frf import FRF
from loopshape.identify.fit import Data, solve
from loopshape.identify.matrix.equivalent_plant import square_part
from loopshape.identify.structures import levy

#: highest order of a filter
MOST_ORDER = 8
#: poles lie within the band times this, either way
FARTHER = 20.0


@dataclass(frozen=True, eq=False)
class DynamicDecoupling(Plain):
    """Filters from the controllers' outputs to what enters the plant: `filters[a][b]` is what `a` gets of `b`.

    `frequency_hz` (nf,) are the frequencies (lines) that they were found from, `std` (nf, loops, loops) the standard
    deviation sqrt E|d|² of each filter's response there, by the FRF's covariance, widened where a filter of this order
    leaves more than noise. `left` (loops, loops) is the rms of what each leaves of the coupling that it cancels,
    as a share of it, noise included.
    """

    ALSO = keys("band_hz")

    loops: tuple[str, ...]
    filters: Mapping[str, Mapping[str, Controller]]
    frequency_hz: Array
    std: Array
    left: Array

    def __repr__(self) -> str:
        """One line: the order of each filter, and what it leaves."""
        pairs = [
            f"{a} gets of {b} by {len(self.filters[a][b].blocks)} sections ({100 * self.left[i, j]:.2g} % left)"
            for i, a in enumerate(self.loops)
            for j, b in enumerate(self.loops)
            if i != j
        ]
        low, high = self.band_hz
        return f"DynamicDecoupling at {low:.3g} to {high:.3g} Hz: {', '.join(pairs)}"

    @property
    def band_hz(self) -> tuple[float, float]:
        """The lowest and the highest frequency (line) that the filters were found from."""
        return float(self.frequency_hz[0]), float(self.frequency_hz[-1])

    def response(self, frequency_hz: Array) -> ComplexArray:
        """The matrix W (nf, loops, loops) as it runs; refuses frequencies at or above half the rate."""
        made = np.tile(np.eye(len(self.loops), dtype=complex), (np.size(frequency_hz), 1, 1))
        for i, a in enumerate(self.loops):
            for j, b in enumerate(self.loops):
                if i != j:
                    made[:, i, j] = self.filters[a][b].response(frequency_hz)
        return made

    def applied(self, P: FRF) -> FRF:
        """The plant behind the filters, P W, below half their rate, with its covariance; W is taken as exact.

        Misleads on the FRF that W was found from: there its error and the plant's are the same.
        """
        plant, _ = square_part(P, self.loops)
        rate_hz = self.filters[self.loops[0]][self.loops[1]].rate_hz
        plant = plant.select(plant.frequency_hz < 0.5 * rate_hz)
        return behind(plant, self.response(plant.frequency_hz), f"filters between controllers and plant: {self}")


def behind(plant: FRF, W: ComplexArray, what: str) -> FRF:
    """A square plant behind W (nf, n, n), which is exact, with its covariance and a note."""
    carry = np.stack([np.kron(one.T, np.eye(len(one))) for one in W])
    back, noise = carry.conj().transpose(0, 2, 1), plant.noise_covariance
    return replace(
        plant,
        response=plant.response @ W,
        covariance=carry @ plant.covariance @ back,
        noise_covariance=None if noise is None else carry @ noise @ back,
        recorded_under=None,
        notes=(*plant.notes, f"behind {what}"),
    )


def decoupling_filters(plant: FRF, loops: tuple[str, ...], used: np.ndarray, order: int) -> DynamicDecoupling:
    """Filters of an order that decouple a square plant best on its lines `used` (nf,), with their deviation."""
    _check(plant, used, order)
    lines, n = plant.select(used), len(loops)
    filters: dict[str, dict[str, Controller]] = {a: {} for a in loops}
    std, left = np.zeros((lines.frequency_hz.size, n, n)), np.zeros((n, n))
    for j, b in enumerate(loops):
        others = [k for k in range(n) if k != j]
        wanted, variance = _wanted(lines, j, others)
        for k, i in enumerate(others):
            found, std[:, i, j] = _fitted(lines, wanted[:, k], variance[:, k], order)
            filters[loops[i]][b] = replace(found, loop=f"{loops[i]} of {b}")
            off = found.response(lines.frequency_hz) - wanted[:, k]
            left[i, j] = np.linalg.norm(off) / max(float(np.linalg.norm(wanted[:, k])), 1e-300)
    return DynamicDecoupling(loops, filters, lines.frequency_hz, std, left)


def _check(plant: FRF, used: np.ndarray, order: int) -> None:
    """Refuse orders that are none, FRFs without a rate, and bands with too few lines or up to half the rate."""
    if not 1 <= order <= MOST_ORDER:
        raise WrongUseError(f"a decoupling filter has order 1 to {MOST_ORDER}", f"{order}", "0 is a constant matrix")
    if not plant.rate_hz > 0.0:
        raise WrongUseError("a filter runs at the rate of its plant", f"{plant.rate_hz:g} Hz", "give the FRF rate_hz")
    if np.count_nonzero(used) < 2 * order + 2:
        raise WrongUseError(
            "a band has too few valid frequencies for filters of this order",
            f"{np.count_nonzero(used)} for order {order}", f"{2 * order + 2} at least: a wider band or a lower order",
        )  # fmt: skip
    if plant.frequency_hz[used][-1] >= 0.45 * plant.rate_hz:
        raise WrongUseError(
            "filters are fitted below 0.45 of the rate",
            f"{plant.frequency_hz[used][-1]:g} Hz at {plant.rate_hz:g} Hz", "choose a lower band",
        )  # fmt: skip


def _wanted(lines: FRF, j: int, others: list[int]) -> tuple[ComplexArray, Array]:
    """-P_oo^-1 P_oj (nf, n-1), and its variance E|d|² by the covariance of vec(P), columns stacked.

    Its first-order error is -P_oo^-1 dP_o w with w the whole column, 1 in row j.
    """
    H = lines.response
    inverse = np.linalg.inv(H[:, others][:, :, others])
    wanted = -np.einsum("fik,fk->fi", inverse, H[:, others, j])
    column = np.zeros(H.shape[:2], dtype=complex)
    column[:, j], column[:, others] = 1.0, wanted
    rows = np.eye(H.shape[1])[others]
    slopes = -inverse @ np.stack([np.kron(one, rows) for one in column])
    return wanted, np.real(np.einsum("fim,fmn,fin->fi", slopes, lines.covariance, slopes.conj()))


def _fitted(lines: FRF, wanted: ComplexArray, variance: Array, order: int) -> tuple[Controller, Array]:
    """The stable filter of an order nearest to a response (nf,), as it runs, and the deviation (nf,) of its own."""
    size = float(np.sqrt(np.mean(np.abs(wanted) ** 2)))
    if size == 0.0:
        return controller(gain(0.0), rate_hz=lines.rate_hz), np.sqrt(variance)
    known = np.maximum(variance, (1e-6 * size) ** 2)
    s = controller(gain(1.0), rate_hz=lines.rate_hz).s_at(lines.frequency_hz)
    structure = _Stable(order, s)
    data = Data(wanted, known, lines.line_overlap, lines.variance_freedom, lines.variance_pooled)
    alike = 0.01  # frequencies (lines) known better than this share of the coupling's rms count alike
    weight = known + (alike * size) ** 2
    found = solve(structure.response, structure.starts(wanted, weight), structure.bounds(), data, weight)
    slopes = structure.slopes(found.x)
    spread = np.sqrt(np.maximum(np.real(np.einsum("fi,ij,fj->f", slopes, found.covariance, slopes.conj())), 0.0))
    return controller(*fixed(structure.roots(found.x)), rate_hz=lines.rate_hz), spread


class _Stable:
    """Proper rationals of an order at warped s (nf,), with stable poles whatever their parameters.

    x holds the numerator (order + 1,) in falling powers of s/w0, ln w and ln damping of each pole pair, and ln w of a
    single pole.
    """

    def __init__(self, order: int, s: ComplexArray) -> None:
        self.order, self.low, self.high = order, float(abs(s[0])), float(abs(s[-1]))
        self.w0 = float(np.sqrt(self.low * self.high))
        self.s = s / self.w0

    def denominator(self, x: Array) -> Array:
        """Its coefficients, falling, monic."""
        made = np.ones(1)
        for w, damping in np.exp(x[self.order + 1 :][: self.order // 2 * 2]).reshape(-1, 2):
            made = np.polymul(made, [1.0, 2.0 * damping * w, w * w])
        return np.polymul(made, [1.0, np.exp(x[-1])]) if self.order % 2 else made

    def response(self, x: Array) -> ComplexArray:
        """Response (nf,)."""
        return np.asarray(np.polyval(x[: self.order + 1], self.s) / np.polyval(self.denominator(x), self.s))

    def slopes(self, x: Array) -> ComplexArray:
        """How the response moves with each parameter (nf, parameters), by central differences."""
        steps = 1e-6 * np.maximum(np.abs(x), 1e-3)
        moved = [
            (self.response(x + h * e) - self.response(x - h * e)) / (2.0 * h)
            for h, e in zip(steps, np.eye(x.size), strict=True)
        ]
        return np.stack(moved, axis=1)

    def bounds(self) -> tuple[Array, Array]:
        """Numerators are free; poles lie within the band and `FARTHER` of it."""
        free, w = np.full(self.order + 1, np.inf), np.log([self.low / self.w0 / FARTHER, self.high / self.w0 * FARTHER])
        dampings = (0.05, 20.0)  # dampings of a filter's pole pairs; a real pair has one above 1
        pairs = [(w[k], np.log(dampings[k])) for k in (0, 1)]
        low, high = (
            np.concatenate([sign * free, np.tile(pairs[k], self.order // 2), [w[k]] * (self.order % 2)])
            for k, sign in ((0, -1.0), (1, 1.0))
        )
        return low, high

    def starts(self, wanted: ComplexArray, weight: Array) -> list[Array]:
        """From the linear equations, with their poles turned stable, and from poles spread over the band."""
        low, high = self.bounds()
        f = np.abs(self.s) * self.w0 / TWO_PI
        guess = levy(f, wanted, 1.0 / np.sqrt(weight), self.order, self.order, iterations=20).poles() / self.w0
        spread = -np.geomspace(self.low, self.high, self.order + 2)[1:-1] / self.w0
        ends = low[self.order + 1 :] + 1e-6, high[self.order + 1 :] - 1e-6
        initial = [np.clip(self._poles(one), *ends) for one in (guess, spread.astype(complex))]
        found = [least_squares(self._left, one, bounds=ends, args=(wanted, weight)) for one in initial]
        best = min(found, key=lambda one: one.cost).x
        return [np.concatenate([self._numerator(best, wanted, weight)[0], best])]

    def _left(self, poles: Array, wanted: ComplexArray, weight: Array) -> Array:
        """What the best numerator over given poles leaves (2 nf,) (Golub and Pereyra, 1973)."""
        return self._numerator(poles, wanted, weight)[1]

    def _poles(self, poles: ComplexArray) -> Array:
        """Parameters of poles, the unstable ones mirrored: pairs first, real ones in twos."""
        upper = poles[poles.imag > 1e-9 * np.abs(poles)]
        real = np.sort(np.abs(poles[np.abs(poles.imag) <= 1e-9 * np.abs(poles)]))
        pairs = [(abs(p), abs(p.real) / abs(p)) for p in upper]
        pairs += [
            (np.sqrt(a * b), (a + b) / (2.0 * np.sqrt(a * b))) for a, b in zip(real[0::2], real[1::2], strict=False)
        ]
        single = [real[-1]] if self.order % 2 else []
        return np.log(np.maximum(np.concatenate([np.ravel(pairs), single]), 1e-12))

    def _numerator(self, poles: Array, wanted: ComplexArray, weight: Array) -> tuple[Array, Array]:
        """The best numerator over given poles by linear least squares, and what it leaves (2 nf,)."""
        den = np.polyval(self.denominator(np.concatenate([np.zeros(self.order + 1), poles])), self.s)
        columns = self.s[:, None] ** np.arange(self.order, -1, -1) / (den * np.sqrt(weight))[:, None]
        right = wanted / np.sqrt(weight)
        A, b = np.vstack([columns.real, columns.imag]), np.concatenate([right.real, right.imag])
        size = np.linalg.norm(A, axis=0)
        x = np.linalg.lstsq(A / size, b, rcond=None)[0] / size
        return x, np.asarray(A @ x - b)

    def roots(self, x: Array) -> tuple[ComplexArray, ComplexArray, float]:
        """Zeros and poles in rad/s, and the gain."""
        num = np.trim_zeros(x[: self.order + 1], "f")
        zeros, poles = (np.asarray(self.w0 * np.roots(p), dtype=complex) for p in (num, self.denominator(x)))
        return zeros, poles, float(num[0] * self.w0 ** (poles.size - zeros.size))
