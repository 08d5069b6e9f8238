"""Measured plant and controller -> iterative learning, with its convergence condition per frequency."""

from __future__ import annotations

import numpy as np
from scipy.signal import firwin

from loopshape.core.errors import WrongUseError
from loopshape.core.units import Array
from loopshape.data.control.controller import Controller
from loopshape.data.response.frf import FRF
from loopshape.design.tune import Tuning
from loopshape.identify.smooth.smoothing import smoothed
from loopshape.toolbox.learning.feedforward import feedforward
from loopshape.toolbox.learning.noun import Learning, zero_phase


def learning(
    P: FRF,
    C: Controller | Tuning,
    *,
    band_hz: tuple[float, float],
    taps: int | None = None,
    preview: int | None = None,
    integrators: int | None = None,
) -> Learning:
    """What each trial of a repeated move learns from the last one's error, over a band, with `C` in the loop.

    u_next = Q (u + F e + z): F is the plant's feedforward (`taps`, `preview` and `integrators` are its) and z what the
    controller gave out, so that F + C inverts the closed loop P S. A low-pass without
    phase lets the band through: above it nothing is learned, also where the FRF ends. The condition is judged over
    the whole valid band. It is that of a linear loop without noise, which learning repeats.
    Raises WrongUseError as `ls.learning.feedforward` does.

    Examples
    --------
    >>> import numpy as np, loopshape as ls
    >>> f_hz = np.geomspace(0.1, 200.0, 150)
    >>> P = ls.FRF.from_arrays(f_hz, 20.0 / (2j * np.pi * f_hz), relative_std=0.02, rate_hz=1000.0)
    >>> L = ls.learning(P, ls.controller(ls.gain(0.5), rate_hz=1000.0), band_hz=(0.1, 20.0))
    >>> str(L.converges)
    'passed'
    """
    own = C.controller if isinstance(C, Tuning) else C
    F = feedforward(P, band_hz=band_hz, taps=taps, preview=preview, integrators=integrators)
    if F.rate_hz != own.rate_hz:
        raise WrongUseError("a plant is learned at its controller's rate", f"{F.rate_hz:g} and {own.rate_hz:g} Hz")
    span = 5.0  # periods of the band's end that the smoothing filter spans
    half = max(2, round(0.5 * span * F.rate_hz / band_hz[1]))
    smoothing = np.asarray(firwin(2 * half + 1, band_hz[1], window="blackmanharris", fs=F.rate_hz))
    lines, scatter = smoothed(P)
    f, gain = lines.frequency_hz, own.response(lines.frequency_hz)
    Q, S = np.abs(zero_phase(smoothing, f, F.rate_hz)), 1.0 / (1.0 + gain * lines.siso)
    std: Array = np.sqrt(np.mean(np.abs(scatter.deviations) ** 2, axis=0))
    half_width = Q * std * np.abs(S**2 * (F.response(f) + gain)) * np.sqrt(-np.log(0.05))
    factor = Q * np.abs(S * (1.0 - lines.siso * F.response(f)))
    return Learning(F, smoothing, f, factor, np.maximum(factor - half_width, 0.0), factor + half_width)
