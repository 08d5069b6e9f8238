"""How high a controller reaches: the bandwidth of C itself, to be compared with the actuator or its PWM."""

from __future__ import annotations

import numpy as np

from loopshape.core.units import Array
from loopshape.data.control.controller import Controller, series_response

#: ln of -3 dB
HALF_POWER = -0.5 * float(np.log(2.0))


def controller_grid_hz(rate_hz: float) -> Array:
    """The lines (360,) that C is looked at on: logarithmic, from a millionth of the rate to just below half of it."""
    return np.geomspace(1e-6 * rate_hz, 0.4999 * rate_hz, 360)


def controller_bandwidth_hz(controller: Controller) -> float:
    """Highest frequency in Hz at which |C| is within 3 dB of its largest; half the rate where C does not roll off.

    An integrator's |C| is infinite at zero frequency and says nothing of how high C reaches, so blocks count without
    the integral term of their partial fractions (`pi` as the 1 that it comes to above its corner). Between lines
    ln |C| is linear in ln f. A resonance of C between two lines (4 % apart) is not seen whole.
    """
    f = controller_grid_hz(controller.rate_hz)
    size = np.log(np.abs(series_response(controller.blocks, controller.s_at(f), bounded=True)))
    room = size - (size.max() + HALF_POWER)
    k = int(np.flatnonzero(room >= 0.0)[-1])
    if k == f.size - 1:
        return 0.5 * controller.rate_hz
    return float(f[k] * (f[k + 1] / f[k]) ** (room[k] / (room[k] - room[k + 1])))
