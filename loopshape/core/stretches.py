"""Signals that are too long to be held whole: they are read a stretch at a time, in order or anywhere."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

import numpy as np

from loopshape.core.units import Array

#: rows from which on a recording is read a stretch at a time, and rows of such a stretch
LONG, AT_ONCE = 8_000_000, 1 << 20


@runtime_checkable
class ByStretches(Protocol):
    """Columns of a recording that can be read in part."""

    @property
    def rows(self) -> int:
        """Number of rows."""

    def stretch(self, name: str, start: int, stop: int) -> Array:
        """Rows start to stop (exclusive) of a column."""


@dataclass(frozen=True, eq=False)
class LongSignal:
    """A signal of `size` samples of which `signal[a:b]` reads those rows alone; `np.asarray` reads it whole."""

    size: int
    read: Callable[[int, int], Array]

    def __getitem__(self, rows: slice) -> Array:
        start, stop, _ = slice(rows.start, rows.stop).indices(self.size)
        return self.read(start, max(start, stop))

    def __add__(self, other: Signal) -> LongSignal:
        return LongSignal(self.size, lambda start, stop: np.asarray(self[start:stop] + other[start:stop]))

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> np.ndarray:
        return np.asarray(self.read(0, self.size), dtype=dtype)


Signal = Array | LongSignal


class LongColumns(Mapping[str, Array]):
    """Columns by name of which some are read by stretches; `[name]` reads one whole."""

    def __init__(self, signals: Mapping[str, Signal]) -> None:
        self.signals = dict(signals)
        self.rows = next(iter(self.signals.values())).size

    def stretch(self, name: str, start: int, stop: int) -> Array:
        """Rows start to stop (exclusive) of a column."""
        return self.signals[name][start:stop]

    def __getitem__(self, name: str) -> Array:
        return np.asarray(self.signals[name])

    def __iter__(self) -> Iterator[str]:
        return iter(self.signals)

    def __len__(self) -> int:
        return len(self.signals)


def stretches(*signals: Signal) -> Iterator[tuple[Array, ...]]:
    """Signals (n,) of one length a stretch at a time, side by side."""
    for start in range(0, signals[0].size, AT_ONCE):
        yield tuple(signal[start : start + AT_ONCE] for signal in signals)


@dataclass(frozen=True)
class Extent:
    """Number of samples of a signal, its least and greatest value, mean and standard deviation, in its unit."""

    size: int
    least: float
    most: float
    mean: float
    std: float


def extent(signal: Signal) -> Extent:
    """What a signal (n,), n at least 1, extends over; stretches are joined as Chan, Golub and LeVeque do (1983).

    Where squares of its values exceed what a float holds, the standard deviation is inf.
    """
    size, mean, squares, least, most = 0, 0.0, 0.0, np.inf, -np.inf
    for (part,) in stretches(signal):
        with np.errstate(over="ignore"):
            spread = float(part.var())
        apart, whole = float(part.mean()) - mean, size + part.size
        squares += spread * part.size + apart * apart * size * part.size / whole
        mean, size = mean + apart * part.size / whole, whole
        least, most = min(least, float(part.min())), max(most, float(part.max()))
    return Extent(size, least, most, mean, float(np.sqrt(squares / size)))


def constant(signal: Signal) -> bool:
    """Whether a signal (n,), n at least 1, does not move; it is read no further than to where it does."""
    first = signal[:1]
    return all(bool(np.all(part == first)) for (part,) in stretches(signal))


def equal(one: Signal, other: Signal) -> bool:
    """Whether two signals hold the same numbers."""
    return one.size == other.size and all(np.array_equal(a, b) for a, b in stretches(one, other))
