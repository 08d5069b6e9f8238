"""Open loops in the complex plane, near the point that they must not encircle."""

from __future__ import annotations

from collections.abc import Sequence

from matplotlib.axes import Axes
from matplotlib.patches import Circle

from loopshape.data.control.loop import Loop
from loopshape.data.requirement.requirements import Requirements
from loopshape.data.result.verdict import Verdict
from loopshape.loop.points import worst_of
from loopshape.view.key import key_of
from loopshape.view.style import LIMIT, QUIET, styled
from loopshape.view.verdict.loop_parts import looks_of, needs_loops, title_of

#: what is shown of the plane: -1 and the unit circle with room about them
REAL, IMAGINARY = (-3.0, 1.5), (-2.25, 2.25)


@styled()
def nyquist(
    loops: Sequence[Loop], requirements: Requirements | None, *, verdict: Verdict | None = None, ax: Axes
) -> Axes:
    """L at all operating points for positive frequencies, the worst thick, with the unit circle about 0.

    Red is the circle about -1 that a required modulus margin (the least |1 + L|) keeps clear; a limit on |S| is one of
    its inverse. What lies outside of the frame is left out.
    """
    needs_loops(loops)
    key = key_of([loop.plant for loop in loops])
    for loop, look in zip(loops, looks_of(key, worst_of(loops, verdict).index), strict=True):
        ax.plot(loop.L.real, loop.L.imag, **look)
    ax.add_patch(Circle((0.0, 0.0), 1.0, fill=False, color=QUIET, linewidth=0.7))
    if radius := _radius(requirements):
        ax.add_patch(Circle((-1.0, 0.0), radius, facecolor=LIMIT, alpha=0.2, edgecolor="none", gid="forbidden"))
    ax.plot([-1.0], [0.0], "+", color="black", markersize=7.0)
    ax.set(xlim=REAL, ylim=IMAGINARY, xlabel="real part of L", ylabel="imaginary part of L", aspect="equal")
    ax.set_title(title_of("Nyquist plot", loops), loc="left", fontsize=9.0)
    return ax


def _radius(required: Requirements | None) -> float:
    """Least |1 + L| that requirements allow, 0 without one."""
    if required is None:
        return 0.0
    peak_db = required.sensitivity_peak_db
    return max(required.modulus_margin or 0.0, 0.0 if peak_db is None else 10.0 ** (-peak_db / 20.0))
