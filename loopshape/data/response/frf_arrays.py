"""FRFs from arrays: a response whose error is stated, as a covariance, a standard deviation, or a coherence.

With a coherence g2 of a single input and K averages E|d|² = |H|² (1 - g2)/(g2 (K - 1)): Bendat and Piersol (Random
Data, 4th ed., table 9.6), less the one degree of freedom that H itself took.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from loopshape.core.errors import WrongUseError
from loopshape.core.units import TWO_PI, Array, ComplexArray, from_db, rad
from loopshape.data.arrays import complex_array, number, real_array, real_or_complex_array

NEEDED = ("frequency_hz", "response", "covariance", "valid")
_COMPLEX = ("covariance", "cross_power", "noise_covariance")


def passed(name: str, value: ArrayLike | None) -> np.ndarray:
    """A copy of an FRF's field `name`, in the type that it has there."""
    what = f"{name} of an FRF"
    if name == "valid":
        try:
            mask = np.array(value)
        except ValueError as error:
            raise WrongUseError(f"{what} is a mask of true and false", f"{error}", "give truth values (nf,)") from error
        if mask.dtype != bool:
            raise WrongUseError("valid is a mask of true and false", f"{mask.dtype}", "give truth values (nf,)")
        return mask
    if name == "response":
        return complex_array(value, what)
    gate = real_or_complex_array if name in _COMPLEX else real_array
    return gate(value, what, finite=name in NEEDED)


def independent(variance: Array) -> ComplexArray:
    """Covariance (nf, n, n) of independent elements from their variances (nf, ny, nu)."""
    flat = variance.transpose(0, 2, 1).reshape(len(variance), -1)
    return (flat[:, :, None] * np.eye(flat.shape[1])).astype(complex)


def variance_by_coherence(response: ComplexArray, coherence: Array, averages: float) -> Array:
    """Variance (nf, ny, nu) of a single input's response from its coherence and the number of averages."""
    least_coherence = 1e-12  # below it a variance would not be finite
    g2 = np.clip(coherence, least_coherence, 1.0)
    return np.asarray(np.abs(response) ** 2 * (1.0 - g2) / (g2 * (averages - 1.0)))


def valid_frequencies(frequency_hz: Array, response: ComplexArray, covariance: ComplexArray) -> np.ndarray:
    """Mask (nf,) of the valid band, by the largest error beside the largest singular value, whatever the units."""
    rows, columns = channel_scales(response)
    even = rows[:, None] * columns
    std = np.sqrt(np.maximum(np.real(np.einsum("fii->fi", covariance)), 0.0)) * even.T.ravel()
    size = np.maximum(np.linalg.norm(response * even, 2, axis=(1, 2)), 1e-300)
    return valid_lines(frequency_hz, std.max(axis=1) / size, np.ones(size.size, dtype=bool))


def channel_scales(response: ComplexArray, rounds: int = 30) -> tuple[Array, Array]:
    """Factors of outputs (ny,) and inputs (nu,) that bring a response's elements to one size, in the mean of their ln.

    In units of the channels k times smaller they are k times smaller, so the scaled response does not depend on units.
    Ones for a single channel.
    """
    size = np.abs(response)
    if size.shape[1:] == (1, 1):
        return np.ones(1), np.ones(1)
    count = (size > 0.0).sum(axis=0)
    level = np.log(np.where(size > 0.0, size, 1.0)).sum(axis=0) / np.maximum(count, 1)
    known = (count > 0).astype(float)
    rows, columns = np.zeros(level.shape[0]), np.zeros(level.shape[1])
    for _ in range(rounds):  # least squares, side by side: elements that are 0 tell nothing
        rows = (known * (level - columns)).sum(axis=1) / np.maximum(known.sum(axis=1), 1.0)
        columns = (known * (level - rows[:, None])).sum(axis=0) / np.maximum(known.sum(axis=0), 1.0)
    return np.exp(-rows), np.exp(-columns)


