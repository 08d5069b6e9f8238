"""A run: recordings of one rig, with the loops and controllers under which they were made."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from loopshape.core.errors import WrongUseError
from loopshape.data.controller import Controller
from loopshape.data.experiment import LoopSetup
from loopshape.data.recording import Recording, RecordingInfo


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

    @classmethod
    def from_arrays(
        cls,
        *,
        u: ArrayLike,
        y: ArrayLike,
        rate_hz: float,
        excitation: ArrayLike | None = None,
        reference: ArrayLike | None = None,
        injection: str = "controller_input",
        loop: str = "loop",
        recording: str = "recording",
        period_s: float | None = None,
        controller: Controller | None = None,
        operating_point: Mapping[str, float] | None = None,
    ) -> Run:
        """A run of one recording (n,) of one loop: what the controller gives out, what the sensor says.

        With `excitation`, the signal that was injected, the loop was closed; it entered at the controller's input or,
        with injection "plant_input", behind `u` (then it is added to `u`). Without, `u` was applied in open loop.
        With `reference` the recording is one of a move along this setpoint, from which no FRF is estimated and
        `ls.next_trial` learns; an excitation beside it is the feedforward, and entered at the plant's input.
        `period_s` says that the excitation repeats; `controller` is what closed the loop, and tells unstable poles.
        Signs as drawn in `loopshape.data.loop`. Raises WrongUseError for lengths that differ.

        Examples
        --------
        >>> import numpy as np, loopshape as ls
        >>> u = np.random.default_rng(1).standard_normal(1000)
        >>> ls.Run.from_arrays(u=u, y=0.5 * u, rate_hz=1000.0)
        Run: 1 recording at 1000 Hz, loop loop
        """
        given = {"u_1": u, "y_1": y, "n_1": excitation, "r_1": reference}
        arrays = {name: np.array(values, dtype=float) for name, values in given.items() if values is not None}
        if len({values.shape for values in arrays.values()}) != 1 or arrays["u_1"].ndim != 1:
            shapes = ", ".join(f"{name[:-2]} {values.shape}" for name, values in arrays.items())
            raise WrongUseError("the signals of a recording are (n,) and of one length", shapes, "cut them alike")
        r, n = ("r_1" if "r_1" in arrays else None), ("n_1" if "n_1" in arrays else None)
        setup = LoopSetup(loop, r, n, "u_1", "y_1", controller)
        place = ("reference" if n is None else "plant_input") if r else ("control" if n is None else injection)
        info = RecordingInfo(
            file=f"{recording}.parquet",
            kind="profile" if r else "noise" if period_s is None else "multisine",
            injection=place,
            excites=None if r else loop,
            closed_loop=place != "control",
            operating_point=dict(operating_point or {}),
            period_s=period_s,
            periodic_from_s=None if period_s is None else 0.0,
        )
        return cls(rate_hz, (setup,), (Recording(info, rate_hz, arrays),))

    def __repr__(self) -> str:
        """One line: its recordings, rate and loops."""
        count, names = len(self.recordings), ", ".join(loop.name for loop in self.loops)
        word = "recording" if count == 1 else "recordings"
        return f"Run: {count} {word} at {self.rate_hz:g} Hz, loop{'s' * (len(self.loops) > 1)} {names}"

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
