"""What is possible under requirements: the bound, and a controller of a given order near it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from loopshape.data.control.controller import Controller
from loopshape.data.requirement.requirements import Requirements
from loopshape.data.response.model import Fit
from loopshape.design.tune import Tuning
from loopshape.verbs.arguments import Plants, controller_of, equivalent_plants

if TYPE_CHECKING:
    from loopshape.toolbox.limits.bound import Bound


def bound(P: Plants, C: Controller | Tuning, R: Requirements, *, fits: Sequence[Fit] = ()) -> Bound:
    """How far a controller is from the bandwidth that no controller of any order exceeds under the requirements.

    Raises WrongUseError where the number of the plant's unstable poles is not known.
    """
    from loopshape.toolbox.limits.bound import bound as bound_loop

    plants, asked = equivalent_plants(P, R)
    return bound_loop(plants, controller_of(C), asked, tuple(fits))


def max_order_design(
    P: Plants, C: Controller | Tuning, R: Requirements, order: int, *, fits: Sequence[Fit] = (), seed: int = 0
) -> Tuning:
    """A controller of at most `order` poles near the best that `bound` finds possible, under all of `R`.

    A convex design of unlimited order (`bound`'s, with phase, gain and delay margins as half-planes) is fitted by a
    gain, biquads and lead-lags and tuned on from there; the structure of `R` counts for nothing. `C` says how the
    controller will run (rate, delay, hold) and stabilises an unstable plant. Takes about a minute for each plant.

    Misleads: a local search, so another start, or `tune` with `grow`, may find more. Of several plants the design
    knows the one with the least bound alone. Raises WrongUseError where no design was found.

    Examples
    --------
    >>> import numpy as np, loopshape as ls
    >>> f_hz = np.geomspace(1.0, 400.0, 40)
    >>> P = ls.FRF.from_arrays(f_hz, 50.0 / (2j * np.pi * f_hz), relative_std=0.01, rate_hz=5000.0)
    >>> R = ls.Requirements(sensitivity_peak_db=6.0, control_peak_db=6.0, unstable_poles=0, integrators=1)
    >>> found = ls.limits.max_order_design(P, ls.controller(ls.gain(0.5), rate_hz=5000.0), R, order=1)
    >>> found.controller.order()
    1
    """
    from loopshape.toolbox.limits.bound_order import reach_order

    plants, asked = equivalent_plants(P, R)
    return reach_order(plants, controller_of(C), asked, order, tuple(fits), seed=seed)
