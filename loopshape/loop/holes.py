"""Where the lines of a loop leave out too much to be called a measurement: few lines, and wide holes between them."""

from __future__ import annotations

import numpy as np

from loopshape.core.units import ComplexArray
from loopshape.data.loop import Loop

#: fewer lines than this say nothing of what lies between them
FEWEST = 6
#: neighbouring lines may lie this far apart, as a ratio; just above what an even grid's first two lines have
APART = 2.05
#: the known delay of a controller may turn L by so much between neighbouring lines, in cycles
TURN = 0.25
#: L that is smaller than this on both sides of a hole, or larger than its inverse, does not meet -1 within it
FAR = 0.1


def hole(loop: Loop) -> tuple[str, tuple[float, float]] | None:
    """What is missing between the lines, in words, and the band in Hz to measure; None where they are dense enough.

    A plant may do anything within a hole an octave wide: where |L| is between 1/10 and 10 on either side a count or a
    margin read across it would be a guess. The delay of the controller's computation is known, and lines that it turns
    through more than a quarter of a cycle from one to the next cannot follow it.
    """
    f, L = loop.frequency_hz, loop.L
    if f.size < FEWEST:
        words = f"{f.size} frequencies are too few to show what lies between them ({FEWEST} at least)"
        return words, (0.5 * float(f[0]), min(2.0 * float(f[-1]), 0.5 * loop.controller.rate_hz))
    near = _near(L)
    wide = np.flatnonzero((f[1:] > APART * f[:-1]) & near)
    if wide.size:
        low, high = float(f[wide[0]]), float(f[wide[0] + 1])
        return f"no frequency lies between {low:.3g} and {high:.3g} Hz, where L may pass -1: measure there", (low, high)
    turned = np.flatnonzero((loop.controller.computation_delay_s * np.diff(f) > TURN) & near)
    if turned.size:
        low, high = float(f[turned[0]]), float(f[turned[-1] + 1])
        words = (
            f"the controller's delay of {loop.controller.computation_delay_s:g} s turns L by"
            f" {360.0 * loop.controller.computation_delay_s * (f[turned[0] + 1] - f[turned[0]]):.0f} deg from one"
        )
        return f"{words} frequency to the next: measure finer, or correct the delay", (low, high)
    return None


def _near(L: ComplexArray) -> np.ndarray:
    """Gaps (nf - 1,) in which L may come near -1 by its size on either side."""
    size = np.abs(L)
    larger, smaller = np.maximum(size[1:], size[:-1]), np.minimum(size[1:], size[:-1])
    return np.asarray((larger > FAR) & (smaller < 1.0 / FAR))
