"""What noise does to a smoothed response: draws of its error, the same for every controller."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline

from loopshape.units import Array, ComplexArray

#: deviation of what lies between lines, as a share of how far a spline lies off straight lines there; and its seed
BETWEEN, SEED = 0.5, 20072
#: fewer lines than this are not read between
FEWEST = 6


@dataclass(frozen=True, eq=False)
class Dense:
    """A smoothed response on its lines and between them over narrow resonances, with draws as in `Scatter`.

    `response` and `reference` are (n,), of a matrix (n, ny, nu); `deviations` have the draws in front.
    """

    frequency_hz: Array
    response: ComplexArray
    reference: ComplexArray
    deviations: ComplexArray

    def at(self, frequency_hz: Array) -> Dense:
        """The same at other frequencies (m,) within these, by cubic splines; draws go straight from line to line.

        Half of how far a spline lies off a straight line is taken for a deviation of its own, common to all places; it
        lies off it by no more than half of how far the response moves from line to line about there.
        """
        f, at = self.frequency_hz, frequency_hz
        k = np.clip(np.searchsorted(f, at, side="right") - 1, 0, f.size - 2)
        share = ((at - f[k]) / (f[k + 1] - f[k])).reshape(-1, *[1] * (self.response.ndim - 1))
        straight, off = _curved(f, self.response, at, k, share)
        sides = np.random.default_rng(SEED).standard_normal((len(self.deviations), 2)) @ np.array([1.0, 1j])
        deviations = self.deviations[:, k] * (1.0 - share) + self.deviations[:, k + 1] * share
        deviations += np.sqrt(0.5) * BETWEEN * sides.reshape(-1, *[1] * self.response.ndim) * off
        again = _curved(f, self.reference, at, k, share)
        return Dense(at, straight + off, again[0] + again[1], deviations)

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


def _curved(
    f: Array, values: ComplexArray, at: Array, k: np.ndarray, share: Array
) -> tuple[ComplexArray, ComplexArray]:
    """Values (n, ...) straight between lines, and how far a spline lies off that, at `share` of the k-th gaps."""
    straight = values[k] * (1.0 - share) + values[k + 1] * share
    step = np.abs(np.diff(values, axis=0))
    about = np.maximum(step[np.maximum(k - 1, 0)], np.maximum(step[k], step[np.minimum(k + 1, f.size - 2)]))
    off = CubicSpline(f, values)(at) - straight
    return straight, np.asarray(off * np.minimum(1.0, 0.5 * about / np.maximum(np.abs(off), 1e-300)))


@dataclass(frozen=True, eq=False)
class Scatter:
    """Draws of the error of a response on its lines, about a reference.

    What a nonlinear reading (a margin, a peak) suffers from noise is seen by reading `reference` + each of the
    `deviations` (draws, nf) against reading `reference` (nf,): its bias and its spread. `dense` is
    the same with places between lines where narrow resonances ask for them, None where none does.
    """

    reference: ComplexArray
    deviations: ComplexArray
    dense: Dense | None = None

    def __post_init__(self) -> None:
        for name in ("reference", "deviations"):
            copy = np.array(getattr(self, name))
            copy.setflags(write=False)
            object.__setattr__(self, name, copy)
