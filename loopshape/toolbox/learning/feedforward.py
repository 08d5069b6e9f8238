"""Measured plant -> feedforward: the inverse over a band, as taps on a setpoint that is known some samples ahead.

The plant is the FRF smoothed over its lines, as `check` reads it. Its response to z holds hold, computation and delay,
so taps that look ahead invert these too. The taps minimise the mean over ln f of |1 - P F|², with what the FRF's
variance adds to it, |P F|² var(P)/|P|²: where P is not known F stays small. F has a zero at z = 1 for each integrator
of the plant; below the lowest frequency P goes on along them.
"""

from __future__ import annotations

import numpy as np
from scipy.linalg import lstsq

from loopshape.core.errors import WrongUseError
from loopshape.core.units import TWO_PI, Array, ComplexArray
from loopshape.data.response.frf import FRF
from loopshape.identify.smooth.smoothing import smoothed
from loopshape.loop.stability.continued import continued, integrators_of
from loopshape.toolbox.learning.taps import Feedforward

#: how far below the lowest and above the highest frequency of the band the fit looks, as ratios
BELOW, GAP, OUTSIDE = 30.0, 1.2, 40
#: least taps by default, and the share of them that looks ahead
LEAST, AHEAD = 32, 0.6
#: weight of |P F| above the band, where P is taken as at its end, and of the taps themselves
QUIET, RIDGE = 0.05, 1e-7


def feedforward(
    P: FRF,
    *,
    band_hz: tuple[float, float] | None = None,
    taps: int | None = None,
    preview: int | None = None,
    integrators: int | None = None,
) -> Feedforward:
    """The inverse of a measured plant (1 x 1) over a band (default: the valid band), with `preview` samples ahead.

    `taps` span half a period of the band's end by default, 32 at least, and 60 % of them look ahead; `integrators` are
    those of the plant, by default what its lowest lines look like. Raises WrongUseError for a band with fewer than four
    frequencies, or taps that do not hold preview and zeros.

    Misleads: above the band the setpoint passes unhelped; many taps follow the FRF's noise and ask for large inputs
    (look at `signal`); a plant that answers larger moves otherwise is not inverted.

    Examples
    --------
    >>> import numpy as np, loopshape as ls
    >>> f_hz = np.geomspace(0.2, 200.0, 200)
    >>> s = 2j * np.pi * f_hz
    >>> P = ls.FRF.from_arrays(f_hz, 40.0 / s**2 * np.exp(-0.001 * s), relative_std=0.001, rate_hz=1000.0)
    >>> F = ls.learning.feedforward(P, band_hz=(0.2, 40.0), taps=200)
    >>> bool(F.inverse_error.max() < 0.05)
    True
    """
    lines, scatter = smoothed(P, band_hz)
    order = integrators_of(lines) if integrators is None else integrators
    if lines.frequency_hz.size < 4 or not lines.rate_hz > 0.0:
        raise WrongUseError(
            "a feedforward needs four frequencies in its band and the rate at which it runs",
            f"{lines.frequency_hz.size} of {P!r}", "name a wider band_hz, and give the FRF its rate_hz",
        )  # fmt: skip
    taps = max(LEAST, round(0.5 * lines.rate_hz / lines.frequency_hz[-1])) if taps is None else taps
    ahead = round(AHEAD * taps) if preview is None else preview
    if not 0 <= ahead < taps - order:
        raise WrongUseError(
            "the taps of a feedforward hold its preview and a zero for each integrator",
            f"{taps} taps, {ahead} ahead, {order} integrators", "ask for more taps or less preview",
        )  # fmt: skip
    std = np.sqrt(np.mean(np.abs(scatter.deviations) ** 2, axis=0))
    h = _solved(lines, std / np.abs(lines.siso), taps, ahead, order)
    f = lines.frequency_hz
    band = (float(f[0]), float(f[-1]))
    made = Feedforward(h, ahead, lines.rate_hz, band, f, np.zeros(f.size), np.zeros(f.size), lines.loop)
    PF = lines.siso * made.response(f)
    error = np.abs(1.0 - PF)
    high = error + std * np.abs(made.response(f)) * np.sqrt(-np.log(0.05))  # |d|² of a circular error is exponential
    return Feedforward(h, ahead, lines.rate_hz, band, f, error, high, lines.loop)


def _solved(lines: FRF, relative: Array, taps: int, preview: int, order: int) -> Array:
    """Taps of the least weighted |1 - P F|² for lines with these relative errors (nf,)."""
    f, rate = lines.frequency_hz, lines.rate_hz
    low = np.geomspace(f[0] / BELOW, f[0], OUTSIDE, endpoint=False)
    high = np.linspace(min(GAP * f[-1], 0.5 * rate), 0.5 * rate, OUTSIDE)
    P_low = continued(lines, low, order).response
    weights = np.sqrt(np.gradient(np.log(f)))
    inverse = lines.siso[:, None] * _basis(f, rate, taps, preview, order)
    rows = [
        weights[:, None] * inverse,
        (weights * relative)[:, None] * inverse,
        np.sqrt(np.log(BELOW) / OUTSIDE) * P_low[:, None] * _basis(low, rate, taps, preview, order),
        QUIET * np.abs(lines.siso[-1]) / np.sqrt(OUTSIDE) * _basis(high, rate, taps, preview, order),
    ]
    required = [weights, np.zeros(f.size), np.full(low.size, np.sqrt(np.log(BELOW) / OUTSIDE)), np.zeros(high.size)]
    A, b = np.vstack(rows), np.concatenate(required)
    A, b = np.vstack([A.real, A.imag]), np.concatenate([b, np.zeros(b.size)])
    size = np.linalg.norm(A, axis=0).max()
    A, b = np.vstack([A, RIDGE * size * np.eye(A.shape[1])]), np.concatenate([b, np.zeros(A.shape[1])])
    g = lstsq(A, b, lapack_driver="gelsy")[0]
    for _ in range(order):
        g = np.convolve(g, [1.0, -1.0])
    return np.asarray(g, dtype=float)


def _basis(f: Array, rate_hz: float, taps: int, preview: int, order: int) -> ComplexArray:
    """(nf, taps - order): what each free tap, behind its zeros at z = 1, makes of each frequency."""
    turn = np.exp(-1j * TWO_PI * f / rate_hz)
    k = np.arange(taps - order) - preview
    return np.asarray((1.0 - turn[:, None]) ** order * turn[:, None] ** k)
