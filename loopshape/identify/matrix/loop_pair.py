"""Two loops of a square FRF, as the four elements that k_I = H12 H21/(H11 H22) is made of."""

from __future__ import annotations

import numpy as np

from loopshape.core.units import Array, ComplexArray
from loopshape.data.response.frf import FRF
from loopshape.identify.matrix.magnitude_bounds import TAIL, Reach, product_bounds

#: exponents of H12, H21, H11, H22 in k_I
EXPONENTS = np.array([1.0, 1.0, -1.0, -1.0])


class LoopPair:
    """The four elements of two loops: H12, H21, H11, H22 (nf, 4) and their covariance (nf, 4, 4)."""

    def __init__(self, frf: FRF, i: int, j: int) -> None:
        n = len(frf.outputs)
        places = np.array([j * n + i, i * n + j, i * n + i, j * n + j])
        vec = frf.response.transpose(0, 2, 1).reshape(len(frf.frequency_hz), -1)
        self.elements: ComplexArray = vec[:, places]
        self.covariance: ComplexArray = frf.covariance[:, places][:, :, places]
        self.freedom = frf.variance_freedom
        self.frequency_hz: Array = frf.frequency_hz
        self.line_overlap = frf.line_overlap
        self.trusted: np.ndarray = frf.trusted

    @property
    def coefficient(self) -> ComplexArray:
        """k_I (nf,); infinite where H11 or H22 is zero, nan where 0/0."""
        H = self.elements
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.asarray(H[:, 0] * H[:, 1] / (H[:, 2] * H[:, 3]))

    @property
    def relative_std(self) -> Array:
        """sqrt(E|dk/k|²) (nf,) of dk/k = d12/H12 + d21/H21 - d11/H11 - d22/H22, with all cross-covariances."""
        with np.errstate(divide="ignore", invalid="ignore"):
            slope = EXPONENTS / self.elements
            variance = np.real(np.einsum("fi,fij,fj->f", slope, self.covariance, slope.conj()))
        return np.sqrt(np.maximum(np.where(np.isnan(variance), np.inf, variance), 0.0))

    def bounds(self, lines: np.ndarray, tail: float = TAIL, more: float = 1.0) -> Reach:
        """Ends of |k_I| on some lines; with `more` than 1 those to be expected of that many times the averages."""
        H, C = self.elements[lines], self.covariance[lines]
        if more == 1.0:
            return product_bounds(H, C, EXPONENTS, self.freedom, tail)
        power, noise = np.abs(H) ** 2, np.real(np.einsum("fii->fi", C))
        size = np.sqrt(np.maximum(power - noise, 0.0) + noise / more)
        with np.errstate(invalid="ignore", divide="ignore"):
            shrunk = H * np.where(power > 0.0, size / np.sqrt(power), 0.0)
        shrunk = np.where(power > 0.0, shrunk, size)
        return product_bounds(shrunk, C / more, EXPONENTS, self.freedom * more, tail)
