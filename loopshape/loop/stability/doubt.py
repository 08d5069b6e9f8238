"""How likely the errors of a path make its count of encirclements wrong."""

from __future__ import annotations

import numpy as np
from scipy.special import ndtr

from loopshape.core.units import TWO_PI, Array, ComplexArray


def reach_of(g: ComplexArray, std: Array, freedom: float = np.inf) -> Array:
    """|g| (nf,) in standard deviations sqrt E|d|² of a circular error, inf where there is none.

    A deviation that was itself estimated, with `freedom` degrees, counts for less: |d|² follows an F distribution with
    2 and `freedom` degrees, and the reach given is that of equal chance of a normal error.
    """
    with np.errstate(divide="ignore"):
        reach = np.abs(g) / np.where(std > 0.0, std, np.nan)
    reach = np.nan_to_num(reach, nan=np.inf)
    return np.asarray(np.sqrt(0.5 * freedom * np.log1p(2.0 * reach**2 / freedom)) if np.isfinite(freedom) else reach)


def chance_of_error(reach: Array, alike: Array) -> tuple[float, Array]:
    """Chance that errors carry a path over a point, one at most, and the share (n,) of each place.

    `reach` (n,) is the distance from the point in deviations, `alike` (n - 1,) the correlation of neighbours' errors
    (`data.smoothed.spread`). The error along the shortest way is normal; it passes the point at the nearest place, or
    comes to do so from one place to the next: as often as a normal process rises through a level (Rice, Bell System
    Technical Journal 24, 1945).
    """
    level, beyond = np.exp(-(reach**2)), ndtr(-np.sqrt(2.0) * reach)
    nearest = int(np.argmin(reach))
    at_nearest = float(beyond[nearest])  # whatever carries it over
    level[nearest] = beyond[nearest] = 0.0
    rising = np.arccos(np.clip(alike, 0.0, 1.0)) / TWO_PI * (level[1:] + level[:-1])
    share = np.append(0.0, 0.5 * np.minimum(rising, beyond[1:] + beyond[:-1]))  # half of rising, half of coming back
    share[nearest] += at_nearest
    return min(float(share.sum()), 1.0), share
