"""C and L of a problem at a point x, and what follows from them, each computed once and only where asked."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from loopshape.core.kernels.loops import flat_loops as kernel
from loopshape.core.kernels.loops.tuning_rows import Flat
from loopshape.core.remembered import remembered
from loopshape.core.units import Array, ComplexArray
from loopshape.data.control.block import series_response
from loopshape.data.requirement.weight import WEIGHTED, stacked
from loopshape.design.problem.problem import Problem
from loopshape.design.structure import sections


@dataclass(frozen=True, eq=False)
class Evaluation:
    """The loops of a problem at x (n,): C on its columns, all else on its flat lines."""

    p: Problem
    x: Array

    @cached_property
    def values(self) -> list[dict[str, float]]:
        """Parameters of each block at x."""
        return self.p.values(self.x)

    @cached_property
    def sections(self) -> Array:
        """Coefficients of the blocks (blocks, 6)."""
        return sections(self.p.templates, self.values)

    @cached_property
    def C(self) -> ComplexArray:
        """C on the columns, without its integral terms on the wide ones."""
        s, wide = self.p.s, self.p.wide
        every = kernel.series(self.sections, s[: wide.start])
        if self.p.f_wide.size:
            every = np.concatenate([every, series_response(self.p.blocks(self.x), s[wide], bounded=True)])
        return every if self.p.outside is None else every * self.p.outside

    @cached_property
    def below(self) -> ComplexArray:
        """L below the lowest lines, by the models of the plants, flat."""
        return kernel.series(self.sections, self.p.s_below) * self.p.P_below

    @cached_property
    def ln_C(self) -> Array:
        """ln |C| on the columns."""
        return np.log(np.abs(self.C))

    @cached_property
    def _loops(self) -> tuple[ComplexArray, Array, Array]:
        return kernel.loops(self.C, self.p.line, self.p.P)

    @property
    def L(self) -> ComplexArray:
        """L on the flat lines."""
        return self._loops[0]

    @property
    def ln_L(self) -> Array:
        """ln |L|."""
        return self._loops[1]

    @property
    def ln_S(self) -> Array:
        """ln |S|, S = 1/(1 + L)."""
        return self._loops[2]

    @cached_property
    def ln_norm(self) -> Array:
        """ln of the norm of the weighted loop on the flat lines."""
        weights = weighed(self.p)
        with np.errstate(divide="ignore"):
            return self.ln_S + 0.5 * np.log(weights.own + weights.by_C * np.exp(2.0 * self.ln_C[self.p.line]))

    @cached_property
    def flat(self) -> Flat:
        """The lines as the kernels of rows take them."""
        p, weights = self.p, weighed(self.p)
        return Flat(
            p.f, p.ln_f, self.L, self.ln_L, self.ln_S, p.ln_P, self.ln_C, p.ln_circle, p.line, p.first, p.below,
            p.f_above, p.above.start, weights.own, weights.by_C,
        )  # fmt: skip

    @cached_property
    def axis(self) -> np.ndarray:
        """Flat lines k where L passes the real axis, either side, before the next line."""
        y = self.L.imag
        return np.flatnonzero((y[1:] * y[:-1] <= 0.0) & self.p.inside)

    @cached_property
    def last(self) -> np.ndarray:
        """The last flat line of each operating point."""
        return self.p.first[1:] - 1

    @cached_property
    def share_above(self) -> Array:
        """|L| at the last lines, below 1: above them L is taken to stay no larger."""
        return np.exp(np.minimum(self.ln_L[self.last], -1e-6))

    @cached_property
    def stable(self) -> bool:
        """Whether |L| ends below 1 and the bare Nyquist count is zero at every operating point."""
        if self.ln_L[self.last].max() >= 0.0:
            return False
        p = self.p
        return bool(kernel.all_stable(self.L, p.first, self.below, p.first_below, p.fitted, p.integrators, p.unstable))


@dataclass(frozen=True, eq=False)
class Weighed:
    """The squared norm at a frequency is |S|² (`own` + `by_C` |C|²), (nf,) on the flat lines: none without weights.

    `above` (points, 4, above) are the squared weights above each point's last line, 0 below that.
    """

    own: Array
    by_C: Array  # noqa: N815
    above: Array


@remembered
def weighed(p: Problem) -> Weighed:
    """The weights of a problem."""
    weights = p.requirements.weights
    if not weights:
        return Weighed(np.zeros(0), np.zeros(0), np.zeros((p.points, len(WEIGHTED), 0)))
    s, t, cs, ps = stacked(weights, p.f)
    square = np.abs(p.P) ** 2
    last = p.f[p.first[1:] - 1]
    above = stacked(weights, p.f_above) * (p.f_above >= last[:, None])[:, None, :]
    return Weighed(s + ps * square, cs + t * square, above)
