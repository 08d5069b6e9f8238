"""A block diagram on a machine: which of the loops' columns its signals are."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from loopshape.core.errors import WrongUseError
from loopshape.data.signal.experiment import LoopSetup
from loopshape.toolbox.diagrams.diagram import Diagram


@dataclass(frozen=True, eq=False)
class Wired:
    """A diagram whose controllers run on a target, with the study's columns that its signals are.

    `columns` name, for each signal, a loop's column: a reference (`r_x_mm`) or an output (`x_mm`) is read,
    a control (`z_x_v`) is what the diagram gives in place of that loop's controller. None is a signal from outside
    that nothing moves, as a disturbance. What is injected at the controllers' input of a loop is taken off its output.
    Loops whose control is not named keep their own controllers. Refuses signals that the diagram does not have.

    Misleads: limits and the watchdog are the target's; nothing of the diagram is checked here (`ls.check`).

    >>> import numpy as np, loopshape as ls
    >>> f_hz = np.geomspace(1.0, 400.0, 80)
    >>> P = ls.FRF.from_arrays(f_hz, 1.0 / (1.0 + 1j * f_hz / 10.0), relative_std=0.01, rate_hz=1000.0)
    >>> C = ls.controller(ls.gain(2.0), rate_hz=1000.0)
    >>> D = ls.diagrams.prefilter(P, ls.controller(ls.low_pass(5.0, order=1), rate_hz=1000.0)).with_part("C", C)
    >>> ls.diagrams.Wired(D, {"r": "r_axis_rad", "y": "angle_rad", "u": "z_axis_v"})
    Wired prefilter: r is r_axis_rad, y is angle_rad, u is z_axis_v
    """

    diagram: Diagram
    columns: Mapping[str, str | None]

    def __post_init__(self) -> None:
        object.__setattr__(self, "columns", dict(self.columns))
        if unknown := [name for name in self.columns if name not in self.diagram.signals]:
            known = ", ".join(self.diagram.signals)
            raise WrongUseError("the diagram has no such signal", ", ".join(unknown), f"it has {known}")

    def __repr__(self) -> str:
        """One line: the diagram's name, and what its signals are."""
        return f"Wired {self.diagram.name}: {', '.join(f'{k} is {v}' for k, v in self.columns.items())}"

    def gives(self, loop: LoopSetup) -> str | None:
        """The signal that is this loop's control; None where the loop keeps its controller."""
        return next((name for name, column in self.columns.items() if column == loop.control), None)

    def to_dict(self) -> dict[str, Any]:
        """Plain values for a run: the diagram with what stands in its blocks, and the columns."""
        return {**self.diagram.to_dict(), "columns": {k: v for k, v in self.columns.items() if v is not None}}
