"""Products, sums, inverses, and parts of FRFs; what they have in common is said in `loopshape.data.algebra`."""

from __future__ import annotations

from collections.abc import Sequence

from loopshape.core.errors import WrongUseError
from loopshape.data.algebra.propagation import Term, channel_order, check_operands, eye, invert, pick, result
from loopshape.data.frf import FRF


def product(A: FRF, B: FRF, *, connect: str = "names", independent: bool = False) -> FRF:
    """A B: B's outputs drive A's inputs. `independent` says that one FRF given twice is two measurements."""
    check_operands((A, B), independent)
    B = pick(B, channel_order(B.outputs, A.inputs, connect, "the inner channels of a product"), range(len(B.inputs)))
    terms = [Term(A, eye(A, 1), B.response), Term(B, A.response, eye(B, 2))]
    return result("product", A.response @ B.response, A.outputs, B.inputs, terms)


def add(A: FRF, B: FRF, *, connect: str = "names", independent: bool = False) -> FRF:
    """A + B, side by side: same inputs, same outputs."""
    return _sum("sum", 1.0, A, B, connect, independent)


def subtract(A: FRF, B: FRF, *, connect: str = "names", independent: bool = False) -> FRF:
    """A - B, side by side."""
    return _sum("difference", -1.0, A, B, connect, independent)


def _sum(word: str, sign: float, A: FRF, B: FRF, connect: str, independent: bool) -> FRF:
    check_operands((A, B), independent)
    rows = channel_order(B.outputs, A.outputs, connect, f"the outputs of a {word}")
    B = pick(B, rows, channel_order(B.inputs, A.inputs, connect, f"the inputs of a {word}"))
    terms = [Term(A, eye(A, 1), eye(A, 2)), Term(B, sign * eye(B, 1), eye(B, 2))]
    return result(word, A.response + sign * B.response, A.outputs, A.inputs, terms)


def inverse(A: FRF) -> FRF:
    """A^-1, its inputs A's outputs; refuses one that is not square, or singular at a line.

    Biased where A's error is not small beside its least singular value: the covariance does not say so.
    """
    if len(A.inputs) != len(A.outputs):
        raise WrongUseError("only a square FRF has an inverse", f"{len(A.outputs)} x {len(A.inputs)}", "pick channels")
    made = invert(A.response, A.frequency_hz, "a FRF")
    return result("inverse", made, A.inputs, A.outputs, [Term(A, -made, made)])


def channels(frf: FRF, outputs: Sequence[str] | None = None, inputs: Sequence[str] | None = None) -> FRF:
    """The outputs and inputs named, in that order (None: all); coherences of other channels are left out."""
    rows = channel_order(frf.outputs, outputs, "part", "the outputs of a FRF") if outputs else range(len(frf.outputs))
    columns = channel_order(frf.inputs, inputs, "part", "the inputs of a FRF") if inputs else range(len(frf.inputs))
    return pick(frf, rows, columns)
