"""What the bench knows of a comparison with a kept verdict: how it shows itself, and whether something got worse."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple, Protocol


class Case(NamedTuple):
    """One thing compared, as a build server lists it: where, its name, what became of it, and whether it is worse."""

    where: str
    name: str
    text: str
    worse: bool


class Comparison(Protocol):
    """What became of a baseline."""

    @property
    def counts(self) -> str:
        """The outcome, and how much is worse, better and unchanged."""

    @property
    def remarks(self) -> Sequence[str]:
        """What came or went, and what differs underneath."""

    @property
    def beside(self) -> Sequence[str]:
        """What is no case: what differs underneath, and what is new."""

    def tables(self, title: str) -> Iterable[tuple[str, Sequence[str], list[list[Any]]]]:
        """Outcomes that changed, then margins that did: titles, columns and rows."""

    def text(self, title: str) -> str:
        """The same in lines."""

    def cases(self) -> Iterable[Case]:
        """All that was compared."""


class Baseline(Protocol):
    """A check against a baseline: in all, and where controller and data both changed, the part of each."""

    @property
    def whole(self) -> Comparison:
        """In all."""

    @property
    def parts(self) -> Mapping[str, Comparison]:
        """The comparisons by their titles, the whole first."""

    @property
    def worse(self) -> bool:
        """Whether something got worse."""
