"""Six-parameter least squares (4.4), table 4.1's form of it, its conditioning, and what rounding leaves open.

p in bar, h in m, k in N/m. With b and h in their rounding interval k is linear in (k0, c0 k0, k1, c1 k1, k2): what
digits can do is answered by linear programmes, one for each of many b.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import astuple, dataclass
from itertools import product

import numpy as np
from muscle_law import Digits, printed
from scipy.optimize import linprog

from loopshape.core.units import Array
from loopshape.toolbox.arm.source import number

NAMES = ("b", "k0", "k1", "k2", "c0", "c1")


@dataclass(frozen=True, eq=False)
class SixParameters:
    """alpha (6,) of k = a1 + a2 h + a3 h² + a4 p + a5 p h + a6 p h² in 1e5 N/m, with covariance and residual (n,)."""

    alpha: Array
    covariance: Array
    residual: Array

    @property
    def digits(self) -> Digits:
        """Table 4.1's form: k0, k1, k2 = a4, a5, a6; b = a3/a6; c0 = a1/(b a4); c1 = a2/(b a5)."""
        return normalised(self.alpha)

    @property
    def normal_covariance(self) -> Array:
        """Covariance (6, 6) of (b, k0, k1, k2, c0, c1), to first order."""
        jacobian = np.empty((6, 6))
        for i in range(6):
            step = np.zeros(6)
            step[i] = 1e-6 * abs(self.alpha[i])
            high, low = (np.array(astuple(normalised(self.alpha + s * step))) for s in (1.0, -1.0))
            jacobian[:, i] = (high - low) / (2.0 * step[i])
        return np.asarray(jacobian @ self.covariance @ jacobian.T)


def normalised(alpha: Array) -> Digits:
    """Table 4.1's six numbers of (4.4)'s."""
    a1, a2, a3, a4, a5, a6 = alpha.tolist()
    b = a3 / a6
    return Digits(b, a4, a5, a6, a1 / (b * a4), a2 / (b * a5))


def design(p_bar: Array, h_m: Array) -> Array:
    """Columns (n, 6) of (4.4)."""
    one = np.ones_like(h_m)
    return np.stack([one, h_m, h_m**2, p_bar, p_bar * h_m, p_bar * h_m**2], axis=1)


def centred(p_bar: Array, h_m: Array, about: Mapping[str, float]) -> tuple[Array, Array]:
    """Length and pressure from the grid's middle, in halves of its width."""
    x = (1e3 * h_m - about["x_centre_mm"]) / about["x_half_mm"]
    return x, (p_bar - about["y_centre_bar"]) / about["y_half_bar"]


def fit(p_bar: Array, h_m: Array, k_n_m: Array) -> SixParameters:
    """Plain least squares, as the source's; the scatter comes from the residual."""
    columns = design(p_bar, h_m)
    scale = np.linalg.norm(columns, axis=0)
    scaled, *_ = np.linalg.lstsq(columns / scale, 1e-5 * k_n_m, rcond=None)
    residual = 1e-5 * k_n_m - (columns / scale) @ scaled
    inverse = np.linalg.inv((columns / scale).T @ (columns / scale)) / np.outer(scale, scale)
    variance = float(residual @ residual) / (k_n_m.size - 6)
    return SixParameters(scaled / scale, variance * inverse, 1e5 * residual)


def conditions(p_bar: Array, h_m: Array, about: Mapping[str, float]) -> tuple[float, float, float]:
    """Condition numbers of the design as printed, with columns of length 1, and centred."""
    raw = design(p_bar, h_m)
    x, y = centred(p_bar, h_m, about)
    scaled = raw / np.linalg.norm(raw, axis=0)
    return tuple(float(np.linalg.cond(m)) for m in (raw, scaled, design(y, x)))  # type: ignore[return-value]


def correlation(covariance: Array) -> Array:
    """Correlations of a covariance."""
    std = np.sqrt(np.diag(covariance))
    return np.asarray(covariance / np.outer(std, std))


def printed_box(row: str = "experiment") -> Array:
    """Lowest and highest (2, 6) of table 4.1's numbers that would be printed as they are."""
    rows = [number(f"table_4_1.{row}.{name}") for name in NAMES]
    return np.array([[n.value - n.half_digit for n in rows], [n.value + n.half_digit for n in rows]])


def reach(box: Array, p_bar: Array, h_m: Array) -> tuple[Array, Array]:
    """Lowest and highest k (n,) over a box: k is linear in each number alone, so a corner has it."""
    corners = np.array([Digits(*c).stiffness(p_bar, h_m) for c in product(*box.T.tolist())])
    return corners.min(axis=0), corners.max(axis=0)


def rounding_std(p_bar: Array, h_m: Array, box: Array) -> Array:
    """Standard deviation of k (n,) in N/m if each number lies anywhere in its interval."""
    middle, half = box.mean(axis=0), 0.5 * (box[1] - box[0])
    total = np.zeros(np.shape(h_m))
    for i in range(6):
        step = np.zeros(6)
        step[i] = half[i]
        high, low = (Digits(*(middle + s * step)).stiffness(p_bar, h_m) for s in (1.0, -1.0))
        total += (0.5 * (high - low)) ** 2 / 3.0
    return np.asarray(np.sqrt(total))


