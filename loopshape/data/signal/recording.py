"""A recording: the table that one experiment left, and what is known of that experiment."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar

import numpy as np

from loopshape.core import stretches
from loopshape.core.errors import BadSignalError, WrongUseError
from loopshape.core.gate import FromZero, Positive
from loopshape.core.stretches import ByStretches, LongSignal, Signal
from loopshape.core.units import Array
from loopshape.data.signal.channel import sum_terms
from loopshape.data.signal.experiment import Experiment, ExperimentSettings, refuse_unknown_words


@dataclass(frozen=True)
class RecordingInfo(ExperimentSettings):
    """What `run.toml` says of one recording; docs/files.md explains each word.

    `excites_also` are further loops excited at once with `excites`; `ended_early` says why a recording is shorter than
    asked. What an experiment tells unchanged stands in `ExperimentSettings`.
    """

    file: str
    kind: str
    injection: str
    role: str = "estimation"
    excites: str | None = None
    closed_loop: bool = True
    operating_point: Mapping[str, float] = field(default_factory=dict)
    period_s: Positive | None = None
    periodic_from_s: FromZero | None = None
    ended_early: str | None = None
    excites_also: tuple[str, ...] = ()
    WRITTEN: ClassVar = ("role", "closed_loop")

    def __post_init__(self) -> None:
        refuse_unknown_words(f"recording {self.file}", self.kind, self.injection, self.role)

    @classmethod
    def unfolded(cls, table: Mapping[str, Any]) -> dict[str, Any]:
        """A `[[recording]]` that says whether the loops were closed; refuses one at odds with its injection."""
        injection = table.get("injection")
        closed_loop = table.get("closed_loop", injection != "control")
        if closed_loop is (injection == "control"):
            raise WrongUseError(
                'closed_loop = false goes with injection = "control", and with no other',
                f"closed_loop = {str(closed_loop).lower()} and injection = {injection!r}", "say what was done",
            )  # fmt: skip
        return {**table, "closed_loop": closed_loop}

    @classmethod
    def of(cls, e: Experiment, ended_early: str | None = None) -> RecordingInfo:
        """What a recording inherits from the experiment that it was made by."""
        return cls(
            file=f"{e.name}.parquet",
            kind=e.kind,
            injection=e.injection,
            role=e.role,
            excites=e.excites,
            closed_loop=e.closed_loop,
            operating_point=dict(e.operating_point),
            period_s=e.period_s,
            periodic_from_s=e.periodic_from_s,
            **e.settings(),
            excites_also=e.excites_also,
            ended_early=ended_early,
        )

    @property
    def excited(self) -> tuple[str, ...]:
        """All loops that it excites, `excites` first."""
        return () if self.excites is None else (self.excites, *self.excites_also)

    @property
    def alone(self) -> bool:
        """Whether it excites one loop alone, so that this loop's own FRF follows from it."""
        return self.excites is not None and not self.excites_also

    @property
    def name(self) -> str:
        """The file's name without its ending."""
        return self.file.split(".")[0]


@dataclass(frozen=True, eq=False)
class Recording:
    """Columns (n,) by name at a constant rate. `columns` may load each column when it is asked for."""

    info: RecordingInfo
    rate_hz: float
    columns: Mapping[str, Array]

    def __repr__(self) -> str:
        """One line: its name, columns and rate."""
        return f"Recording {self.info.name}: {', '.join(self.columns)} at {self.rate_hz:g} Hz"

    def stored(self, name: str) -> Signal:
        """A column as it is stored, which may hold what is no number; of a long recording a `LongSignal`."""
        self._check_name(name)
        columns = self.columns
        if not isinstance(columns, ByStretches) or columns.rows < stretches.LONG:
            return np.asarray(columns[name], dtype=float)
        return LongSignal(columns.rows, lambda start, stop: columns.stretch(name, start, stop))

    def signal(self, expression: str) -> Signal:
        """As `output`, but of a long recording what is read a stretch at a time, and refused when it is read."""
        terms = sum_terms(expression)
        signals = [self._checked(name, self.stored(name)) for name in terms]
        return signals[0] if len(terms) == 1 else self._sum(signals)

    def _checked(self, name: str, signal: Signal) -> Signal:
        if isinstance(signal, LongSignal):
            return LongSignal(signal.size, lambda start, stop: self._finite(name, signal[start:stop], start))
        return self._finite(name, signal, 0)

    @staticmethod
    def _sum(signals: Sequence[Signal]) -> Signal:
        if any(isinstance(signal, LongSignal) for signal in signals):
            return LongSignal(
                signals[0].size, lambda start, stop: np.asarray(np.sum([s[start:stop] for s in signals], axis=0))
            )
        return np.asarray(np.sum([np.asarray(s) for s in signals], axis=0))

    def column(self, name: str) -> Array:
        """A column (n,), as a read-only view; refuses one that is missing or holds NaN."""
        self._check_name(name)
        return self._finite(name, np.asarray(self.columns[name], dtype=float), 0)

    def output(self, expression: str) -> Array:
        """A column, or the sum of columns that `expression` names, (n,)."""
        terms = [self.column(term) for term in sum_terms(expression)]
        return np.asarray(np.sum(terms, axis=0))

    def _check_name(self, name: str) -> None:
        if name not in self.columns:
            raise BadSignalError(
                f"recording {self.info.file} has no column {name}", f"columns {', '.join(self.columns)}"
            )

    def _finite(self, name: str, values: Array, first_row: int) -> Array:
        values = values.view()
        bad = np.flatnonzero(~np.isfinite(values))
        if bad.size:
            raise BadSignalError(
                f"column {name} of recording {self.info.file} holds {bad.size} values that are not numbers",
                f"the first in row {first_row + bad[0]}",
                "repair the recording or leave it out",
            )
        values.setflags(write=False)
        return values
