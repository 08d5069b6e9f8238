"""Measured plant, controller, feedforward and a setpoint -> the error while it moves, with intervals.

e = S (1 - P F) r, where F adds to the plant's input. The setpoint moves from rest to rest and is taken back the same
way, so that it repeats and has a spectrum; the rest at both ends lets the error die out. The plant is the FRF smoothed
over its lines, as `check` reads it, and the FRF's error is carried by draws of what noise does to that.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from loopshape.core.errors import WrongUseError
from loopshape.core.units import Array, ComplexArray
from loopshape.data.arrays import real_array
from loopshape.data.control.controller import Controller
from loopshape.data.response.frf import FRF
from loopshape.identify.smooth.smoothing import smoothed
from loopshape.loop.stability.continued import continued, integrators_of
from loopshape.toolbox.learning.taps import Feedforward

Interval = tuple[float, float]


@dataclass(frozen=True, eq=False)
class TrackingError:
    """Error (n,) of a loop along a setpoint, in its unit, with 95 % intervals from the FRF's error.

    `low` and `high` (n,) hold each sample by itself; `rms` and `largest` (absolute value) are medians over what the
    plant may be. A feedforward that is made from the same FRF follows some of its noise, and the draws count that noise
    twice: then both numbers are on the safe side and only the upper ends of their intervals are told (the lower are 0).
    Noise and disturbances of the machine are not in it.
    """

    time_s: Array
    error: Array
    low: Array
    high: Array
    rms: float
    rms_interval: Interval
    largest: float
    largest_interval: Interval

    def __repr__(self) -> str:
        """One line: rms and largest error with their intervals."""
        (a, b), (c, d) = self.rms_interval, self.largest_interval
        return (
            f"TrackingError: rms {self.rms:.4g} ({a:.4g} to {b:.4g}), largest {self.largest:.4g} ({c:.4g} to {d:.4g})"
        )


def tracking_error_of(
    P: FRF,
    C: Controller,
    setpoint: ArrayLike,
    feedforward: Feedforward | None = None,
    *,
    integrators: int | None = None,
) -> TrackingError:
    """The error of a stable loop along a setpoint (n,) at the controller's rate, from rest to rest.

    The error must have died out at the setpoint's end. Raises WrongUseError for a feedforward at
    another rate.
    """
    if feedforward is not None and feedforward.rate_hz != C.rate_hz:
        raise WrongUseError(
            "feedforward and controller run at one rate", f"{feedforward.rate_hz:g} and {C.rate_hz:g} Hz",
            "make the feedforward from an FRF at the controller's rate",
        )  # fmt: skip
    r = real_array(setpoint, "the setpoint", ndim=1)
    if r.size < 16:
        raise WrongUseError("a setpoint has 16 samples at least", f"{r.size}")
    lines, scatter = smoothed(P)
    f = np.asarray(np.fft.rfftfreq(2 * r.size, 1.0 / C.rate_hz)[1:-1], dtype=float)
    spectrum = np.fft.rfft(np.concatenate([r, r[-1] + r[0] - r]))[1:-1]
    there = continued(lines, f, integrators_of(lines) if integrators is None else integrators, smooth=True)
    F = np.zeros(f.size) if feedforward is None else feedforward.response(f)
    gain = C.response(f)

    def error(plant: ComplexArray) -> Array:
        whole = np.zeros(f.size + 2, dtype=complex)
        whole[1:-1] = (1.0 - plant * F) / (1.0 + gain * plant) * spectrum
        return np.asarray(np.fft.irfft(whole, 2 * r.size)[: r.size], dtype=float)

    off = there.spread(scatter.deviations / scatter.reference)
    drawn = np.array([error(there.response * (1.0 + one)) for one in off])
    own = error(there.response)
    low, high = np.quantile(drawn, (0.025, 0.975), axis=0)
    rms, most = np.sqrt(np.mean(drawn**2, axis=1)), np.abs(drawn).max(axis=1)
    both = feedforward is None
    return TrackingError(
        np.arange(r.size) / C.rate_hz, own, low, high,
        float(np.median(rms)), _ends(rms, both), float(np.median(most)), _ends(most, both),
    )  # fmt: skip


def _ends(values: Array, both: bool) -> Interval:
    low, high = np.quantile(values, (0.025, 0.975))
    return float(low) if both else 0.0, float(high)
