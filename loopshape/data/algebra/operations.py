"""Products, sums, inverses, parts and closures of FRFs; what they have in common stands in `loopshape.data.algebra`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from numbers import Number
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from loopshape.core.errors import WrongUseError
from loopshape.core.units import Array, ComplexArray
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
    made = invert(A.response, A.frequency_hz, "an FRF")
    return result("inverse", made, A.inputs, A.outputs, [Term(A, -made, made)])


def channels(frf: FRF, outputs: Sequence[str] | None = None, inputs: Sequence[str] | None = None) -> FRF:
    """The outputs and inputs named, in that order (None: all); coherences of other channels are left out."""
    rows = channel_order(frf.outputs, outputs, "part", "the outputs of an FRF") if outputs else range(len(frf.outputs))
    columns = channel_order(frf.inputs, inputs, "part", "the inputs of an FRF") if inputs else range(len(frf.inputs))
    return pick(frf, rows, columns)


def series(A: Any, B: Any) -> FRF:
    """A B: one of them an FRF, the other an FRF, a controller as it runs, or a number; names of one channel may differ.

    Gives NotImplemented for anything else, as the operators of Python want it.
    """
    P = A if isinstance(A, FRF) else B
    other = B if P is A else A
    if isinstance(other, Number):
        k = complex(other)  # type: ignore[call-overload]
        noise = None if P.noise_covariance is None else abs(k) ** 2 * P.noise_covariance
        return replace(
            P, response=k * P.response, covariance=abs(k) ** 2 * P.covariance, noise_covariance=noise,
            input_power=None, output_power=None, cross_power=None,
        )  # fmt: skip
    if isinstance(other, Controller):
        other = controller_frf(other, P.frequency_hz, P.outputs, P.inputs)
    if not isinstance(other, FRF):
        return NotImplemented
    one = P.response.shape[1:] == other.response.shape[1:] == (1, 1)
    return product(*((P, other) if P is A else (other, P)), connect="order" if one else "names")


#: what may stand where a controller is asked for: an FRF, or controllers, each on its own channel
Feedback = FRF | Controller | Sequence[Controller]


@dataclass(frozen=True, eq=False)
class ClosedLoop:
    """What feedback makes of P and K.

    S_o = (I + P K)^-1, T_o = P K S_o, S_i = (I + K P)^-1, T_i = K P S_i, PS = P S_i = S_o P, KS = K S_o = S_i K.
    Each holds the errors of P and K right by itself; between them the errors are those of one P and one K.
    """

    S_o: FRF
    T_o: FRF
    S_i: FRF
    T_i: FRF
    PS: FRF
    KS: FRF


def feedback(P: FRF, K: Feedback, *, connect: str = "names") -> ClosedLoop:
    """The closed loop of a plant and a controller, with the signs of the picture in `loopshape.loop.loop`.

    K's inputs are P's outputs (as errors), its outputs P's inputs. Discrete controllers go with a plant from logged z
    to sampled y, which holds hold and computation; a plant measured as continuous goes through `held` first.
    The closed loop is only what the lines say: whether it is stable is for `loopshape.loop` to count.
    """
    K = _as_frf(K, P.frequency_hz, P.outputs, P.inputs)
    check_operands((P, K), False)
    rows = channel_order(K.outputs, P.inputs, connect, "controller outputs and plant inputs")
    K = pick(K, rows, channel_order(K.inputs, P.outputs, connect, "plant outputs and controller inputs"))
    p, k, f = P.response, K.response, P.frequency_hz
    So = invert(eye(P, 1) + p @ k, f, "I + P K")
    Si = invert(eye(P, 2) + k @ p, f, "I + K P")
    kSo, pSi = k @ So, p @ Si
    y, u = P.outputs, P.inputs

    def made(word: str, response: ComplexArray, to: Sequence[str], by: Sequence[str], of_P: Any, of_K: Any) -> FRF:
        return result(f"{word} of a closed loop", response, to, by, [Term(P, *of_P), Term(K, *of_K)])

    return ClosedLoop(
        S_o=made("S_o", So, y, y, (-So, kSo), (-pSi, So)),
        T_o=made("T_o", p @ kSo, y, y, (So, kSo), (pSi, So)),
        S_i=made("S_i", Si, u, u, (-kSo, Si), (-Si, pSi)),
        T_i=made("T_i", k @ pSi, u, u, (kSo, Si), (Si, pSi)),
        PS=made("P S", pSi, y, u, (So, Si), (-pSi, pSi)),
        KS=made("K S", kSo, u, y, (-kSo, kSo), (Si, So)),
    )


def lower_closure(M: FRF, K: Feedback, *, connect: str = "names") -> FRF:
    """F_l(M, K) = M11 + M12 K (I - M22 K)^-1 M21: K closes M's outputs of its inputs' names onto M's inputs.

    With `connect="order"` the last outputs and inputs of M, as many as K has inputs and outputs. No minus is added.
    Source: Skogestad and Postlethwaite, Multivariable Feedback Control, A.7. Controllers alone need the order.
    """
    return _closure("lower closure", M, K, connect, last=True)


def upper_closure(M: FRF, D: Feedback, *, connect: str = "names") -> FRF:
    """F_u(M, D) = M22 + M21 D (I - M11 D)^-1 M12: D closes the channels of its names, by order the first ones."""
    return _closure("upper closure", M, D, connect, last=False)


def _closure(word: str, M: FRF, given: Feedback, connect: str, *, last: bool) -> FRF:
    if isinstance(given, FRF):
        K = given
    else:
        count = 1 if isinstance(given, Controller) else len(given)
        if connect != "order" or not 0 < count < min(len(M.inputs), len(M.outputs)):
            raise WrongUseError(
                f"bare controllers have no channels for a {word}", f"{count} controllers, connect={connect!r}",
                'make them an FRF with controller_frf, or say connect="order" with fewer than M has channels',
            )  # fmt: skip
        ends = slice(-count, None) if last else slice(None, count)
        K = _as_frf(given, M.frequency_hz, M.outputs[ends], M.inputs[ends])
    check_operands((M, K), False)
    y = _connected(M.outputs, K.inputs, connect, last, f"the outputs of M that a {word} closes")
    u = _connected(M.inputs, K.outputs, connect, last, f"the inputs of M that a {word} closes")
    z, w = ([k for k in range(len(names)) if k not in used] for names, used in ((M.outputs, y), (M.inputs, u)))
    if not (z and w):
        raise WrongUseError(f"a {word} leaves at least one input and one output of M open", f"{M.response.shape[1:]}")
    M = pick(M, [*z, *y], [*w, *u])
    m, k, nz, nw = M.response, K.response, len(z), len(w)
    m11, m12, m21, m22 = m[:, :nz, :nw], m[:, :nz, nw:], m[:, nz:, :nw], m[:, nz:, nw:]
    inner = invert(eye(K, 2) - m22 @ k, M.frequency_hz, "I - M22 K")
    outer = eye(K, 1) + k @ inner @ m22  # (I - K M22)^-1
    X, ones = k @ inner, np.ones((len(m), 1, 1))
    left = np.concatenate([ones * np.eye(nz), m12 @ X], axis=2)
    right = np.concatenate([ones * np.eye(nw), X @ m21], axis=1)
    terms = [Term(M, left, right), Term(K, m12 @ outer, inner @ m21)]
    return result(word, m11 + m12 @ X @ m21, M.outputs[:nz], M.inputs[:nw], terms)


def controller_frf(
    controllers: Controller | Sequence[Controller],
    frequency_hz: ArrayLike,
    inputs: Sequence[str],
    outputs: Sequence[str],
) -> FRF:
    """Diagonal FRF (n, n), without error, of controllers as they run; one input and one output for each.

    `inputs` are what the controllers see: for `feedback` name them as the plant's outputs. Refuses different rates.
    """
    every = (controllers,) if isinstance(controllers, Controller) else tuple(controllers)
    f, rates = np.asarray(frequency_hz, dtype=float), sorted({one.rate_hz for one in every})
    if not every or not len(every) == len(inputs) == len(outputs) or len(rates) > 1:
        raise WrongUseError(
            "controllers of one rate make an FRF, each from one input to one output",
            f"{len(every)} controllers at {rates} Hz, {len(inputs)} inputs, {len(outputs)} outputs",
        )
    response = np.zeros((f.size, len(every), len(every)), dtype=complex)
    for k, one in enumerate(every):
        response[:, k, k] = one.response(f)
    return FRF(
        f, response, np.zeros((f.size, len(every) ** 2, len(every) ** 2), dtype=complex), np.ones(f.size, dtype=bool),
        tuple(inputs), tuple(outputs), f"controllers as they run at {rates[0]:g} Hz",
        loop="+".join(one.loop for one in every), rate_hz=rates[0],
    )  # fmt: skip


def _as_frf(K: Feedback, f: Array, inputs: Sequence[str], outputs: Sequence[str]) -> FRF:
    return K if isinstance(K, FRF) else controller_frf(K, f, inputs, outputs)


def _connected(have: Sequence[str], want: Sequence[str], connect: str, last: bool, what: str) -> list[int]:
    """Numbers of a closure's channels, by name, or the last or first ones by order."""
    if connect != "order":
        return channel_order(have, want, "part" if connect == "names" else connect, what)
    if len(want) > len(have):
        raise WrongUseError(f"{what} are too few", f"{len(have)} for {len(want)}")
    return list(range(len(have)))[-len(want) :] if last else list(range(len(want)))
