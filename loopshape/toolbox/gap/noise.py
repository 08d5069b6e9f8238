"""Gaussian noise inside kernels, the same in compiled and plain code and on every machine.

Marsaglia's multiply-with-carry, 32 bits out of a 63-bit state, so that plain Python integers and compiled
64-bit ones agree; normal values by Box and Muller (1958), two at a time.
"""

from __future__ import annotations

import math

import numpy as np

from loopshape.core.kernels.compiled import compiled_in_line

MULTIPLIER = 1791398085
LOW = 0xFFFFFFFF


@compiled_in_line
def advance(state: int) -> int:
    """Next state of the generator."""
    return MULTIPLIER * (state & LOW) + (state >> 32)


@compiled_in_line
def normal_pair(state: int) -> tuple[int, float, float]:
    """State after two draws, and two independent standard normal values."""
    state = advance(state)
    radius = math.sqrt(-2.0 * math.log(((state & LOW) + 0.5) / 4294967296.0))
    state = advance(state)
    angle = 6.283185307179586 * (((state & LOW) + 0.5) / 4294967296.0)
    return state, radius * math.cos(angle), radius * math.sin(angle)


def start_state(seed: int, stream: int = 0) -> int:
    """A generator's state from a seed and a stream number: well mixed, never zero."""
    words = np.random.SeedSequence([seed, stream]).generate_state(2)
    return (int(words[0]) % (MULTIPLIER - 2) + 1) << 32 | int(words[1])
