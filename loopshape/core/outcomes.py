"""Outcomes and their order: the one place that says which is worse."""

from __future__ import annotations

from collections.abc import Iterable
from enum import StrEnum
from typing import Self


class Graded(StrEnum):
    """Words from best to worst, as they are defined."""

    @property
    def severity(self) -> int:
        """0 for the best, and one more for each that is worse."""
        return list(type(self)).index(self)

    @classmethod
    def worst(cls, found: Iterable[str]) -> Self:
        """The worst of some; the best where there are none."""
        return max(map(cls, found), key=lambda one: one.severity, default=next(iter(cls)))

    @property
    def outcome(self) -> Outcome:
        """The same as an outcome: the best passes, the worst fails, what lies between decides nothing."""
        grades = list(type(self))
        return Outcome.PASSED if self is grades[0] else Outcome.FAILED if self is grades[-1] else Outcome.UNDECIDED


class Outcome(Graded):
    """What data say of a controller under requirements: each is also its word."""

    PASSED = "passed"
    UNDECIDED = "undecided"
    FAILED = "failed"

    @property
    def word(self) -> str:
        """How it is printed: a failure is loud."""
        return {"passed": "pass", "failed": "FAIL"}.get(self.value, self.value)


class ClosedLoop(Graded):
    """What data say of a closed loop."""

    STABLE = "stable"
    UNDECIDED = "undecided"
    UNSTABLE = "unstable"


class Convergence(Graded):
    """How the search of a fit's parameters ended."""

    CONVERGED = "converged"
    AT_BOUND = "at_bound"
    NOT_CONVERGED = "not_converged"


class Settling(Graded):
    """Whether a step's response came to rest within what was seen."""

    SETTLED = "settled"
    NOT_SETTLED = "not settled"
