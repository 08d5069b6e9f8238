"""C and L of a problem at a point x, and what follows from them, each computed once and only where asked."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from loopshape.core.units import Array, ComplexArray
from loopshape.data.controller import Block, series_response
from loopshape.design.problem import Problem
from loopshape.loop.stability import count_unstable


@dataclass(frozen=True, eq=False)
class Evaluation:
    """The loops of a problem at x (n,): C on its columns, all else on its flat lines."""

    p: Problem
    x: Array

    @cached_property
    def blocks(self) -> tuple[Block, ...]:
        """Blocks at x."""
        return self.p.blocks(self.x)

    @cached_property
    def C(self) -> ComplexArray:
        """C on the columns, without its integral terms on the wide ones."""
        s, wide = self.p.s, self.p.wide
        every = series_response(self.blocks, s[: wide.start])
        if self.p.f_wide.size:
            every = np.concatenate([every, series_response(self.blocks, s[wide], bounded=True)])
        return every if self.p.outside is None else every * self.p.outside

    @cached_property
    def ln_C(self) -> Array:
        """ln |C| on the columns."""
        return np.log(np.abs(self.C))

    @cached_property
    def L(self) -> ComplexArray:
        """L on the flat lines."""
        return self.C[self.p.line] * self.p.P

    @cached_property
    def ln_L(self) -> Array:
        """ln |L|."""
        return self.ln_C[self.p.line] + self.p.ln_P

    @cached_property
    def ln_S(self) -> Array:
        """ln |S|, S = 1/(1 + L)."""
        return -_ln_size(1.0 + self.L)

    @cached_property
    def ln_disk(self) -> Array:
        """ln |(1 - L)/(1 + L)|, large where a disk of changes is soon too much."""
        return _ln_size(1.0 - self.L) + self.ln_S

    @cached_property
    def S(self) -> ComplexArray:
        """S on the flat lines."""
        return np.asarray(1.0 / (1.0 + self.L))

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
        p, below = self.p, self.p.below(self.blocks)
        turning = np.unique(np.concatenate([p.first[:-1], self.last, self.axis, self.axis + 1]))
        cut = np.searchsorted(turning, p.first)
        for i, (k, u) in enumerate(zip(p.integrators, p.unstable, strict=True)):
            # between passages of the real axis 1 + L turns by what its ends say
            mine = self.L[turning[cut[i] : cut[i + 1]]]
            before = below[p.first_below[i] : p.first_below[i + 1]]
            poles = count_unstable(mine, int(k), int(u), before if p.fitted[i] else before[:0])
            if poles is None and before.size and not p.fitted[i]:
                poles = count_unstable(mine, int(k), int(u), before)
            if poles != 0:
                return False
        return True


def _ln_size(z: ComplexArray) -> Array:
    """ln |z|, faster than by abs."""
    return np.asarray(0.5 * np.log(z.real**2 + z.imag**2))
