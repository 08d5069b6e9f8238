"""A cascade of biquads, direct form II transposed, and its response."""

from __future__ import annotations

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
