"""Two degrees of freedom: the feedforward that a measured plant allows, and the error that it leaves on a setpoint."""

from __future__ import annotations

from numpy.typing import ArrayLike

from loopshape.core.units import Array
from loopshape.data.control.controller import Controller
from loopshape.data.response.frf import FRF
from loopshape.design.tune import Tuning
from loopshape.toolbox.learning.taps import Feedforward
from loopshape.toolbox.learning.tracking import TrackingError, tracking_error_of
from loopshape.toolbox.rig.excitation.setpoints import Profile


def tracking_error(
    P: FRF,
    C: Controller | Tuning,
    setpoint: ArrayLike,
    F: Feedforward | None = None,
    *,
    integrators: int | None = None,
    unstable_poles: int | None = None,
) -> TrackingError:
    """The error of a loop along a setpoint (n,) from rest to rest, with and without feedforward, with 95 % intervals.

    At the controller's rate; the setpoint is taken back the same way, and its rest at the end must be long enough for
    the error to die out. `integrators` are the plant's, below its lowest frequency; by default what its
    lowest lines look like; what is open below and above them is in the intervals.
    Where stability is not decided the loop is taken as stable: ask `ls.check`. Raises WrongUseError for another rate
    of `F`, an unstable loop, and an error that has not died out at the setpoint's end.

    Examples
    --------
    >>> import numpy as np, loopshape as ls
    >>> f_hz = np.geomspace(0.1, 200.0, 150)
    >>> P = ls.FRF.from_arrays(f_hz, 20.0 / (2j * np.pi * f_hz), relative_std=0.01, rate_hz=1000.0)
    >>> r = np.interp(np.arange(4000) / 1000.0, [0.5, 1.5], [0.0, 1.0])
    >>> C = ls.controller(ls.gain(0.5), rate_hz=1000.0)
    >>> F = ls.learning.feedforward(P, band_hz=(0.1, 50.0), integrators=1)
    >>> without, helped = (ls.learning.tracking_error(P, C, r, one, integrators=1) for one in (None, F))
    >>> bool(helped.rms < 0.1 * without.rms)
    True
    """
    controller = C.controller if isinstance(C, Tuning) else C
    return tracking_error_of(P, controller, setpoint, F, integrators=integrators, unstable_poles=unstable_poles)


def setpoint_of(
    distance: float, velocity: float, acceleration: float, jerk: float, *, rate_hz: float, rest_s: float
) -> Array:
    """A third-order setpoint (n,) from 0 to `distance`, with a rest of `rest_s` before and twice that behind."""
    slowest_s = 2.0 * (distance / velocity + velocity / acceleration + acceleration / jerk)
    n = round((3.0 * rest_s + slowest_s) * rate_hz)
    return Profile((rest_s,), (distance,), velocity, acceleration, jerk).sampled(n, rate_hz, 0.0)
