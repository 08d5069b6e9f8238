"""Pictures for scripts: plants, a controller and perhaps requirements in, matplotlib's Axes or Figure out."""

from __future__ import annotations

from typing import TYPE_CHECKING

from loopshape.data.controller import Controller
from loopshape.data.frf import FRF
from loopshape.data.requirements import Requirements, Verdict
from loopshape.loop.verdict import loops_of
from loopshape.view import frequency
from loopshape.view import loops as pages
from loopshape.view import nichols as charts
from loopshape.view.bode import bode_page

if TYPE_CHECKING:
    from collections.abc import Sequence

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from loopshape.data.loop import Loop
    from loopshape.design.tune import Tuning

    Plants = FRF | Sequence[FRF]


def _loops(P: Plants, C: Controller | Tuning, R: Requirements | None) -> list[Loop]:
    plants = (P,) if isinstance(P, FRF) else tuple(P)
    controller = C if isinstance(C, Controller) else C.controller
    return loops_of(plants, controller, R or Requirements(controller.loop))[0]


def frf(P: FRF) -> Figure:
    """Magnitude, phase and coherence of one FRF over frequency, with 95 % bands and the valid band."""
    return frequency.frf_page(P)


def nichols(
    P: Plants,
    C: Controller | Tuning,
    R: Requirements | None = None,
    *,
    verdict: Verdict | None = None,
    ax: Axes | None = None,
) -> Axes:
    """Open loops in the Nichols chart (degrees, dB), with what the requirements forbid; the worst point thick."""
    return charts.nichols(_loops(P, C, R), R, verdict=verdict, ax=ax)


def bode(P: Plants, C: Controller | Tuning, R: Requirements | None = None, *, verdict: Verdict | None = None) -> Figure:
    """Plant, controller, open loop, |S| and |T| over frequency, with bands and limits."""
    found = _loops(P, C, R)
    if len(found) == 1:
        return bode_page(found[0], R, verdict=verdict)
    return pages.loop_page(found, R, verdict=verdict)


def sensitivities(
    P: Plants, C: Controller | Tuning, R: Requirements | None = None, *, verdict: Verdict | None = None
) -> Figure:
    """|S|, |T|, |CS| and |PS| of all operating points in dB, each under its limit."""
    return pages.sensitivities(_loops(P, C, R), R, verdict=verdict)
