"""What noise does to a smoothed response: draws of its error, the same for every controller."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from loopshape.core.units import Array, ComplexArray

#: deviation of what lies between lines, as a share of how far a spline lies off straight lines there; and its seed
BETWEEN, SEED = 0.5, 20072
#: fewer lines than this are not read between
FEWEST = 6
#: the slope of the lowest lines is taken up to so many times the first frequency, four lines at least; and its most
LOWEST, STEEPEST = 2.0, 4.0


def by_draw(draws: ComplexArray) -> ComplexArray:
    """Draws (draws, ...) in the order in which kernels go through them, read-only."""
    own = np.ascontiguousarray(draws).view()
    own.setflags(write=False)
    return own


def spread(draws: ComplexArray) -> tuple[Array, Array, Array]:
    """Root mean square (n,), standard deviation (n,) and neighbours' correlation (n - 1,) of draws (draws, n)."""
    from loopshape.core.kernels.smoothing import spread

    return spread(by_draw(draws))


@dataclass(frozen=True, eq=False)
class Dense:
    """A smoothed response on its lines and between them over narrow resonances, with draws as in `Scatter`.

    `response` and `reference` are (n,), of a matrix (n, ny, nu); `deviations` have the draws in front.
    """

    frequency_hz: Array
    response: ComplexArray
    reference: ComplexArray
    deviations: ComplexArray

    def __post_init__(self) -> None:
        object.__setattr__(self, "deviations", by_draw(self.deviations))

    @cached_property
    def spread(self) -> tuple[Array, Array, Array]:
        """What `spread` tells of the draws of a response that is none of a matrix."""
        return spread(self.deviations)

    def at(self, frequency_hz: Array) -> Dense:
        """The same at other frequencies (m,) within these, by cubic splines; draws go straight from line to line.

        Both are of the response without the power of f that its lowest lines follow: integrators are none of a spline's
        business. Half of how far a spline lies off a straight line is taken for a deviation of its own, common to all
        places; it lies off it by no more than half of how far the response moves from line to line about there.
        """
        from loopshape.core.kernels.smoothing import straight

        f, at = self.frequency_hz, frequency_hz
        k = np.clip(np.searchsorted(f, at, side="right") - 1, 0, f.size - 1)
        new = f[k] != at
        k[new] = np.minimum(k[new], f.size - 2)
        response, reference = self.response[k], self.reference[k]
        before, after, off = np.ones(at.size, dtype=complex), np.zeros(at.size, dtype=complex), np.zeros_like(response)
        if new.any():
            response[new], reference[new], before[new], after[new], off[new] = self._between(at[new], k[new])
        sides = np.random.default_rng(SEED).standard_normal((len(self.deviations), 2)) @ np.array([1.0, 1j])
        sides *= np.sqrt(2.0 / np.mean(np.abs(sides) ** 2))
        deviations = straight(
            self.deviations.reshape(len(sides), f.size, -1), k, before, after, sides, off.reshape(at.size, -1)
        )
        return Dense(at, response, reference, deviations.reshape(len(sides), *response.shape))

    def _between(
        self, at: Array, k: np.ndarray
    ) -> tuple[ComplexArray, ComplexArray, ComplexArray, ComplexArray, ComplexArray]:
        """Response and reference `at` places (n,) in the gaps k (n,); of draws the lines' weights and the deviation."""
        f = self.frequency_hz
        each = (-1, *[1] * (self.response.ndim - 1))
        share, power = (at - f[k]) / (f[k + 1] - f[k]), _power(f, self.response)
        own, back = (f / f[0]) ** -power, (at / f[0]) ** power
        flat = [x * own.reshape(each) for x in (self.response, self.reference)]
        one, two = (_curved(f, x, at, k, share.reshape(each)) for x in flat)
        response, reference = (back.reshape(each) * (line + off) for line, off in (one, two))
        side = np.sqrt(0.5) * BETWEEN * back.reshape(each) * one[1]
        return response, reference, back * own[k] * (1.0 - share), back * own[k + 1] * share, side

    def between(self, moved: Array, room: Array, step: float, most: int) -> Dense:
        """The same with places between lines that move by more than a `step` of the `room` there; (n - 1,) each."""
        f = self.frequency_hz
        with np.errstate(divide="ignore", invalid="ignore"):
            ratio = np.nan_to_num(moved / (step * room), posinf=float(most))
        far = np.flatnonzero(ratio > 1.0)
        if not far.size or f.size < FEWEST:
            return self
        count = np.clip(np.ceil(ratio[far]), 2, most).astype(int)
        more = [f[k] + (f[k + 1] - f[k]) * np.arange(1, n) / n for k, n in zip(far, count, strict=True)]
        return self.at(np.unique(np.concatenate([f, *more])))


