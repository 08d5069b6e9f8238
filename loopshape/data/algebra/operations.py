"""Products, sums, inverses, and parts of FRFs; what they have in common stands in `loopshape.data.algebra`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from loopshape.core.errors import WrongUseError
from loopshape.data.algebra.propagation import Term, channel_order, check_operands, eye, invert, pick, result
from loopshape.data.control.controller import Controller
from loopshape.data.response.frf import FRF


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


def negated(A: FRF) -> FRF:
    """-A, with its error: the response of a loop whose measurement held the sign of its summing point."""
    cross = None if A.cross_power is None else -A.cross_power
    return replace(A, response=-A.response, cross_power=cross, notes=(*A.notes, "the sign was turned, as stated"))


def without_controller(L: FRF, controller: Controller) -> FRF:
    """P = L/C of a loop L = C P that was measured whole under a known controller, with L's error over |C|.

    L is 1 x 1. What the controller's response holds (delay, hold) is divided out with it. Refuses several channels,
    frequencies from half the controller's rate on, and lines at which C is zero.
    """
    if L.response.shape[1:] != (1, 1):
        raise WrongUseError("one controller is divided out of one loop", f"{L.response.shape[1:]} channels", "pick one")
    C = controller.response(L.frequency_hz)[:, None, None]
    if not np.all(np.abs(C) > 0.0):
        bad = L.frequency_hz[np.abs(C[:, 0, 0]) == 0.0][0]
        raise WrongUseError(
            "where the controller is zero the loop tells nothing of the plant", f"at {bad:g} Hz", "leave it out"
        )
    noise = None if L.noise_covariance is None else L.noise_covariance / np.abs(C) ** 2
    return replace(
        L, response=L.response / C, covariance=L.covariance / np.abs(C) ** 2, noise_covariance=noise, input_power=None,
        output_power=None, cross_power=None, rate_hz=L.rate_hz or controller.rate_hz, held_by=controller,
        notes=(*L.notes, "measured as the complete loop: its controller was divided out"),
    )  # fmt: skip
