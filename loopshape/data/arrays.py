"""The gate that every number and array from a script passes: real or complex as it should be, finite, not masked.

numpy turns almost anything into numbers: dates into nanoseconds, truth values into 0 and 1, masked values into what
lies under the mask, complex values into their real part. Here each of these is refused in a sentence.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from loopshape.core.errors import BadSignalError, WrongUseError
from loopshape.core.units import Array, ComplexArray

#: magnitude up to which powers of a value stay finite numbers
LARGEST = 1e50
#: rates in Hz: from one sample in a fortnight to what no converter does
RATES_HZ = (1e-6, 1e12)
_KINDS = {
    "b": ("truth values", "give numbers"),
    "M": ("dates", "give seconds as numbers, or leave the stamps out and give rate_hz"),
    "m": ("durations", "give seconds as numbers"),
    "O": ("objects", "give an array of numbers, without missing values"),
}
_NO_NUMBERS = ("texts", "convert them to numbers first")


def _plain(values: ArrayLike | None, what: str) -> np.ndarray:
    """The array as it is, of whole numbers, real or complex; refuses masked values and what is no number."""
    if isinstance(values, np.ma.MaskedArray) and np.ma.getmaskarray(values).any():
        masked = int(np.ma.getmaskarray(values).sum())
        raise BadSignalError(f"{what} holds masked values", f"{masked} of {values.size}", "cut them out or fill them")
    try:
        array = np.asarray(values)
    except (ValueError, TypeError, OverflowError) as error:
        raise WrongUseError(f"{what} is no array of numbers", type(values).__name__, "give one") from error
    if array.dtype.kind not in "iufc" or array.dtype.names:
        got, way_out = _KINDS.get(array.dtype.kind, _NO_NUMBERS)
        raise WrongUseError(f"{what} must hold numbers", "nothing" if values is None else got, way_out)
    return array


def _checked(array: np.ndarray, what: str, most: float) -> None:
    bad = np.flatnonzero(~np.isfinite(array.ravel()))
    if bad.size:
        raise BadSignalError(
            f"{what} holds {bad.size} values that are not numbers", f"the first at index {bad[0]}",
            "repair the data or leave them out",
        )  # fmt: skip
    if array.size and (largest := float(np.abs(array).max())) > most:
        raise BadSignalError(f"{what} holds a value above {most:g}", f"{largest:.3g}", "check its unit")


def real_array(values: ArrayLike | None, what: str, *, ndim: int | None = None, finite: bool = True) -> Array:
    """A copy as float64, of `ndim` dimensions where given.

    Refuses complex values, truth values, dates, texts, masked values, and, where `finite`, NaN and values above 1e50.
    """
    array = _plain(values, what)
    if array.dtype.kind == "c":
        raise WrongUseError(f"{what} must be real", "complex values", "give the part that is meant: .real, or abs(...)")
    if ndim is not None and array.ndim != ndim:
        raise WrongUseError(f"{what} has {ndim} dimension{'s' * (ndim != 1)}", f"shape {array.shape}", "give it so")
    with np.errstate(over="ignore"):
        made = np.array(array, dtype=np.float64)
    if finite:
        _checked(made, what, LARGEST)
    return made


def complex_array(values: ArrayLike | None, what: str) -> ComplexArray:
    """A copy as complex128 of what is complex or said to be: real values are refused, for a magnitude is none.

    Refuses what `real_array` refuses besides.
    """
    array = _plain(values, what)
    if array.dtype.kind != "c":
        raise WrongUseError(
            f"{what} must be complex", f"real values {array.shape}",
            "give magnitude_db and phase_deg where these are known, or write H + 0j where its phase is 0 or 180",
        )  # fmt: skip
    return _as_complex(array, what, LARGEST)


def real_or_complex_array(values: ArrayLike | None, what: str, *, finite: bool = True) -> ComplexArray:
    """As complex128 what may be real too, covariances and cross-powers: of any size, and `finite` or not."""
    return _as_complex(_plain(values, what), what, math.inf if finite else math.nan)


def _as_complex(array: np.ndarray, what: str, most: float) -> ComplexArray:
    with np.errstate(over="ignore"):
        made = np.array(array, dtype=np.complex128)
    if not math.isnan(most):
        _checked(made, what, most)
    return made


def number(value: object, what: str, *, positive: bool = False, unit: str = "") -> float:
    """A finite number; refuses truth values, texts, arrays, NaN, and with `positive` zero and below."""
    plain = isinstance(value, int | float | np.integer | np.floating) and not isinstance(value, bool)
    try:
        made = float(value) if plain else math.nan  # type: ignore[arg-type]
    except OverflowError:
        made = math.inf
    if not math.isfinite(made) or (positive and made <= 0.0):
        received = repr(value) if len(repr(value)) < 60 else type(value).__name__
        kind = "a positive finite number" if positive else "a finite number"
        raise WrongUseError(f"{what} must be {kind}", received, f"give it in {unit}" if unit else "give one")
    return made


def rate(value: object, what: str, *, unknown: bool = False) -> float:
    """A rate in Hz between 1e-6 and 1e12; 0 too where it may be `unknown`."""
    made = number(value, what, positive=not unknown, unit="Hz")
    if not (RATES_HZ[0] <= made <= RATES_HZ[1] or (unknown and made == 0.0)):
        raise WrongUseError(
            f"{what} must lie between {RATES_HZ[0]:g} and {RATES_HZ[1]:g} Hz", f"{made:g} Hz", "give it in Hz"
        )
    return made
