"""A cascade of biquads, direct form II transposed."""

from __future__ import annotations

import numpy as np

from loopshape.core.kernels.compiled import compiled, compiled_in_line
from loopshape.core.kernels.types import Array


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
