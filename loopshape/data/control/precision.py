"""The numbers that a controller's coefficients are kept in: double, single, or signed fixed point qM.N."""

from __future__ import annotations

import re
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from loopshape.core.errors import WrongUseError
from loopshape.core.units import Array

_FIXED = re.compile(r"q([1-9][0-9]?)\.([1-9][0-9]?)")
_MOST_BITS = 45  # signals then keep 16 bits beside a sign in products of 60
_PRODUCT_BITS = 60  # five products of 60 bits add up within int64
_SIGNAL_BITS = 31


@dataclass(frozen=True)
class Precision:
    """A number format. `name` is "double", "single", or "qM.N": M integer bits with the sign, N fractional bits.

    A fixed-point coefficient is an integer times 2^-N between -2^(M-1) and 2^(M-1) - 2^-N; M + N is 45 at most.
    """

    name: str
    integer_bits: int = 0
    fraction_bits: int = 0

    @classmethod
    def of(cls, name: str) -> Precision:
        """The format of a name; refuses a name that is none."""
        if name in ("double", "single"):
            return cls(name)
        found = _FIXED.fullmatch(name) if isinstance(name, str) else None
        if not found or int(found[1]) + int(found[2]) > _MOST_BITS:
            raise WrongUseError(
                "a precision of coefficients is not known",
                repr(name),
                f'use "double", "single", or fixed point "qM.N" of at most {_MOST_BITS} bits, such as "q5.27"',
            )
        return cls(name, int(found[1]), int(found[2]))

    @property
    def fixed(self) -> bool:
        """Whether it is fixed point."""
        return self.integer_bits > 0

    @property
    def bits(self) -> int:
        """Bits of a fixed-point coefficient, with its sign."""
        return self.integer_bits + self.fraction_bits

    @property
    def range(self) -> tuple[float, float]:
        """Least and largest coefficient."""
        if self.fixed:
            return -(2.0 ** (self.integer_bits - 1)), 2.0 ** (self.integer_bits - 1) - 2.0**-self.fraction_bits
        largest = float(np.finfo(np.float32 if self.name == "single" else np.float64).max)
        return -largest, largest

    @property
    def signal_limit(self) -> int:
        """Fixed point: largest magnitude of an integer signal for which no sum of products leaves int64."""
        return int(min(2**_SIGNAL_BITS, 2 ** (_PRODUCT_BITS - self.bits + 1)) - 1)

    def rounded(self, values: ArrayLike) -> Array:
        """The nearest values of the format, ties to even, in double (which holds them exactly); not clipped."""
        values = np.asarray(values, dtype=float)
        if self.fixed:
            return np.asarray(np.rint(values * 2.0**self.fraction_bits) * 2.0**-self.fraction_bits)
        with np.errstate(over="ignore", under="ignore"):
            return values.astype(np.float32).astype(float) if self.name == "single" else values

    def fits(self, rounded: ArrayLike) -> np.ndarray:
        """Which rounded values lie within the range."""
        low, high = self.range
        return np.asarray((low <= np.asarray(rounded)) & (np.asarray(rounded) <= high))

    def integers(self, rounded: Array) -> list[list[int]]:
        """Fixed point: rounded values (n, m) as integers, value = integer 2^-N."""
        return [[int(v * 2.0**self.fraction_bits) for v in row] for row in rounded]

    def wide_enough(self, values: ArrayLike) -> Precision | None:
        """Fixed point: as many bits with an integer part that holds `values`; None where there is none."""
        for m in range(self.integer_bits, self.bits):
            wider = Precision(f"q{m}.{self.bits - m}", m, self.bits - m)
            if wider.fits(wider.rounded(values)).all():
                return wider
        return None
