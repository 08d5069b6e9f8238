"""Pictures for scripts: `ls.plot(thing)` draws what suits it, `ls.plot.bode(P, C)` and the others choose."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from loopshape.core.errors import WrongUseError
from loopshape.data.algebra import controller_frf
from loopshape.data.control.controller import Controller
from loopshape.data.requirement.requirements import Requirements
from loopshape.data.response.frf import FRF
from loopshape.data.result.equivalent import Diagram
from loopshape.data.result.verdict import Verdict
from loopshape.loop.loop import Loop
from loopshape.loop.loops import loops_of
from loopshape.view.plots import frequency
from loopshape.view.plots import loops as pages
from loopshape.view.plots import matrix as matrices
from loopshape.view.plots import nichols as charts
from loopshape.view.plots.bode import bode_page
from loopshape.view.verdict.verdicts import margins_map

if TYPE_CHECKING:
    from collections.abc import Sequence

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from loopshape.data.response.model import Fit
    from loopshape.design.tune import Tuning

    Plants = FRF | Sequence[FRF] | Diagram
    Drawn = Controller | Tuning | Mapping[str, Controller | Tuning]


#: frequencies of a controller's own picture, of its rate
GRID = np.geomspace(1e-4, 0.4999, 360)


def _loops(P: Plants, C: Drawn, R: Requirements | None) -> list[Loop]:
    """The loops of all plants with one controller, or with each of several, then named by plant and controller."""
    found = P.equivalent() if isinstance(P, Diagram) else None
    plants = (P,) if isinstance(P, FRF) else P.equivalent().plants if isinstance(P, Diagram) else tuple(P)
    loops: list[Loop] = []
    for name, one in C.items() if isinstance(C, Mapping) else [("", C)]:
        controller = one if isinstance(one, Controller) else one.controller
        asked = R or Requirements(controller.loop)
        named = [replace(plant, recording=f"{plant.recording} {name}".strip()) for plant in plants] if name else plants
        loops += loops_of(named, controller, found.asked(asked) if found else asked)[0]
    return loops


class Plots:
    """Plants, a controller (or several by name) and perhaps requirements in, matplotlib's Axes or Figure out."""

    __name__ = "loopshape.plot"

    def __call__(self, thing: object) -> Figure:
        """The picture that suits one thing: an FRF, a loop (of several S), a controller or a tuning, a verdict,
        or a toolbox's noun, as a prediction or several.

        Raises WrongUseError for what has none.
        """
        match thing:
            case FRF() if thing.response.shape[1:] == (1, 1):
                return self.frf(thing)
            case FRF():
                return self.matrix(thing)
            case Loop():
                return bode_page(thing, None) if thing.is_one else self.matrix(thing.sensitivity)
            case Controller():
                return self.frf(controller_frf(thing, thing.rate_hz * GRID, ("e",), ("z",)))
            case Verdict() if thing.lines:
                return margins_map(thing)
            case object(controller=Controller() as tuned):
                return self(tuned)
        several = thing if isinstance(thing, tuple | list) and len({*map(type, thing)}) == 1 else None
        draw = getattr(several[0], "figure_of", None) if several else getattr(thing, "figure", None)
        if callable(draw):
            made: Figure = draw(several) if several else draw()
            return made
        what = "there is no picture of this" + (", which has no required margin" if isinstance(thing, Verdict) else "")
        raise WrongUseError(what, type(thing).__name__, "a loop is drawn by ls.plot.bode(P, C), .nyquist and .nichols")

    @staticmethod
    def frf(P: FRF, fit: Fit | None = None) -> Figure:
        """Magnitude, phase and coherence of one FRF over frequency, with 95 % bands and the valid band; with a fit."""
        return frequency.frf_page(P, fit)

    @staticmethod
    def matrix(P: FRF) -> Figure:
        """Magnitude and phase of each element of a matrix FRF, with 95 % bands."""
        return matrices.matrix_page(P)

    @staticmethod
    def interaction(found: object) -> Figure:
        """Interaction coefficients, relative gains and equivalent plants over frequency, with bounds and verdicts."""
        return plot(found)

    @staticmethod
    def prediction(predictions: Sequence[object]) -> Figure:
        """Predicted |S|, |T| and steps of one loop at all operating points, with their bands."""
        if not predictions:
            raise WrongUseError("a picture of predictions needs at least one", "none", "predict first")
        return plot(tuple(predictions))

    @staticmethod
    def nyquist(
        P: Plants,
        C: Drawn,
        R: Requirements | None = None,
        *,
        verdict: Verdict | None = None,
        ax: Axes | None = None,
    ) -> Axes:
        """Open loops in the complex plane about -1, with the circle that a required modulus margin keeps clear."""
        return charts.nyquist(_loops(P, C, R), R, verdict=verdict, ax=_own(ax))

    @staticmethod
    def nichols(
        P: Plants,
        C: Drawn,
        R: Requirements | None = None,
        *,
        verdict: Verdict | None = None,
        ax: Axes | None = None,
    ) -> Axes:
        """Open loops in the Nichols chart (degrees, dB), with what the requirements forbid; the worst point thick.

        Without `ax` in a figure of pyplot's, which a notebook shows.
        """
        return charts.nichols(_loops(P, C, R), R, verdict=verdict, ax=_own(ax))

    @staticmethod
    def bode(
        P: Plants,
        C: Drawn | None = None,
        R: Requirements | None = None,
        *,
        verdict: Verdict | None = None,
    ) -> Figure:
        """Plant, controller, open loop, |S| and |T| over frequency, with bands and limits; without C one FRF.

        Of several controllers by name, `{"old": C1, "new": C2}`, all loops stand in one figure.
        """
        if C is None:
            return plot(P)
        found = _loops(P, C, R)
        if len(found) == 1:
            return bode_page(found[0], R, verdict=verdict)
        return pages.loop_page(found, R, verdict=verdict)

    @staticmethod
    def sensitivities(P: Plants, C: Drawn, R: Requirements | None = None, *, verdict: Verdict | None = None) -> Figure:
        """|S|, |T|, |CS| and |PS| of all operating points in dB, each under its limit."""
        return pages.sensitivities(_loops(P, C, R), R, verdict=verdict)


def _own(ax: Axes | None) -> Axes:
    """The axes given, or those of a figure of pyplot's, which a notebook shows."""
    if ax is not None:
        return ax
    from matplotlib import pyplot

    return pyplot.figure(figsize=(6.4, 5.2), layout="constrained").add_subplot()


plot = Plots()
