"""How a measured plant goes on below its first line: small models with real coefficients, fitted to the lowest lines.

P is taken as B(s)/(A(s) s^k) with k declared, A(0) = 1 and low orders, which over a few octaves a delay and whatever
lies above them look like. Several of them fit; what they disagree about is not known.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from loopshape.core.units import Array, ComplexArray
from loopshape.data.response.frf import FRF
from loopshape.identify.spectra.averages import pooled_variance

#: models follow the lines up to so many times the first, but this many at least and at most
REACH, FEWEST, MOST = 4.0, 8, 60
#: orders of B and A, in the order of their number of parameters; models with this many more than the least are kept
ORDERS = ((0, 0), (1, 0), (0, 1), (1, 1), (2, 0), (0, 2), (2, 1), (1, 2), (2, 2), (3, 2))
MORE = 2
#: lines err by this share of |P| at least: what so small a model rounds off
FLOOR = 3e-4
#: lines that are known worse than this say nothing of what lies below them, and so do models known worse at s = 0
KNOWN = 0.3
#: B(0) is at most so many times what the first line shows, and no less than its inverse: else k is another number
AWAY = 5.0
#: rounds of Sanathanan and Koerner's weighting
ROUNDS = 6
#: A may come this near 0 below the first line, as a share of its smaller end: no unseen resonance
SHARP = 0.3


@dataclass(frozen=True, eq=False)
class LowModel:
    """B(s)/(A(s) s^k) in s = j f/f1; `influence` (parameters, 2 n) turns errors of n lines into those of B and A.

    Errors are real parts, then imaginary ones, of the first n lines as `lines` says.
    """

    first_hz: float
    integrators: int
    num: Array
    den: Array
    influence: Array
    lines: int

    def response(self, f: Array) -> ComplexArray:
        """P (n,) at frequencies f (n,) in Hz above zero."""
        s = 1j * np.asarray(f, dtype=float) / self.first_hz
        return np.asarray(_rational(s, self.num, self.den) * s**-self.integrators)

    def deviations(self, f: Array, errors: ComplexArray) -> ComplexArray:
        """What errors (draws, nf) of the lines do to P at f (n,): (draws, n)."""
        own = errors[:, : self.lines]
        return np.asarray((np.concatenate([own.real, own.imag], axis=1) @ self.influence.T) @ self.slopes(f).T)

    def slopes(self, f: Array) -> ComplexArray:
        """d P at f (n,) in Hz by each coefficient, (n, parameters)."""
        s = 1j * np.asarray(f, dtype=float) / self.first_hz
        return np.asarray(_slopes(s, self.num, self.den) * (s**-self.integrators)[:, None])


def low_frequency_models(frf: FRF, integrators: int) -> tuple[LowModel, ...]:
    """Models that follow the lowest lines of a 1 x 1 FRF, the likeliest first; none where none tells P at s = 0.

    `integrators` is the declared number of poles at s = 0, negative for zeros there. Give frequencies as measured. A
    plant with a resonance below its first line misleads, unless the lines show it.
    """
    f = frf.frequency_hz
    count = int(np.clip(np.searchsorted(f, REACH * f[0], side="right"), min(FEWEST, f.size), MOST))
    P, variance = frf.siso[:count], pooled_variance(frf)[:count]
    return _remembered(f[:count].tobytes(), P.tobytes(), variance.tobytes(), integrators)


@lru_cache(maxsize=512)
def _remembered(f: bytes, P: bytes, variance: bytes, integrators: int) -> tuple[LowModel, ...]:
    own, y = np.frombuffer(f), np.frombuffer(P, dtype=complex)
    std = np.sqrt(np.frombuffer(variance) + (FLOOR * np.abs(y)) ** 2 + 1e-300)
    if own.size < FEWEST or np.median(std / np.abs(y)) > KNOWN:
        return ()
    s = 1j * own / own[0]
    tilt = s**integrators
    return _models(own[0], s, y * tilt, std * np.abs(tilt), tilt, integrators)


def _models(
    first_hz: float, s: ComplexArray, y: ComplexArray, std: Array, tilt: ComplexArray, integrators: int
) -> tuple[LowModel, ...]:
    found: list[tuple[float, LowModel]] = []
    least = np.inf
    for nb, na in ORDERS:
        parameters = nb + 1 + na
        if parameters > least + MORE or 2 * s.size < 2 * parameters + 4:
            continue
        if (fitted := _fitted(s, y, std, nb, na)) is None:
            continue
        num, den = fitted
        left = np.sum(np.abs((y - _rational(s, num, den)) / std) ** 2)
        freedom = 2 * s.size - parameters
        if 2.0 * left > freedom + 4.0 * np.sqrt(2.0 * freedom):
            continue
        least = min(least, parameters)
        jacobian = _slopes(s, num, den) / std[:, None]
        solved = np.linalg.pinv(np.concatenate([jacobian.real, jacobian.imag]), rcond=1e-10)
        scale = np.concatenate([1.0 / std, 1.0 / std])
        if _is_known(solved, num, den) and 1.0 / AWAY < abs(num[0] / _rational(s[:1], num, den)[0]) < AWAY:
            # errors come as those of P, in real and imaginary parts: turned by the tilt of s^k first
            turned = _turned(solved * scale, tilt)
            akaike = 2.0 * float(left) + 2.0 * parameters
            found.append((akaike, LowModel(float(first_hz), integrators, num, den, turned, s.size)))
    return tuple(model for _, model in sorted(found, key=lambda x: x[0]))


def _turned(influence: Array, tilt: ComplexArray) -> Array:
    n = tilt.size
    re, im = influence[:, :n], influence[:, n:]
    return np.concatenate([re * tilt.real + im * tilt.imag, im * tilt.real - re * tilt.imag], axis=1)


def _is_known(solved: Array, num: Array, den: Array) -> bool:
    """Whether B(0) is known, and A has no sharp resonance below the first line."""
    known = np.sqrt(0.5 * np.sum(solved[0] ** 2)) < KNOWN * abs(num[0])
    size = np.abs(_polynomial(np.asarray(1j * np.linspace(0.0, 1.0, 65)), den))
    return bool(known and size.min() > SHARP * min(size[0], size[-1]))


def _fitted(s: ComplexArray, y: ComplexArray, std: Array, nb: int, na: int) -> tuple[Array, Array] | None:
    """B and A, coefficients rising, by linear least squares weighted anew (Sanathanan and Koerner 1963).

    None where a pole comes to lie on a line, as of a plant without poles and noise.
    """
    den = np.eye(1, na + 1)[0]
    powers = s[:, None] ** np.arange(max(nb, na) + 1)
    for _ in range(ROUNDS if na else 1):
        with np.errstate(divide="ignore", over="ignore"):
            weight = 1.0 / (std * np.abs(_polynomial(s, den)))
        if not np.isfinite(weight).all():
            return None
        columns = np.concatenate([powers[:, : nb + 1], -y[:, None] * powers[:, 1 : na + 1]], axis=1) * weight[:, None]
        target = y * weight
        solved = np.linalg.lstsq(
            np.concatenate([columns.real, columns.imag]), np.concatenate([target.real, target.imag]), rcond=None
        )[0]
        num, den = solved[: nb + 1], np.concatenate([[1.0], solved[nb + 1 :]])
    return num, den


def _polynomial(s: ComplexArray, rising: Array) -> ComplexArray:
    return np.asarray(np.polyval(rising[::-1], s))


def _rational(s: ComplexArray, num: Array, den: Array) -> ComplexArray:
    return np.asarray(_polynomial(s, num) / _polynomial(s, den))


def _slopes(s: ComplexArray, num: Array, den: Array) -> ComplexArray:
    """d(B/A) by the coefficients of B and of A but its first, (n, parameters)."""
    A = _polynomial(s, den)
    powers = s[:, None] ** np.arange(max(num.size, den.size))
    by_num = powers[:, : num.size] / A[:, None]
    by_den = -powers[:, 1 : den.size] * (_polynomial(s, num) / A**2)[:, None]
    return np.concatenate([by_num, by_den], axis=1)
