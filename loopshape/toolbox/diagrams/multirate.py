"""A filter that runs faster than the loop, folded into the plant behind it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from loopshape.core.errors import WrongUseError
from loopshape.core.units import TWO_PI
from loopshape.data.algebra.sampling import regrid
from loopshape.data.arrays import rate
from loopshape.data.control.controller import Controller
from loopshape.data.response.frf import FRF


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
    >>> ls.diagrams.multirate(P, ls.controller(ls.notch(700.0, 0.1, 0.7), rate_hz=2000.0), 1000.0)
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
        valid=np.asarray(lines.valid[place].all(axis=1)), recorded_under=None,
        notes=(*own.notes, f"a filter at {fast.rate_hz:g} Hz folded into the plant"),
    )  # fmt: skip
