"""A run: recordings of one rig, with the loops and controllers under which they were made."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from numpy.typing import ArrayLike

from loopshape.core.errors import WrongUseError, refuse_unknown
from loopshape.core.gate import gated, pass_fields
from loopshape.core.units import Array
from loopshape.data.arrays import number, rate, real_array
from loopshape.data.control.controller import Controller
from loopshape.data.signal.excitation_kind import KNOWN_REPEATED, REPEATED, is_sweep, rows_of_a_period
from loopshape.data.signal.experiment import LoopSetup
from loopshape.data.signal.recording import Recording, RecordingInfo

#: columns of the signals of `Run.from_arrays`
_COLUMNS = {"u": "u_1", "y": "y_1", "excitation": "n_1", "reference": "r_1"}
#: rows of an excitation in which a period is looked for
_LOOKED_AT = 4_000_000


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

    def __post_init__(self) -> None:
        pass_fields(self)
        rate(self.rate_hz, "rate_hz of a run")

    @classmethod
    @gated
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
        role: str = "estimation",
        period_s: float | None = None,
        controller: Controller | None = None,
        operating_point: Mapping[str, float] | None = None,
    ) -> Run:
        """A run of one recording (n,) of one loop: what the controller gives out, what the sensor says.

        With `excitation`, the signal that was injected, the loop was closed; it entered at the controller's input or,
        with injection "plant_input", behind `u` (then it is added to `u`; of a log taken behind the sum give
        `u - excitation`). Without, `u` was applied in open loop.
        With `reference` the recording is one of a move along this setpoint, from which no FRF is estimated and
        `ls.learning.next_trial` learns; an excitation beside it is the feedforward, and entered at the plant's input.
        `period_s` says that the excitation repeats; without it a period is looked for, then a sweep is told by a
        frequency that rises or falls steadily, and the rest is noise.
        `controller` is what closed the loop, and tells unstable poles.
        A recording with role "validation" is held out. Columns are `u_1`, `y_1`, `n_1`, `r_1`, by which a machine of
        your own (`ls.gap(run, model=...)`) names them; recordings of several such runs make one run:
        `ls.Run(rate_hz, (), [...])`.
        Signs as drawn in `loopshape.loop.loop`. Raises WrongUseError for lengths that differ, another word
        for the injection, and what is no real number; BadSignalError for masked values, NaN and values above 1e50.

        Examples
        --------
        >>> import numpy as np, loopshape as ls
        >>> u = np.random.default_rng(1).standard_normal(1000)
        >>> ls.Run.from_arrays(u=u, y=0.5 * u, rate_hz=1000.0)
        Run: 1 recording at 1000 Hz, loop loop
        """
        refuse_unknown("an excitation enters at one of two places", injection, ("controller_input", "plant_input"))
        given = {"u": u, "y": y, "excitation": excitation, "reference": reference}
        arrays = {
            _COLUMNS[name]: real_array(values, f"{name} of a run")
            for name, values in given.items() if values is not None or name in ("u", "y")
        }  # fmt: skip
        if len({values.shape for values in arrays.values()}) != 1 or arrays["u_1"].ndim != 1 or not arrays["u_1"].size:
            shapes = ", ".join(f"{name[:-2]} {values.shape}" for name, values in arrays.items())
            raise WrongUseError("the signals of a recording are (n,) and of one length", shapes, "cut them alike")
        r, n = ("r_1" if "r_1" in arrays else None), ("n_1" if "n_1" in arrays else None)
        setup = LoopSetup(loop, r, n, "u_1", "y_1", controller)
        place = ("reference" if n is None else "plant_input") if r else ("control" if n is None else injection)
        moved, first = arrays[n or "u_1"], 0
        if period_s is not None:
            period_s = number(period_s, "period_s of a run", positive=True, unit="s")
        elif not r:
            rows, first = rows_of_a_period(moved[:_LOOKED_AT], KNOWN_REPEATED if n else REPEATED)
            period_s = rows / rate(rate_hz, "rate_hz of a run") if rows else None
        info = RecordingInfo(
            file=f"{recording}.parquet",
            kind="profile" if r else _kind(moved, period_s),
            injection=place,
            role=role,
            excites=None if r else loop,
            closed_loop=place != "control",
            operating_point=dict(operating_point or {}),
            period_s=period_s,
            periodic_from_s=None if period_s is None else first / rate_hz,
        )
        return cls(rate_hz, (setup,), (Recording(info, rate_hz, arrays),))

    def __repr__(self) -> str:
        """One line: its recordings, rate and loops."""
        count, names = len(self.recordings), ", ".join(loop.name for loop in self.loops)
        word = "recording" if count == 1 else "recordings"
        return f"Run: {count} {word} at {self.rate_hz:g} Hz, loop{'s' * (len(self.loops) > 1)} {names}"

    def loop(self, name: str) -> LoopSetup:
        """A loop by name, the only one also without a name (""); refuses an unknown one."""
        if name == "" and len(self.loops) == 1:
            return self.loops[0]
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


def _kind(moved: Array, period_s: float | None) -> str:
    """Of what kind the excitation (n,) is."""
    return "multisine" if period_s is not None else "sweep" if is_sweep(moved) else "noise"