def polar(magnitude_db: ArrayLike, phase_deg: ArrayLike) -> ComplexArray:
    """Response from its magnitude in dB and its phase in degrees, wrapped or not, of one shape."""
    magnitude, phase = from_db(real_array(magnitude_db, "magnitude_db")), rad(real_array(phase_deg, "phase_deg"))
    if magnitude.shape != phase.shape:
        raise WrongUseError("magnitude and phase have one shape", f"{magnitude.shape} and {phase.shape}")
    return np.asarray(magnitude * np.exp(1j * phase))


def lines_of(
    frequency_hz: ArrayLike | None,
    omega_rad_s: ArrayLike | None,
    response: ArrayLike | None,
    magnitude_db: ArrayLike | None,
    phase_deg: ArrayLike | None,
) -> tuple[Array, ComplexArray]:
    """Frequencies in Hz and response, of whichever way they were given; refuses none, both, and half of one.

    A real response is refused: it may as well be a magnitude.
    """
    if (frequency_hz is None) == (omega_rad_s is None):
        raise WrongUseError(
            "the frequencies of a response are given once", "both" if frequency_hz is not None else "none",
            "give frequency_hz or omega_rad_s",
        )  # fmt: skip
    parts = (magnitude_db is not None) + (phase_deg is not None)
    if parts == 1 or (response is None) == (parts == 0):
        raise WrongUseError(
            "a response is given once", f"response {'yes' if response is not None else 'no'}, {parts} of magnitude and"
            " phase", "give response, or magnitude_db and phase_deg",
        )  # fmt: skip
    if omega_rad_s is None:
        f = real_array(frequency_hz, "frequency_hz of an FRF")
    else:
        f = real_array(omega_rad_s, "omega_rad_s of an FRF") / TWO_PI
    if magnitude_db is not None and phase_deg is not None:
        return f, polar(magnitude_db, phase_deg)
    return f, complex_array(response, "response of an FRF")


def check_relative_std(share: float) -> None:
    """Refuse a relative standard deviation that is negative, or so large that it must be percent."""
    if number(share, "relative_std of an FRF") < 0.0:
        raise WrongUseError("a relative standard deviation must not be negative", f"{share:g}", "write 0.05 for 5 %")
    if share >= 2.0:
        raise WrongUseError(
            "a relative standard deviation is a share of |response|", f"{share:g}, which is {100.0 * share:g} %",
            f"write {share / 100.0:g} for {share:g} %",
        )  # fmt: skip


def stated_arrays(
    f: Array,
    H: ComplexArray,
    *,
    std: ArrayLike | None,
    relative_std: float | None,
    covariance: ArrayLike | None,
    coherence: ArrayLike | None,
    averages: float | None,
) -> dict[str, Any]:
    """Keywords of `FRF` for what the arrays say: frequencies, response (nf, ny, nu), covariance, valid band.

    A first frequency of 0 Hz is left out. Refuses arrays that do not fit together, and an error that is stated twice
    or not at all.
    """
    given, H = H.shape, H[:, None, None] if H.ndim == 1 else H
    if f.ndim != 1 or H.ndim != 3 or H.shape[0] != f.size or not H.size:
        raise WrongUseError(
            "a response has a value, or a matrix of outputs and inputs, for each frequency",
            f"{f.shape} frequencies and a response {given}",
            "give frequency_hz (nf,) and response (nf,) or (nf, ny, nu)",
        )
    keep = slice(1, None) if f.size and f[0] == 0.0 else slice(None)
    stated = [x is not None for x in (std, relative_std, covariance, coherence)]
    if (coherence is None) != (averages is None):
        raise WrongUseError(
            "a coherence and the number of averages behind it tell the error together", "one of them",
            "give coherence and averages",
        )  # fmt: skip
    if sum(stated) != 1:
        raise WrongUseError(
            "the error of this FRF is not given" if not any(stated) else "the error of a response is stated once",
            f"{sum(stated)} statements",
            "give std, relative_std (0: exact, as a model's response), covariance, or coherence with averages",
        )
    if relative_std is not None:
        check_relative_std(relative_std)
    found: dict[str, Any] = {"frequency_hz": f[keep], "response": H[keep]}
    if covariance is not None:
        found["covariance"] = _covariance(H, covariance)[keep]
    elif coherence is not None and averages is not None:
        found |= _by_coherence(H, real_array(coherence, "coherence of an FRF"), number(averages, "averages"), keep)
    else:
        error = relative_std * np.abs(H) if relative_std is not None else _like(H, real_array(std, "std of an FRF"))
        found["covariance"] = independent(np.asarray(error)[keep] ** 2)
    found["valid"] = valid_frequencies(found["frequency_hz"], found["response"], found["covariance"])
    return found


