"""The next recording of a machine that is followed with measured inputs, since its controller is not known.

Candidates are the run's own recordings again, with commands and motion smaller, alike, or larger, as long as commands
and motion stay within those of all recordings: nobody has said what the machine bears beyond. Each is simulated under
the first hypothesis and followed under the second, which may choose initial states but no other numbers; what it
leaves, in noise floors, is the separation. It is an upper bound, and holds as far as the model does.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Protocol, runtime_checkable

import numpy as np

from loopshape.data.signal.recording import Recording
from loopshape.data.signal.run import Run
from loopshape.toolbox.gap.diagnose.evidence import Moves
from loopshape.toolbox.gap.nouns.gap_report import Proposal
from loopshape.toolbox.gap.nouns.plant import SimulationModel

SHARES = (0.4, 0.7, 1.0, 1.4, 2.0)  # of the recording's own size
_MOST = 1e4  # floors: a simulation that is further off has run away


@runtime_checkable
class Repeatable(Protocol):
    """A followed plant that can say what a recording would be under other numbers and at another size."""

    def repeated(self, prepared: Any, moves: Mapping[str, float], share: float) -> Any:
        """The recording, prepared, with commands and motion `share` times as large."""

    def within(self, again: Any, every: Sequence[Any]) -> bool:
        """Whether a repeated recording's commands and outputs stay within those of every prepared one."""


Named = tuple[str, Moves]


def repeat(
    plant: SimulationModel, run: Run, recordings: Sequence[Recording], first: Named, second: Named
) -> Proposal | None:
    """The recording to repeat, and its size, that separates two hypotheses (name, moved parameters) most."""
    if first[0] == second[0] or not isinstance(plant, Repeatable):
        return None
    prepared = {r.info.name: plant.prepare(r, run, None) for r in recordings}
    every = list(prepared.values())
    values = {
        (name, share): separation(plant, again, second[1])
        for name, p in prepared.items()
        for share in SHARES
        if plant.within(again := plant.repeated(p, first[1], share), every) or share == 1.0
    }
    (name, share), best = max(values.items(), key=lambda item: item[1])
    size = "as it was"
    if share != 1.0:
        size = f"with commands {share:g} times as large, within the commands and outputs seen"
    parts = f"{first[0]} from {second[0]} by {best:.2g} noise floors"
    here = "" if share == 1.0 else f" ({values[name, 1.0]:.2g} at its own size)"
    nothing = 2.0  # floors, below which nothing is separated
    verb = f"separates {parts}" if best >= nothing else f"is the best that was found, yet it separates {parts} only"
    return Proposal(name, (first[0], second[0]), best, None, f"record {name} again {size}: it {verb}{here}")


def separation(plant: SimulationModel, prepared: Any, moves: Moves) -> float:
    """Rms over the channels of what moved parameters leave of a prepared recording, in floors."""
    floors = plant.floors(prepared)
    left = [np.clip(v / floors[k], -_MOST, _MOST) for k, v in plant.residuals(prepared, moves).items()]
    return float(np.sqrt(np.mean([np.mean(np.nan_to_num(v, nan=_MOST) ** 2) for v in left])))
