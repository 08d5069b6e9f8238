"""Array types of the kernels."""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]


class Sliced(Protocol):
    """A signal (n,) that is an array, or is read a slice at a time."""

    @property
    def size(self) -> int:
        """Number of samples."""

    def __getitem__(self, rows: slice, /) -> Array:
        """Some of them, next to each other."""