def digits_box(values: Sequence[float], digits: int) -> Array:
    """Rounding intervals (2, n) of numbers printed to so many significant digits."""
    half = [0.5 * 10.0 ** (np.floor(np.log10(abs(v))) - digits + 1) for v in values]
    return np.array([np.array(values) - half, np.array(values) + half])


def error_table_form(digits: int, p_bar: Array, h_m: Array) -> float:
    """Largest error of k over k where table 4.1's numbers are printed to so many digits."""
    k = printed().stiffness(p_bar, h_m)
    low, high = reach(digits_box(astuple(printed()), digits), p_bar, h_m)
    return float(np.max(np.maximum(high - k, k - low) / k))


def error_centred(digits: int, p_bar: Array, h_m: Array, about: Mapping[str, float]) -> float:
    """The same for the six numbers of the centred polynomial."""
    x, y = centred(p_bar, h_m, about)
    k = printed().stiffness(p_bar, h_m)
    columns = design(y, x)
    numbers, *_ = np.linalg.lstsq(columns, k, rcond=None)
    box = digits_box(numbers.tolist(), digits)
    return float(np.max(np.abs(columns) @ (0.5 * (box[1] - box[0])) / k))


def _programme(box: Array, b: float) -> tuple[Array, list[tuple[float, float]]]:
    """Rows of A x <= 0 that hold c0 and c1 in their intervals, and bounds, for x = (k0, c0 k0, k1, c1 k1, k2)."""
    rows = []
    for place, name in ((0, "c0"), (2, "c1")):
        low, high = box[:, NAMES.index(name)]
        if box[0, 1 + place // 2] < 0.0:
            low, high = high, low
        for edge, sign in ((low, -1.0), (high, 1.0)):
            row = np.zeros(5)
            row[place], row[place + 1] = -sign * edge, sign
            rows.append(row)
    free = (None, None)
    bounds = [tuple(box[:, 1]), free, tuple(box[:, 2]), free, tuple(box[:, 3])]
    return np.array(rows), bounds  # type: ignore[return-value]


def _row(b: float, p_bar: Array, h_m: Array) -> Array:
    """k in N/m as rows (n, 5) over x."""
    one = np.ones_like(h_m)
    return 1e5 * np.stack([p_bar * one, b * one, p_bar * h_m, b * h_m, (b + p_bar) * h_m**2], axis=1)


def smallest_misfit(p_bar: Array, h_m: Array, k_n_m: Array, box: Array, steps: int) -> tuple[float, Digits]:
    """Smallest possible largest relative misfit to stiffnesses (n,), and digits of the box that reach it."""
    best = (np.inf, printed())
    for b in np.linspace(*box[:, 0], steps).tolist():
        held, bounds = _programme(box, b)
        rows = _row(b, p_bar, h_m) / k_n_m[:, None]
        over, under = (np.column_stack([s * rows, -np.ones(rows.shape[0])]) for s in (1.0, -1.0))
        a = np.vstack([np.column_stack([held, np.zeros(4)]), over, under])
        right = np.concatenate([np.zeros(4), np.ones(rows.shape[0]), -np.ones(rows.shape[0])])
        found = linprog(np.array([0, 0, 0, 0, 0, 1.0]), a, right, bounds=[*bounds, (0.0, None)])
        if found.success and found.fun < best[0]:
            k0, m0, k1, m1, k2 = found.x[:5].tolist()
            best = (float(found.fun), Digits(b, k0, k1, k2, m0 / k0, m1 / k1))
    return best


def reach_given(
    p_bar: float, h_m: float, known: tuple[Array, Array, Array], share: float, box: Array, steps: int
) -> tuple[float, float]:
    """Lowest and highest k in N/m at a point over the digits that meet known stiffnesses (p, h, k) within a share."""
    p, h, k = known
    ends = []
    for b in np.linspace(*box[:, 0], steps).tolist():
        held, bounds = _programme(box, b)
        rows = _row(b, p, h) / k[:, None]
        a = np.vstack([held, rows, -rows])
        right = np.concatenate([np.zeros(4), np.full(k.size, 1.0 + share), np.full(k.size, share - 1.0)])
        aim = _row(b, np.array([p_bar]), np.array([h_m]))[0]
        low, high = (linprog(s * aim, a, right, bounds=bounds) for s in (1.0, -1.0))
        if low.success and high.success:
            ends += [float(low.fun), -float(high.fun)]
    return (min(ends), max(ends)) if ends else (float("nan"), float("nan"))


def reaching(known: tuple[Array, Array, Array], share: float, box: Array, steps: int, seed: int) -> list[Digits]:
    """Digits at the corners of all those that meet known stiffnesses (p, h, k) within a share: two for each b."""
    p, h, k = known
    rng, out = np.random.default_rng(seed), []
    for b in np.linspace(*box[:, 0], steps).tolist():
        held, bounds = _programme(box, b)
        rows = _row(b, p, h) / k[:, None]
        a = np.vstack([held, rows, -rows])
        right = np.concatenate([np.zeros(4), np.full(k.size, 1.0 + share), np.full(k.size, share - 1.0)])
        aim = rng.standard_normal(5) / np.array([0.1, 0.1, 1.0, 1.0, 4.0])
        for s in (1.0, -1.0):
            found = linprog(s * aim, a, right, bounds=bounds)
            if found.success:
                k0, m0, k1, m1, k2 = found.x.tolist()
                out.append(Digits(b, k0, k1, k2, m0 / k0, m1 / k1))
    return out
