"""A few lines about each gap between the lines of a plant: a polynomial in ln f over them, with and without a pole.

Over a window the plant is taken as (f/f_m)^c (polynomial + sum of poles), with a complex power c that takes out slope
and delay. Columns and data are weighted by each line's own deviation, so a squared misfit counts in units of noise.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from loopshape.core.units import Array, ComplexArray
from loopshape.loop.tolerances import TOL

#: less noise than this share of |P| the arithmetic itself does not have
_FLOOR = 1e-7


@dataclass(frozen=True, eq=False)
class Windows:
    """Windows of w lines about n gaps: `around` (n, w) in Hz, `data` (n, w) and `weight` (n, w), `basis` (n, w, m).

    `power` (n,) and `middle` (n,) in Hz are those of the reference (f/f_m)^c, `gap` (n,) the width in Hz of the gap,
    `std` (n,) the larger deviation of its lines and `size` (n,) the smaller |P|.
    """

    around: Array
    weight: Array
    data: ComplexArray
    basis: ComplexArray
    power: ComplexArray
    middle: Array
    low: Array
    gap: Array
    std: Array
    size: Array

    def __getitem__(self, k: int | np.ndarray) -> Windows:
        rows = np.atleast_1d(k)
        return Windows(*(getattr(self, name)[rows] for name in self.__dataclass_fields__))

    def reference(self, f: Array) -> ComplexArray:
        """(f/f_m)^c at f (n, ...) in Hz."""
        shape = (-1,) + (1,) * (np.ndim(f) - 1)
        return np.asarray(np.exp(self.power.reshape(shape) * np.log(f / self.middle.reshape(shape))))

    def rest(self, columns: ComplexArray) -> ComplexArray:
        """What the polynomials leave of columns (n, w, j)."""
        return np.asarray(columns - self.basis @ (self.basis.transpose(0, 2, 1) @ columns))

    def pole(self, z: ComplexArray, power: int = 1) -> ComplexArray:
        """What they leave of poles 1/(j (f - z))^power at z = centre + j half width (n, j), in Hz: (n, w, j)."""
        across = 1j * (self.around[:, :, None] - z[:, None, :])
        return self.rest(self.weight[:, :, None] / across**power)


def windows_of(f: Array, P: ComplexArray, variance: Array) -> Windows:
    """Windows about each gap of lines f (nf,); near an end the gap is no longer their middle."""
    half = TOL.window_lines
    rows = np.clip(np.arange(f.size - 1) - half + 1, 0, f.size - 2 * half)[:, None] + np.arange(2 * half)
    return _of_rows(f, P, variance, rows, np.arange(f.size - 1))


def window_over(f: Array, P: ComplexArray, variance: Array, first: int, last: int, order: int) -> Windows:
    """One window of lines `first` .. `last` with a polynomial of an `order`; its gap is the first."""
    return _of_rows(f, P, variance, np.arange(first, last + 1)[None, :], np.array([first]), order)


def _of_rows(
    f: Array, P: ComplexArray, variance: Array, rows: np.ndarray, gap: np.ndarray, order: int = TOL.window_order
) -> Windows:
    std = np.sqrt(variance + (_FLOOR * np.abs(P)) ** 2)
    std = np.maximum(std, 1e-300)
    around, ln_f = f[rows], np.log(f)
    middle = np.exp(ln_f[rows].mean(axis=1))
    power = _slopes(ln_f, P, std, rows)
    reference = np.exp(power[:, None] * np.log(around / middle[:, None]))
    weight = np.abs(reference) / std[rows]
    x = np.log(around / around[:, :1])
    x = 2.0 * x / x[:, -1:] - 1.0
    basis = np.linalg.qr(np.stack([x**s for s in range(order + 1)], axis=-1) * weight[:, :, None])[0]
    ends = np.maximum(std[1:], std[:-1])[gap], np.minimum(np.abs(P[1:]), np.abs(P[:-1]))[gap]
    data = P[rows] / reference * weight
    return Windows(around, weight, data, basis, power, middle, f[:-1][gap], np.diff(f)[gap], *ends)


def _slopes(ln_f: Array, P: ComplexArray, std: Array, rows: np.ndarray) -> ComplexArray:
    """d ln P/d ln f of each window's median line (n,), zero where noise hides it."""
    with np.errstate(divide="ignore", invalid="ignore"):
        step = np.log(P[1:] / P[:-1]) / np.diff(ln_f)
        noisy = np.median((std / np.abs(P))[rows], axis=1) > 0.3
    steps = step[rows[:, :-1]]
    power = np.median(steps.real, axis=1) + 1j * np.median(steps.imag, axis=1)
    return np.where(noisy | ~np.isfinite(power), 0.0, power)
