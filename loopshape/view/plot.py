"""Pictures for scripts: plants, a controller and perhaps requirements in, matplotlib's Axes or Figure out."""

from __future__ import annotations

from typing import TYPE_CHECKING

from loopshape.data.control.controller import Controller
from loopshape.data.requirement.requirements import Requirements
from loopshape.data.response.frf import FRF
from loopshape.data.result.verdict import Verdict
from loopshape.loop.verdict import loops_of
from loopshape.toolbox.diagrams import picture as diagrams
from loopshape.toolbox.diagrams.diagram import Diagram
from loopshape.toolbox.diagrams.equivalent import equivalent
from loopshape.toolbox.gap.pictures import report as gaps
from loopshape.view.plots import frequency
from loopshape.view.plots import interaction as meetings
from loopshape.view.plots import loops as pages
from loopshape.view.plots import matrix as matrices
from loopshape.view.plots import nichols as charts
from loopshape.view.plots.bode import bode_page
from loopshape.view.verdict import prediction as forecasts

if TYPE_CHECKING:
    from collections.abc import Sequence

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from loopshape.data.control.loop import Loop
    from loopshape.data.response.interaction import Interaction
    from loopshape.data.result.prediction import Prediction
    from loopshape.design.tune import Tuning
    from loopshape.toolbox.gap.nouns.gap_report import GapReport

    Plants = FRF | Sequence[FRF] | Diagram


def _loops(P: Plants, C: Controller | Tuning, R: Requirements | None) -> list[Loop]:
    controller = C if isinstance(C, Controller) else C.controller
    asked = R or Requirements(controller.loop)
    if isinstance(P, Diagram):
        found = equivalent(P)
        return loops_of(found.plants, controller, found.asked(asked))[0]
    return loops_of((P,) if isinstance(P, FRF) else tuple(P), controller, asked)[0]


def diagram(D: Diagram, *, ax: Axes | None = None) -> Axes:
    """The block diagram, plants blue and the tuned block orange; without `ax` in a figure of its size."""
    return diagrams.diagram(D, ax=ax)


def frf(P: FRF) -> Figure:
    """Magnitude, phase and coherence of one FRF over frequency, with 95 % bands and the valid band."""
    return frequency.frf_page(P)


def matrix(P: FRF) -> Figure:
    """Magnitude and phase of each element of a matrix FRF, with 95 % bands."""
    return matrices.matrix_page(P)


def interaction(found: Interaction) -> Figure:
    """Interaction coefficients, relative gains and equivalent plants over frequency, with bounds and verdicts."""
    return meetings.interaction_page(found)


def prediction(predictions: Sequence[Prediction]) -> Figure:
    """Predicted |S|, |T| and steps of one loop at all operating points, with their bands."""
    return forecasts.prediction_page(predictions)


def gap(report: GapReport) -> Figure:
    """Where a simulation leaves the machine, which effect causes it, and how that looks in time."""
    return gaps.gap_figure(report)


def nichols(
    P: Plants,
    C: Controller | Tuning,
    R: Requirements | None = None,
    *,
    verdict: Verdict | None = None,
    ax: Axes | None = None,
) -> Axes:
    """Open loops in the Nichols chart (degrees, dB), with what the requirements forbid; the worst point thick.

    Without `ax` in a figure of pyplot's, which a notebook shows.
    """
    if ax is None:
        from matplotlib import pyplot

        ax = pyplot.figure(figsize=(6.4, 5.2), layout="constrained").add_subplot()
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