def _power(f: Array, values: ComplexArray) -> complex:
    """d ln P/d ln f of the lowest lines of the largest element; 0 where they tell none."""
    count = min(max(int(np.searchsorted(f, LOWEST * f[0])), 4), f.size)
    lowest = values[:count].reshape(count, -1)
    lowest = lowest[:, int(np.argmax(np.abs(lowest[0])))]
    if count < 2 or not lowest.all():
        return 0j
    ln = np.log(np.abs(lowest)) + 1j * np.unwrap(np.angle(lowest))
    x = np.log(f[:count] / f[0])
    x = x - x.mean()
    power = complex(x @ ln / (x @ x))
    return power if abs(power) <= STEEPEST else 0j


def _curved(
    f: Array, values: ComplexArray, at: Array, k: np.ndarray, share: Array
) -> tuple[ComplexArray, ComplexArray]:
    """Values (n, ...) straight between lines, and how far a spline lies off that, at `share` of the k-th gaps."""
    straight = values[k] * (1.0 - share) + values[k + 1] * share
    step = np.abs(np.diff(values, axis=0))
    about = np.maximum(step[np.maximum(k - 1, 0)], np.maximum(step[k], step[np.minimum(k + 1, f.size - 2)]))
    off = spline(f, values, at, k) - straight
    most = 0.5 * about
    return straight, np.asarray(off * most / np.maximum(np.abs(off), np.maximum(most, 1e-300)))


def spline(f: Array, values: ComplexArray, at: Array, k: np.ndarray) -> ComplexArray:
    """The cubic spline through values (lines, ...), four lines at least, at places (n,) in the gaps k (n,).

    No knot at the second and the last but one line; scipy's `CubicSpline` to the last bit, whose import takes longer
    than all of a check's splines (de Boor, A Practical Guide to Splines, IV).
    """
    from scipy.linalg import solve_banded

    y = values.reshape(f.size, -1)
    h = np.diff(f)
    wide, slope = h[:, None], np.diff(y, axis=0) / h[:, None]
    bands, right = np.zeros((3, f.size)), np.empty_like(y)
    bands[1, 1:-1], bands[0, 2:], bands[2, :-2] = 2.0 * (h[:-1] + h[1:]), h[:-1], h[1:]
    right[1:-1] = 3.0 * (wide[1:] * slope[:-1] + wide[:-1] * slope[1:])
    for end, near, step in ((0, 1, 1), (-1, -2, -1)):
        two = abs(f[end + 2 * step] - f[end])
        bands[1, end], bands[1 - step, near] = h[near], two
        right[end] = ((wide[end] + 2.0 * two) * wide[near] * slope[end] + wide[end] ** 2 * slope[near]) / two
    s = solve_banded((1, 1), bands, right)
    bend = (s[:-1] + s[1:] - 2.0 * slope) / wide
    z, each = (at - f[k])[:, None], [y[k], s[k], ((slope - s[:-1]) / wide - bend)[k], (bend / wide)[k]]
    out = each[0] + each[1] * z + each[2] * (z * z) + each[3] * (z * z * z)
    return np.asarray(out.reshape(at.size, *values.shape[1:]))


@dataclass(frozen=True, eq=False)
class Scatter:
    """Draws of the error of a response on its lines, about a reference.

    What a nonlinear reading (a margin, a peak) suffers from noise is seen by reading `reference` + each of the
    `deviations` (draws, nf) against reading `reference` (nf,): its bias and its spread. `dense` is
    the same with places between lines where narrow resonances ask for them, None where none does. These resonances
    are `residue` (n,) over j (f - `pole_hz`) (n,), with their mirrors.
    """

    reference: ComplexArray
    deviations: ComplexArray
    dense: Dense | None = None
    pole_hz: ComplexArray = field(default_factory=lambda: np.zeros(0, dtype=complex))
    residue: ComplexArray = field(default_factory=lambda: np.zeros(0, dtype=complex))

    def narrow(self, frequency_hz: Array) -> ComplexArray:
        """What the narrow resonances add at frequencies (...,) in Hz."""
        f = np.asarray(frequency_hz, dtype=float)
        out = np.zeros(f.shape, dtype=complex)
        for z, r in zip(self.pole_hz, self.residue, strict=True):
            out += r / (1j * (f - z)) + np.conj(r) / (1j * (f + np.conj(z)))
        return out

    def __post_init__(self) -> None:
        for name in ("reference", "deviations", "pole_hz", "residue"):
            copy = np.array(getattr(self, name), order="C")
            copy.setflags(write=False)
            object.__setattr__(self, name, copy)
