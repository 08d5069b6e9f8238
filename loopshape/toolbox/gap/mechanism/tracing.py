"""Arithmetic written down as it happens: plain Python source of what a computation on numbers and names does.

Numbers stay numbers, so what is 0 or 1 disappears; what is computed twice is written once.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np


class Tape:
    """Lines of source, and the name of each value that has been computed."""

    def __init__(self) -> None:
        self.lines: list[str] = []
        self._known: dict[str, Term] = {}

    def name(self, text: str) -> Term:
        """A value that exists outside, such as `x[0]`."""
        return Term(self, text)

    def value(self, text: str) -> Term:
        """The value of an expression, computed once."""
        if text not in self._known:
            self._known[text] = Term(self, f"v{len(self.lines)}")
            self.lines.append(f"{self._known[text].text} = {text}")
        return self._known[text]


class Term:
    """A value on a tape. Sums, products and quotients with numbers and other terms are terms, or numbers again."""

    __array_ufunc__ = None  # arrays of objects hand each element over

    def __init__(self, tape: Tape, text: str) -> None:
        self.tape, self.text = tape, text

    def _with(self, sign: str, left: object, right: object) -> Term:
        return self.tape.value(f"{_text(left)} {sign} {_text(right)}")

    def __add__(self, other: Term | float) -> Term:
        return self if _is(other, 0.0) else self._with("+", *sorted((self, other), key=_text))

    def __sub__(self, other: Term | float) -> Term | float:
        if _text(self) == _text(other):
            return 0.0
        return self if _is(other, 0.0) else self._with("-", self, other)

    def __rsub__(self, other: float) -> Term:
        return -self if _is(other, 0.0) else self._with("-", other, self)

    def __mul__(self, other: Term | float) -> Term | float:
        if _is(other, 0.0):
            return 0.0
        if _is(other, 1.0):
            return self
        return -self if _is(other, -1.0) else self._with("*", *sorted((self, other), key=_text))

    def __truediv__(self, other: Term | float) -> Term:
        return self if _is(other, 1.0) else self._with("/", self, other)

    def __rtruediv__(self, other: float) -> Term | float:
        return 0.0 if _is(other, 0.0) else self._with("/", other, self)

    def __neg__(self) -> Term:
        return self.tape.value(f"-{self.text}")

    __radd__, __rmul__ = __add__, __mul__


def _is(value: object, number: float) -> bool:
    return not isinstance(value, Term) and value == number


def _text(value: object) -> str:
    return value.text if isinstance(value, Term) else repr(float(value))  # type: ignore[arg-type]


Scalar = Any  # a float or a Term
Row = list[Scalar]


def dot(a: Sequence[Scalar], b: Sequence[Scalar]) -> Scalar:
    """Sum of products."""
    total: Scalar = 0.0
    for x, y in zip(a, b, strict=True):
        total = total + x * y
    return total


def cross(a: Sequence[Scalar], b: Sequence[Scalar]) -> Row:
    """Vector product of vectors of three."""
    return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]


def add(*vectors: Sequence[Scalar]) -> Row:
    """Sum of vectors."""
    return [dot(parts, [1.0] * len(parts)) for parts in zip(*vectors, strict=True)]


def times(factor: Scalar, vector: Sequence[Scalar]) -> Row:
    """A vector times a number."""
    return [factor * v for v in vector]


def turned(matrix: Sequence[Sequence[Scalar]], vector: Sequence[Scalar]) -> Row:
    """A matrix times a vector."""
    return [dot(row, vector) for row in matrix]


def transposed(matrix: Sequence[Sequence[Scalar]]) -> list[Row]:
    """Rows and columns exchanged."""
    return [list(row) for row in zip(*matrix, strict=True)]


def product(a: Sequence[Sequence[Scalar]], b: Sequence[Sequence[Scalar]]) -> list[Row]:
    """Product of matrices."""
    columns = transposed(b)
    return [[dot(row, column) for column in columns] for row in a]


def solved(matrix: Sequence[Sequence[Scalar]], right: Sequence[Scalar]) -> Row:
    """Solution of a symmetric positive definite system, by elimination without exchange of rows."""
    a, b, n = [list(row) for row in matrix], list(right), len(right)
    for k in range(n):
        for i in range(k + 1, n):
            share = a[i][k] / a[k][k]
            a[i] = [x - share * y for x, y in zip(a[i], a[k], strict=True)]
            b[i] = b[i] - share * b[k]
    out: Row = [0.0] * n
    for k in reversed(range(n)):
        out[k] = (b[k] - dot(a[k][k + 1 :], out[k + 1 :])) / a[k][k]
    return out


def snapped(values: object) -> Any:
    """An array as nested lists of floats, what is within 1e-14 of a whole number exactly that."""
    array = np.asarray(values, dtype=float)
    whole = np.round(array)
    return np.where(np.abs(array - whole) < 1e-14, whole, array).tolist()


def filled(name: str, value: Any, known: Mapping[tuple[str, int], Scalar]) -> Any:
    """An array as nested lists, numbers that vary as names."""
    flat: list[Scalar] = list(np.ravel(snapped(value)))
    for k in range(len(flat)):
        flat[k] = known.get((name, k), float(flat[k]))
    shape = np.shape(value)
    if not shape:
        return flat[0]
    return flat if len(shape) == 1 else [flat[k * shape[1] : (k + 1) * shape[1]] for k in range(shape[0])]
