"""What a report of one run says: nouns alone, gathered by the command and written out by `draw.html`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np

from loopshape.core.outcomes import Outcome
from loopshape.core.stretches import Signal
from loopshape.core.units import Array
from loopshape.data.control.controller import Controller
from loopshape.data.response.frf import FRF
from loopshape.data.response.model import Estimate, Fit
from loopshape.data.result.equivalent import Diagram
from loopshape.data.result.verdict import Verdict
from loopshape.data.signal.recording import RecordingInfo
from loopshape.data.signal.run import Run
from loopshape.loop.verdict import LoopCheck


@dataclass(frozen=True)
class InputFile:
    """A file that the report was made from: its name within the run folder (or alone), its size, and its SHA-256."""

    name: str
    size_bytes: int
    sha256: str


@dataclass(frozen=True)
class GivenText:
    """A file of words that a command was given, verbatim: what it is ("controller", ...), its name, its text."""

    what: str
    name: str
    text: str


@dataclass(frozen=True, eq=False)
class StoredFigure:
    """A picture that lay in the run's `figures`, as it was: `kind` is png or svg."""

    name: str
    kind: str
    data: bytes


@dataclass(frozen=True, eq=False)
class Envelope:
    """Least and greatest value (bins,) of one column over equal stretches of its recording; no sample is lost to it."""

    column: str
    low: Array
    high: Array

    @classmethod
    def of(cls, column: str, values: Signal, bins: int = 160) -> Envelope:
        """Envelope of a column's values (n,), n at least 1, in at most `bins` stretches."""
        edges = np.unique(np.arange(min(bins, values.size) + 1) * values.size // min(bins, values.size))
        parts = (values[a:b] for a, b in pairwise(edges.tolist()))
        ends = np.array([(part.min(), part.max()) for part in parts])
        return cls(column, ends[:, 0], ends[:, 1])


@dataclass(frozen=True, eq=False)
class RecordingSheet:
    """One recording: what was stated of it, its length, the shape of its signals, and what is wrong with it."""

    info: RecordingInfo
    rate_hz: float
    samples: int
    envelopes: tuple[Envelope, ...] = ()
    faults: tuple[str, ...] = ()


def asked_outcome(verdict: Verdict) -> Outcome | None:
    """The outcome of a verdict, but None where nothing was asked and nothing failed."""
    return None if verdict.passed and not verdict.lines else verdict.outcome


@dataclass(frozen=True, eq=False)
class FittedModel:
    """A fit, and frequencies and damping of its roots where it is a rational one."""

    fit: Fit
    modes: tuple[Estimate, ...] = ()


@dataclass(frozen=True)
class Missing:
    """Something that the run does not have: what, and the command that would make it (empty: none would)."""

    what: str
    command: str = ""


@dataclass(frozen=True, eq=False)
class RunReport:
    """All that a report of one run shows. `date` and `author` are the caller's words: same report, same page.

    `checked` holds the loops that have FRFs and a controller, `unchecked` those that requirements name and that could
    not be compared with them; `frfs` all FRFs, `matrices` those of several channels. `figures_left_out` says of each
    picture that is not embedded why. `files` lists every input. With a `diagram` the plants of `checked` are what its
    tuned block meets, and `inner` holds the verdicts on the loops that are closed within.
    """

    name: str
    date: str
    versions: Mapping[str, str]
    run: Run | None = None
    recordings: tuple[RecordingSheet, ...] = ()
    notes: tuple[str, ...] = ()
    frfs: tuple[FRF, ...] = ()
    matrices: tuple[FRF, ...] = ()
    fits: tuple[FittedModel, ...] = ()
    checked: tuple[LoopCheck, ...] = ()
    unchecked: tuple[str, ...] = ()
    controllers: tuple[Controller, ...] = ()
    missing: tuple[Missing, ...] = ()
    figures: tuple[StoredFigure, ...] = ()
    figures_left_out: Mapping[str, str] = field(default_factory=dict)
    files: tuple[InputFile, ...] = ()
    texts: tuple[GivenText, ...] = ()
    diagram: Diagram | None = None
    inner: Mapping[str, Verdict] = field(default_factory=dict)
    author: str = ""

    @property
    def outcome(self) -> Outcome | None:
        """The worst outcome over all loops, None where nothing was asked of any."""
        found = [*map(asked_outcome, [*(one.verdict for one in self.checked), *self.inner.values()])]
        asked = [one for one in found if one is not None] + [Outcome.UNDECIDED] * bool(self.unchecked)
        return Outcome.worst(asked) if asked else None
