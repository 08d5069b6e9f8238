"""FRFs from arrays: a response whose error is stated, as a covariance, a standard deviation, or a coherence.

With a coherence g2 of a single input and K averages E|d|² = |H|² (1 - g2)/(g2 (K - 1)): Bendat and Piersol (Random
Data, 4th ed., table 9.6), less the one degree of freedom that H itself took.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from loopshape.core.errors import BadSignalError, WrongUseError
from loopshape.core.units import Array, ComplexArray
from loopshape.data.valid_band import trusted_lines

#: below it a variance would not be finite
LEAST_COHERENCE = 1e-12


def independent(variance: Array) -> ComplexArray:
    """Covariance (nf, n, n) of independent elements from their variances (nf, ny, nu)."""
    flat = variance.transpose(0, 2, 1).reshape(len(variance), -1)
    return (flat[:, :, None] * np.eye(flat.shape[1])).astype(complex)


def variance_by_coherence(response: ComplexArray, coherence: Array, averages: float) -> Array:
    """Variance (nf, ny, nu) of a single input's response from its coherence and the number of averages."""
    g2 = np.clip(coherence, LEAST_COHERENCE, 1.0)
    return np.asarray(np.abs(response) ** 2 * (1.0 - g2) / (g2 * (averages - 1.0)))


def valid_frequencies(frequency_hz: Array, response: ComplexArray, covariance: ComplexArray) -> np.ndarray:
    """Mask (nf,) of the valid band, by the largest error beside the largest singular value."""
    std = np.sqrt(np.maximum(np.real(np.einsum("fii->fi", covariance)), 0.0)).max(axis=1)
    size = np.maximum(np.linalg.norm(response, 2, axis=(1, 2)), 1e-300)
    return trusted_lines(frequency_hz, std / size, np.ones(std.size, dtype=bool))


def stated_arrays(
    frequency_hz: ArrayLike,
    response: ArrayLike,
    *,
    std: ArrayLike | None,
    relative_std: float | None,
    covariance: ArrayLike | None,
    coherence: ArrayLike | None,
    averages: float | None,
) -> dict[str, Any]:
    """Keywords of `FRF` for what the arrays say: frequencies, response (nf, ny, nu), covariance, valid band.

    A first frequency of 0 Hz is left out. Refuses arrays that do not fit together or hold NaN, and an error that
    is stated twice or not at all.
    """
    f, H = np.asarray(frequency_hz, dtype=float), np.asarray(response, dtype=complex)
    H = H[:, None, None] if H.ndim == 1 else H
    if f.ndim != 1 or H.ndim != 3 or H.shape[0] != f.size:
        raise WrongUseError(
            "a response has a value, or a matrix of outputs and inputs, for each frequency",
            f"{f.shape} frequencies and a response {np.shape(response)}",
            "give frequency_hz (nf,) and response (nf,) or (nf, ny, nu)",
        )
    keep = slice(1, None) if f.size and f[0] == 0.0 else slice(None)
    bad = f[keep][~np.isfinite(H[keep]).all(axis=(1, 2))]
    if bad.size:
        raise BadSignalError("the response holds values that are not numbers", f"at {bad[0]:g} Hz", "leave these out")
    stated = [x is not None for x in (std, relative_std, covariance, coherence)]
    if sum(stated) != 1 or (coherence is None) != (averages is None):
        raise WrongUseError(
            "nothing tells how sure this FRF is" if not any(stated) else "the error of a response is stated once",
            f"{sum(stated)} statements",
            "give std, relative_std (0: exact, as a model's response), covariance, or coherence with averages",
        )
    found: dict[str, Any] = {"frequency_hz": f[keep], "response": H[keep]}
    if covariance is not None:
        found["covariance"] = np.asarray(covariance, dtype=complex)[keep]
    elif coherence is not None and averages is not None:
        found |= _by_coherence(H, np.asarray(coherence, dtype=float), averages, keep)
    else:
        error = relative_std * np.abs(H) if relative_std is not None else _like(H, np.asarray(std, dtype=float))
        found["covariance"] = independent(np.asarray(error)[keep] ** 2)
    found["trusted"] = valid_frequencies(found["frequency_hz"], found["response"], found["covariance"])
    return found


def _like(H: ComplexArray, std: Array) -> Array:
    """Standard deviations (nf, ny, nu); refuses those of another shape, negative ones and NaN."""
    std = std[:, None, None] if std.ndim == 1 else std
    if np.ndim(std) not in (0, 3) or (np.ndim(std) == 3 and std.shape != H.shape) or not np.all(std >= 0.0):
        raise WrongUseError(
            "std is the standard deviation sqrt(E|d|²) of each value of the response, not negative",
            f"{std.shape} for a response {H.shape}",
            "give it in the response's shape",
        )
    return np.broadcast_to(std, H.shape)


def _by_coherence(H: ComplexArray, coherence: Array, averages: float, keep: slice) -> dict[str, Any]:
    if H.shape[1:] != (1, 1) or coherence.shape != H.shape[:1] or not np.all((coherence >= 0) & (coherence <= 1)):
        raise WrongUseError(
            "a coherence (nf,) between 0 and 1 tells the error of one input's response to one output",
            f"{coherence.shape} for a response {H.shape}",
            "state std or a covariance",
        )
    if not 1.0 < averages < np.inf:
        raise WrongUseError("a coherence tells nothing without averages above 1", f"{averages!r}", "give their number")
    variance = variance_by_coherence(H[keep], coherence[keep, None, None], averages)
    freedom = 2.0 * (averages - 1.0)
    return {"covariance": independent(variance), "coherence": coherence[keep], "averages": float(averages),
            "variance_freedom": freedom}  # fmt: skip