def _covariance(H: ComplexArray, covariance: ArrayLike) -> ComplexArray:
    """Covariances (nf, ny nu, ny nu), which may be real; refuses those of another shape."""
    made = real_or_complex_array(covariance, "covariance of an FRF")
    size = H.shape[1] * H.shape[2]
    if made.shape != (len(H), size, size):
        raise WrongUseError(
            "a covariance is (frequencies, outputs inputs, outputs inputs)", f"{made.shape}",
            f"give ({len(H)}, {size}, {size}), or std in the response's shape",
        )  # fmt: skip
    return made


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
            "a coherence (nf,) between 0 and 1 gives the error of one input's response to one output",
            f"{coherence.shape} for a response {H.shape}",
            "state std or a covariance",
        )
    if not 1.0 < averages < np.inf:
        raise WrongUseError("a coherence gives no error without averages above 1", f"{averages!r}", "give their number")
    variance = variance_by_coherence(H[keep], coherence[keep, None, None], averages)
    freedom = 2.0 * (averages - 1.0)
    return {"covariance": independent(variance), "coherence": coherence[keep], "averages": float(averages),
            "variance_freedom": freedom}  # fmt: skip


#: a line is known where its relative standard deviation is below the first; a gap up to the second is bridged
KNOWN, _BRIDGED = 0.1, 0.3
#: lines of a band of its own beyond one that noise covers
LEAST_KNOWN = 5


def valid_lines(frequency_hz: Array, relative_std: Array, excited: np.ndarray) -> np.ndarray:
    """Lines of the widest band (in octaves) that is known to 10 %, as a mask (nf,).

    A moving median over five lines decides. Within the band no excited line is left out: a resonance between
    known lines is often the least known, and a check must not overlook it; stretches known to 30 % only are
    bridged for its sake. Noise that covers an antiresonance does not end the band: it reaches as far as others that are
    known.
    """
    relative = np.where(np.isfinite(relative_std), relative_std, np.inf)
    padded = np.pad(relative, 2, mode="edge")
    median = np.median(np.lib.stride_tricks.sliding_window_view(padded, 5), axis=1)
    mask = np.zeros(relative.size, dtype=bool)
    best = 0.0
    for start, end in _stretches((median <= _BRIDGED) & excited):
        known = start + np.flatnonzero(median[start:end] <= KNOWN)
        if known.size and (width := np.log2(frequency_hz[known[-1]] / frequency_hz[known[0]]) + 1e-9) > best:
            best = float(width)
            mask[:] = False
            mask[known[0] : known[-1] + 1] = True
    usable = excited & np.isfinite(relative_std)
    for start, end in _stretches(usable):
        if best and mask[start:end].any():
            mask[start:end] = _with_known(mask[start:end], median[start:end] <= KNOWN)
    return np.asarray(mask & usable)


def _with_known(band: np.ndarray, known: np.ndarray) -> np.ndarray:
    """A band out to others of five lines and more that are known, and what lies between."""
    every = band.copy()
    for start, end in _stretches(known):
        every[start:end] |= end - start >= LEAST_KNOWN
    used = np.flatnonzero(every)
    every[used[0] : used[-1] + 1] = True
    return every


def _stretches(mask: np.ndarray) -> list[tuple[int, int]]:
    """Starts and ends (exclusive) of the runs of True."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], mask.astype(int), [0]])))
    return list(zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True))
