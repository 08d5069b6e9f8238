"""One FRF on other terms: with a hold and a delay multiplied in, on other lines, or behind a faster filter."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from loopshape.core.errors import WrongUseError
from loopshape.core.units import TWO_PI
from loopshape.data.algebra.propagation import MEASURED
from loopshape.data.arrays import rate
from loopshape.data.control.controller import Controller, hold_and_delay
from loopshape.data.response.frf import FRF, Hold

_LINEWISE = ("response", "covariance", "noise_covariance", *MEASURED)


def held(frf: FRF, rate_hz: float, delay_s: float = 0.0, *, continuous: bool = False) -> FRF:
    """A plant measured as continuous, as a controller at `rate_hz` meets it: times hold and computation delay, once.

    The hold is sinc(f/rate) exp(-j pi f/rate). What the sampler folds down from above half the rate is neglected:
    about |P(rate - f)/P(f)| f/(rate - f). Refuses a FRF that went through here before, lines at or above half the rate,
    and a FRF recorded at that very rate, which from logged z contains the hold, unless stated to be `continuous`.
    """
    if frf.hold is Hold.INCLUDED:
        raise WrongUseError("this FRF holds the hold and the delay already", frf.method, "multiply them in once")
    if frf.rate_hz == rate_hz and not continuous:
        raise WrongUseError(
            "a FRF recorded at the controller's own rate contains the hold, if it goes from the logged z",
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
        input_power=None, output_power=None, cross_power=None, rate_hz=float(rate_hz), held_by=None,
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
            "a FRF is interpolated between its frequencies, never extrapolated",
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
    trusted = (frf.trusted[left] | (weight == 1.0)) & (frf.trusted[right] | (weight == 0.0))
    within = int(np.sum((old >= new[0]) & (old <= new[-1])))
    note = f"interpolated from {old.size} onto {new.size} lines; a straight line misses {_missed(frf):.2g} % at most"
    return replace(
        frf, frequency_hz=new, trusted=trusted, notes=(*frf.notes, note), method=f"{frf.method}, interpolated linearly",
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


def multirate(P: FRF, fast: Controller, rate_hz: float) -> FRF:
    """The plant that a controller at `rate_hz` meets through a filter at a multiple of it, exactly as sampled.

    `P` (1 x 1) goes from what the filter gives out, held at the filter's rate, to the output sampled at that rate, up
    to half of it. Each value of the slow controller is repeated N times, filtered, and the output is sampled at the
    slow rate: (1/N) sum over k of P F B at f + k rate, B = sum of exp(-j 2 pi f n/(N rate)) over n < N. Frequencies
    between P's lines are interpolated; errors at different frequencies are taken as independent. Raises WrongUseError
    for rates that are no multiple and a plant that does not reach the images of any of its lines.

    >>> import numpy as np, loopshape as ls
    >>> f_hz = np.arange(1.0, 1000.0)
    >>> P = ls.FRF.from_arrays(f_hz, 1.0 / (1.0 + 1j * f_hz / 10.0), relative_std=0.01, rate_hz=2000.0)
    >>> ls.multirate(P, ls.controller(ls.notch(700.0, 0.1, 0.7), rate_hz=2000.0), 1000.0)
    FRF: 499 frequencies, 1 to 499 Hz, 1 output x 1 input, rate 1000 Hz
    """
    rate_hz = rate(rate_hz, "rate_hz of the slow controller")
    many = round(fast.rate_hz / rate_hz)
    if many < 2 or abs(many * rate_hz - fast.rate_hz) > 1e-9 * fast.rate_hz or P.rate_hz != fast.rate_hz:
        raise WrongUseError(
            "a fast filter runs at a whole multiple of the controller's rate, and its plant at its own",
            f"filter {fast.rate_hz:g} Hz, plant {P.rate_hz:g} Hz, controller {rate_hz:g} Hz",
        )
    f = P.frequency_hz[P.frequency_hz < 0.5 * rate_hz]
    k = np.arange(many) - (many - 1) // 2
    images = np.where(
        f[:, None] + rate_hz * k > 0.5 * fast.rate_hz, f[:, None] + rate_hz * (k - many), f[:, None] + rate_hz * k
    )
    reached = ((np.abs(images) >= P.frequency_hz[0]) & (np.abs(images) <= P.frequency_hz[-1])).all(axis=1)
    if not reached.any():
        raise WrongUseError(
            "a plant behind a fast filter is measured up to half the filter's rate",
            f"lines to {P.frequency_hz[-1]:g} Hz at {fast.rate_hz:g} Hz", "excite it there, at the filter's rate",
        )  # fmt: skip
    f, images = f[reached], images[reached]
    at, place = np.unique(np.round(np.abs(images), 9), return_inverse=True)
    lines = regrid(P, np.clip(at, P.frequency_hz[0], P.frequency_hz[-1]))
    place = place.reshape(images.shape)
    G = (lines.siso * fast.response(lines.frequency_hz))[place]
    steps = np.exp(-1j * TWO_PI * images[:, :, None] * np.arange(many) / fast.rate_hz).sum(axis=2) / many
    weight = fast.response(lines.frequency_hz)[place] * steps
    variance = (np.abs(weight) ** 2 * lines.variance[:, 0, 0][place]).sum(axis=1)
    own = P.select(np.isin(P.frequency_hz, f))
    return replace(
        own, response=(np.where(images < 0.0, G.conj(), G) * steps).sum(axis=1)[:, None, None],
        covariance=variance[:, None, None] + 0j, noise_covariance=None, coherence=None, input_power=None,
        output_power=None, cross_power=None, multiple_coherence=None, partial_coherence=None, rate_hz=float(rate_hz),
        trusted=np.asarray(lines.trusted[place].all(axis=1)), held_by=None,
        notes=(*own.notes, f"a filter at {fast.rate_hz:g} Hz folded into the plant"),
    )  # fmt: skip
