"""A cascade of biquads, direct form II transposed: compiled, and in the target's own arithmetic.

The latter, operation for operation as an exported step function has it, is plain and not compiled: a compiler that
contracts a product and a sum rounds once less.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from loopshape.core.kernels.compiled import Array, ComplexArray, compiled, compiled_in_line


@compiled_in_line
def step(sections: Array, state: Array, value: float) -> float:
    """One sample through `sections` (n, 5: b0 b1 b2 a1 a2); `state` (n, 2) is moved on in place."""
    for k in range(sections.shape[0]):
        out = sections[k, 0] * value + state[k, 0]
        state[k, 0] = sections[k, 1] * value - sections[k, 3] * out + state[k, 1]
        state[k, 1] = sections[k, 2] * value - sections[k, 4] * out
        value = out
    return value


@compiled
def run(sections: Array, state: Array, signal: Array) -> Array:
    """A whole signal (n,) through the cascade, from `state` on."""
    out = np.empty(signal.size)
    for k in range(signal.size):
        out[k] = step(sections, state, signal[k])
    return out


def response(sections: Array, turn_rad: Array) -> ComplexArray:
    """Response (nf,) of sections (n, 5: b0 b1 b2 a1 a2) at z = exp(j turn).

    With u = 1 - 1/z a polynomial p0 + p1/z + p2/z² is (p0 + p1 + p2) - (p1 + 2 p2) u + p2 u²: near z = 1, where its
    terms cancel, the sum of rounded coefficients is exact.
    """
    half = 0.5 * np.asarray(turn_rad, dtype=float)
    u = 2.0j * np.sin(half) * np.exp(-1j * half)
    out = np.ones_like(u)
    for b0, b1, b2, a1, a2 in sections:
        out = out * (((b0 + b1) + b2) - u * ((b1 + 2.0 * b2) - u * b2))
        out = out / (((1.0 + a1) + a2) - u * ((a1 + 2.0 * a2) - u * a2))
    return np.asarray(out)


def run_floating(sections: Array, inputs: Array, dtype: type[np.floating]) -> np.ndarray:
    """Outputs (n,) of direct form II transposed from rest; every operation rounds to `dtype`."""
    rows = [list(row) for row in sections.astype(dtype)]
    zero = dtype(0.0)
    states = [[zero, zero] for _ in rows]
    out = np.empty(inputs.size, dtype=dtype)
    with np.errstate(all="ignore"):  # as in C, what is too large is infinite
        for k, value in enumerate(inputs.astype(dtype)):
            for (b0, b1, b2, a1, a2), s in zip(rows, states, strict=True):
                answer = b0 * value + s[0]
                s[0] = (b1 * value - a1 * answer) + s[1]
                s[1] = b2 * value - a2 * answer
                value = answer
            out[k] = value
    return out


def error_feedback(a1: float, a2: float) -> tuple[int, int]:
    """How a section's rounding error goes back into its two states: the whole numbers nearest to -a1 and -a2.

    The error then reaches the output through (1 - e1/z - e2/z²)/(1 + a1/z + a2/z²), about 1 at low frequencies, and
    an integrator loses nothing (Thong and Liu, IEEE Trans. ASSP 25, 1977). Without it the error of a slow section is
    multiplied by 1/(1 + a1 + a2), and an integrator stands still at small inputs.
    """
    return round(-a1), round(-a2)


def run_fixed(
    sections: Sequence[Sequence[int]],
    feedback: Sequence[tuple[int, int]],
    inputs: Sequence[int],
    fraction_bits: int,
    limit: int,
) -> list[int]:
    """Integer outputs of integer inputs, from rest: direct form II transposed with error feedback.

    Coefficients are integers times 2^-fraction_bits, states have the unit of a signal times that. A section's output
    is rounded to the nearest integer (halves upwards) and, as the input, clipped to `limit`.
    """
    states = [[0, 0] for _ in sections]
    half, out = 1 << (fraction_bits - 1), []
    for sample in inputs:
        value = min(max(int(sample), -limit), limit)
        for (b0, b1, b2, a1, a2), (e1, e2), s in zip(sections, feedback, states, strict=True):
            exact = b0 * value + s[0]
            answer = (exact + half) >> fraction_bits
            rest = exact - (answer << fraction_bits)
            if abs(answer) > limit:
                answer, rest = (limit if answer > 0 else -limit), 0
            s[0] = b1 * value - a1 * answer + e1 * rest + s[1]
            s[1] = b2 * value - a2 * answer + e2 * rest
            value = answer
        out.append(value)
    return out
