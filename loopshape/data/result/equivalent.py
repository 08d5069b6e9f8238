"""What the bench knows of a block diagram: the plants that its tuned block meets, and that it can be drawn."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Protocol, runtime_checkable

from loopshape.core.errors import WrongUseError
from loopshape.data.requirement.requirements import Requirements
from loopshape.data.response.frf import FRF
from loopshape.data.result.verdict import Verdict

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@runtime_checkable
class Diagram(Protocol):
    """Blocks around the one that is tuned. Verbs that take a plant take it, and files of it are read by a toolbox."""

    name: str
    tuned: str

    def equivalent(self) -> Equivalent:
        """The plants that the tuned block meets; refuses inner loops that are not certified stable."""

    def figure(self) -> Figure:
        """Its picture."""


@dataclass(frozen=True, eq=False)
class Equivalent:
    """The plants that a diagram's tuned block meets (one an operating point), and the verdicts on its inner loops.

    `unstable_poles` is what is left unstable with the tuned block open, None where it is not known; of `integrators`
    there are so many left at least.
    """

    plants: tuple[FRF, ...]
    inner: Mapping[str, Verdict]
    unstable_poles: int | None
    integrators: int = 0

    def __repr__(self) -> str:
        """One line: how many operating points, the unstable poles, and the inner loops' outcomes."""
        points = f"{len(self.plants)} operating point{'s' * (len(self.plants) != 1)}"
        inner = "".join(f", inner loop {name} {verdict.outcome}" for name, verdict in self.inner.items())
        poles = "unknown" if self.unstable_poles is None else self.unstable_poles
        return f"Equivalent: {points}, unstable poles {poles}{inner}"

    def asked(self, R: Requirements) -> Requirements:
        """Requirements with the number of unstable poles; refuses another one declared, and too few integrators."""
        if R.integrators is not None and max(R.integrators, 0) < self.integrators:
            raise hidden(self.integrators, R.integrators, R.loop)
        if self.unstable_poles is None or R.unstable_poles == self.unstable_poles:
            return R
        if R.unstable_poles is not None:
            raise WrongUseError(
                "the requirements declare other unstable poles than the diagram has with its tuned block open",
                f"{R.unstable_poles} and {self.unstable_poles}", "declare them at the plants, and leave them out here",
            )  # fmt: skip
        return replace(R, unstable_poles=self.unstable_poles)


def hidden(left: int, seen: int, tuned: str) -> WrongUseError:
    """Two integrators that share one error drift against each other, and the error shows nothing of it."""
    return WrongUseError(
        "the diagram has an integrator that the tuned block does not see, and that nothing holds",
        f"{left} are left by the inner loops, {tuned} sees {seen}",
        "leave one out of the controllers, or declare integrators at the plants",
    )
