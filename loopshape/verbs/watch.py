"""Who is told of long work on a machine: the terminal of a command, or in a script Python's warnings alone."""

from __future__ import annotations

import sys
import warnings
from collections.abc import Callable, Iterable, Iterator
from contextlib import AbstractContextManager, contextmanager
from typing import Protocol, runtime_checkable


@runtime_checkable
class Watch(Protocol):
    """What is reported while work goes on."""

    def say(self, line: str) -> None:
        """A result in one sentence."""

    def warn(self, lines: Iterable[str]) -> None:
        """What a user has to know."""

    def progress(self, label: str, total: int) -> AbstractContextManager[Callable[[str], None]]:
        """A function to call with a word after each of `total` steps."""


class Unwatched:
    """Warnings become Python's; the rest is silent."""

    def say(self, line: str) -> None:
        """Nothing."""

    def warn(self, lines: Iterable[str]) -> None:
        """Each line a `UserWarning` of the line that called this package."""
        frame, level = sys._getframe(1), 2
        while frame.f_back is not None and str(frame.f_globals.get("__name__", "")).startswith("loopshape."):
            frame, level = frame.f_back, level + 1
        for line in lines:
            warnings.warn(line, stacklevel=level)

    @contextmanager
    def progress(self, label: str, total: int) -> Iterator[Callable[[str], None]]:
        """Steps that nobody counts."""
        yield lambda word: None
