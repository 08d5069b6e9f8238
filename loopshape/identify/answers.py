"""What signals answer to instruments: the first half of every estimate, whichever transforms it comes from.

An instrument is a signal that only we moved. With H the responses of output and plant input to it, P = H_y H_u^-1:
what the instrument did not cause averages out, in closed loop too (van den Hof and Schrama 1993; the source's H.6).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.ndimage import median_filter

from loopshape.core.units import Array, ComplexArray
from loopshape.identify.tolerances import TOL


@dataclass(frozen=True, eq=False)
class Answers:
    """Responses (nf, m, nr) of m signals to nr instruments, with covariance (nf, m nr, m nr) of vec, columns stacked.

    `noise` is the part of the covariance that noise leaves, None where it cannot be told from the rest. `power`
    (nf, m + nr, m + nr) are cross-powers of signals and instruments, per Hz or per line as `power_per` says, over
    `averages` effective averages. `excited` (nf,) marks lines that every instrument feeds,
    `unresolved` (nf,) those on which a resonance is too narrow for the lines' distance: their bias is in no
    covariance. The rest as in `FRF`.
    """

    frequency_hz: Array
    response: ComplexArray
    covariance: ComplexArray
    power: ComplexArray
    excited: np.ndarray
    averages: float
    power_per: str
    line_overlap: float
    freedom: float
    pooled: int
    method: str
    noise: ComplexArray | None = None
    notes: tuple[str, ...] = ()
    unresolved: np.ndarray | None = None
    method_numbers: Mapping[str, float] = field(default_factory=dict)

    def select(self, lines: np.ndarray | slice) -> Answers:
        """The same on a mask, index or slice of lines; no copy of a slice, nor of a mask that is one."""
        lines = lines if isinstance(lines, slice) else _as_slice(lines)
        names = ("frequency_hz", "response", "covariance", "power", "excited", "noise", "unresolved")
        return replace(self, **{n: getattr(self, n)[lines] for n in names if getattr(self, n) is not None})


def _as_slice(lines: np.ndarray) -> np.ndarray | slice:
    """A mask of neighbouring lines as a slice; anything else as it is."""
    if lines.dtype != bool or not lines.any():
        return lines
    first, last = int(np.argmax(lines)), lines.size - int(np.argmax(lines[::-1]))
    return slice(first, last) if lines[first:last].all() else lines


#: lines that are worked on at a time
BLOCK = 1 << 16


def blocks(lines: int) -> list[slice]:
    """Slices of so many lines each, so that what is worked on between does not grow with their number."""
    return [slice(low, min(low + BLOCK, lines)) for low in range(0, lines, BLOCK)]


@dataclass(frozen=True, eq=False)
class PlantEstimate:
    """P (nf, ny, nu), covariance of its vec, noise's part of it or None, and where loop noise exceeds the excitation.

    `drowned` (nf,) is the relative deviation of what the plant inputs answer to the instruments. The covariance holds
    to first order in it; towards 1 loop noise exceeds the excitation, P becomes -1/C, and no
    residual shows it.
    """

    response: ComplexArray
    covariance: ComplexArray
    noise: ComplexArray | None
    drowned: Array

    def sound(self, rows: np.ndarray) -> np.ndarray:
        """Which of the excited lines `rows` the first order holds on, by the median of nine: one may be lucky."""
        return np.asarray(median_filter(np.minimum(self.drowned[rows], 1e9), 9, mode="nearest") < TOL.drowned_std)


def plant_of(parts: Sequence[Answers], outputs: int) -> PlantEstimate:
    """P = H_y H_u^-1 from answers whose columns together are as many as plant inputs, on common lines.

    The first `outputs` signals are the plant's outputs, the rest its inputs; without inputs among them the
    instruments were the inputs themselves. Errors of different parts are independent: dP = [I, -P] dH H_u^-1.
    """
    every = blocks(parts[0].frequency_hz.size)
    found = [_plant_of([part.select(rows) for part in parts], outputs) for rows in every]
    if len(found) == 1:
        return found[0]
    noise = [one.noise for one in found if one.noise is not None]
    return PlantEstimate(
        np.concatenate([one.response for one in found]),
        np.concatenate([one.covariance for one in found]),
        np.concatenate(noise) if noise else None,
        np.concatenate([one.drowned for one in found]),
    )


def _plant_of(parts: Sequence[Answers], outputs: int) -> PlantEstimate:
    """`plant_of` a block of lines."""
    H = np.concatenate([part.response for part in parts], axis=2)
    if H.shape[1] == outputs:
        return PlantEstimate(H, parts[0].covariance, parts[0].noise, np.zeros(H.shape[0]))
    with np.errstate(all="ignore"):
        inverse = _inverse(H[:, outputs:])
        P = H[:, :outputs] @ inverse
        left = np.concatenate([np.broadcast_to(np.eye(outputs), (P.shape[0], outputs, outputs)), -P], axis=2)
        covariance = np.zeros((P.shape[0], P[0].size, P[0].size), dtype=complex)
        noise = None if any(part.noise is None for part in parts) else covariance.copy()
        first, unsure = 0, np.zeros((P.shape[0], P.shape[2]))
        for part in parts:
            last = first + part.response.shape[2]
            unsure += _input_errors(part, inverse[:, first:last], outputs)
            K = np.einsum("fjp,fai->fpaji", inverse[:, first:last], left).reshape(P.shape[0], P[0].size, -1)
            adjoint = K.conj().transpose(0, 2, 1)
            covariance += K @ part.covariance @ adjoint
            if noise is not None and part.noise is not None:
                noise += K @ part.noise @ adjoint
            first = last
        for part_of in (covariance, noise):
            if part_of is not None:  # what rounding made negative
                rows = np.arange(part_of.shape[1])
                part_of[:, rows, rows] = np.maximum(part_of[:, rows, rows].real, 0.0)
    return PlantEstimate(P, covariance, noise, np.sqrt(np.nan_to_num(np.maximum(unsure.max(axis=1), 0.0), nan=np.inf)))


def _input_errors(part: Answers, inverse: ComplexArray, outputs: int) -> Array:
    """Variances (nf, nu) of the diagonal of dH_u H_u^-1, which has no unit, by one part's errors."""
    nf, m, nr = part.response.shape
    errors = part.covariance.reshape(nf, nr, m, nr, m)[:, :, outputs:, :, outputs:]
    return np.asarray(np.einsum("fji,fjiki,fki->fi", inverse, errors, inverse.conj()).real)


def _inverse(matrix: ComplexArray) -> ComplexArray:
    """Inverses (nf, n, n), nan where there is none."""
    out = np.full_like(matrix, np.nan)
    if matrix.shape[1] == 1:
        return np.asarray(1.0 / matrix)
    finite = np.flatnonzero(np.isfinite(matrix).all(axis=(1, 2)))
    regular = finite[np.abs(np.linalg.det(matrix[finite])) > 0.0]
    out[regular] = np.linalg.inv(matrix[regular])
    return out


def ordinary_coherence(power: ComplexArray, a: int, b: int) -> Array:
    """Coherence (nf,) of two of the signals of `power`."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(np.abs(power[:, a, b]) ** 2 / (power[:, a, a].real * power[:, b, b].real))
