"""One FRF on other terms: with a hold and a delay multiplied in, or on other lines."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from loopshape.core.errors import WrongUseError
from loopshape.data.algebra.propagation import MEASURED
from loopshape.data.control.controller import hold_and_delay
from loopshape.data.response.frf import FRF, Hold

_LINEWISE = ("response", "covariance", "noise_covariance", *MEASURED)


def with_hold(frf: FRF, rate_hz: float, delay_s: float = 0.0, *, continuous: bool = False) -> FRF:
    """A plant measured as continuous, as a controller at `rate_hz` meets it: times hold and computation delay, once.

    The hold is sinc(f/rate) exp(-j pi f/rate). What the sampler folds down from above half the rate is neglected:
    about |P(rate - f)/P(f)| f/(rate - f). Refuses an FRF that was sampled before, lines at or above half the rate,
    and an FRF recorded at that very rate, which from logged z contains the hold, unless stated to be `continuous`.
    """
    if frf.hold is Hold.INCLUDED:
        raise WrongUseError("this FRF holds the hold and the delay already", frf.method, "multiply them in once")
    if frf.rate_hz == rate_hz and not continuous:
        raise WrongUseError(
            "an FRF recorded at the controller's own rate contains the hold, if it goes from the logged z",
            f"{rate_hz:g} Hz", "leave it as it is, or say continuous=True if its input was measured behind the hold",
        )  # fmt: skip
    f = frf.frequency_hz
    if not (np.isfinite(rate_hz) and 0.0 <= delay_s < np.inf and f[-1] < 0.5 * rate_hz):
        raise WrongUseError(
            "a hold needs frequencies below half its rate, and a delay that is not negative",
            f"lines up to {f[-1]:g} Hz, {rate_hz:g} Hz, {delay_s:g} s", "take frf.between(...) first",
        )  # fmt: skip
    factor = hold_and_delay(f, rate_hz, delay_s)
    power, words = np.abs(factor[:, None, None]) ** 2, f"zero-order hold at {rate_hz:g} Hz and {delay_s:g} s of delay"
    noise = None if frf.noise_covariance is None else power * frf.noise_covariance
    return replace(
        frf, response=factor[:, None, None] * frf.response, covariance=power * frf.covariance, noise_covariance=noise,
        input_power=None, output_power=None, cross_power=None, rate_hz=float(rate_hz), recorded_under=None,
        hold=Hold.INCLUDED, method=f"{frf.method}, times {words}",
        notes=(*frf.notes, f"{words} multiplied into a continuous FRF"),
    )  # fmt: skip


def regrid(frf: FRF, frequency_hz: ArrayLike) -> FRF:
    """The FRF on other lines, its complex response interpolated linearly between the two neighbours.

    Magnitude and unwrapped phase would be wrong near zeros. The covariance is interpolated too: with weights w and
    1 - w that is never less than the error implies, however neighbours are correlated (d d^H is convex in d). What a
    straight line misses of a curved response is no part of it: the note says how much that is, judged by leaving
    lines out. A new line is valid where both neighbours are. Refuses lines outside the old ones.
    """
    new, old = np.asarray(frequency_hz, dtype=float), frf.frequency_hz
    if new.ndim != 1 or not new.size or not (old[0] <= new.min() and new.max() <= old[-1]):
        raise WrongUseError(
            "an FRF is interpolated between its frequencies, never extrapolated",
            f"{new.min():g} to {new.max():g} Hz" if new.size else "no line",
            f"stay within {old[0]:g} to {old[-1]:g} Hz",
        )
    right = np.clip(np.searchsorted(old, new), 1, max(old.size - 1, 1)) % old.size
    left = np.maximum(right - 1, 0)
    weight = (new - old[left]) / np.where(right > left, old[right] - old[left], 1.0)

    def between(values: np.ndarray) -> np.ndarray:
        w = weight.reshape(-1, *[1] * (values.ndim - 1))
        return np.asarray((1.0 - w) * values[left] + w * values[right])

    changes: dict[str, Any] = {
        name: between(getattr(frf, name)) for name in _LINEWISE if getattr(frf, name) is not None
    }
    valid = (frf.valid[left] | (weight == 1.0)) & (frf.valid[right] | (weight == 0.0))
    within = int(np.sum((old >= new[0]) & (old <= new[-1])))
    note = f"interpolated from {old.size} onto {new.size} lines; a straight line misses {_missed(frf):.2g} % at most"
    return replace(
        frf, frequency_hz=new, valid=valid, notes=(*frf.notes, note), method=f"{frf.method}, interpolated linearly",
        line_overlap=frf.line_overlap * max(1.0, new.size / max(within, 1)), **changes,
    )  # fmt: skip


def _missed(frf: FRF) -> float:
    """Worst error of linear interpolation in percent of a line's largest singular value, by the lines left out.

    Leaving a line out doubles the step, and the error of a straight line goes with its square: a quarter of it.
    """
    f, G = frf.frequency_hz, frf.response
    if f.size < 3:
        return float("nan")
    w = ((f[1:-1] - f[:-2]) / (f[2:] - f[:-2]))[:, None, None]
    miss = np.linalg.norm(G[1:-1] - (1.0 - w) * G[:-2] - w * G[2:], 2, axis=(1, 2))
    size = np.maximum(np.linalg.norm(G[1:-1], 2, axis=(1, 2)), 1e-300)
    return float(25.0 * np.max(miss / size))
