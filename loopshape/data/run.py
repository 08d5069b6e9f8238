"""A run: recordings of one rig, with the loops and controllers under which they were made."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from loopshape.core.errors import WrongUseError
from loopshape.data.experiment import LoopSetup
from loopshape.data.recording import Recording


@dataclass(frozen=True, eq=False)
class Run:
    """What a run folder holds. `recordings` may load their columns only when asked.

    `outputs` are columns, or sums of columns, that a plant's matrix has as rows; empty for the loops' outputs.
    """

    rate_hz: float
    loops: tuple[LoopSetup, ...]
    recordings: Sequence[Recording]
    plant: str | None = None
    pwm: Mapping[str, float] = field(default_factory=dict)
    extra: Mapping[str, Any] = field(default_factory=dict)
    outputs: tuple[str, ...] = ()

    def loop(self, name: str) -> LoopSetup:
        """A loop by name; refuses an unknown one."""
        for loop in self.loops:
            if loop.name == name:
                return loop
        raise WrongUseError(
            "the run has no such loop", f"{name!r}", f"its loops are {', '.join(x.name for x in self.loops)}"
        )

    def recording(self, name: str) -> Recording:
        """A recording by name or file; refuses an unknown one."""
        for recording in self.recordings:
            if name in (recording.info.name, recording.info.file):
                return recording
        raise WrongUseError("the run has no such recording", f"{name!r}")
