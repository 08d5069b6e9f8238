"""Relative gain array of a square FRF, with its deviation."""

from __future__ import annotations

import numpy as np

from loopshape.core.errors import WrongUseError
from loopshape.core.units import Array, ComplexArray
from loopshape.data.algebra.propagation import invert
from loopshape.data.frf import FRF
from loopshape.data.interaction import RelativeGain


def relative_gain(frf: FRF) -> RelativeGain:
    """RGA = H .* inv(H)^T of a square FRF; refuses others, and one that is singular at a line.

    With G = inv(H), dG = -G dH G, so d RGA_ij = G_ji dH_ij - H_ij sum over k, l of G_jk dH_kl G_li.
    Source: Bristol, IEEE Trans. Automatic Control 11, 1966; dynamic as in Skogestad and Postlethwaite, 3.4.
    """
    if len(frf.inputs) != len(frf.outputs):
        raise WrongUseError(
            "relative gains are those of a square FRF", f"{len(frf.outputs)} x {len(frf.inputs)}", "pick channels"
        )
    H = frf.response
    G = invert(H, frf.frequency_hz, "a FRF")
    gain = H * G.transpose(0, 2, 1)
    std = np.stack([_deviation(h, g, c) for h, g, c in zip(H, G, frf.covariance, strict=True)])
    return RelativeGain(frf.outputs, frf.inputs, frf.frequency_hz, gain, std, frf.trusted)


def _deviation(H: ComplexArray, G: ComplexArray, C: ComplexArray) -> Array:
    """sqrt(E|d RGA|²) (n, n) at one line, from the covariance C of vec(H), columns stacked."""
    n = H.shape[0]
    slope = -np.einsum("ij,jk,li->ijlk", H, G, G)  # by element i, j and by dH_kl, l slowest as in vec
    i, j = np.indices((n, n))
    slope[i, j, j, i] += G.T
    J = slope.reshape(n * n, n * n)
    variance = np.real(np.einsum("ab,bc,ac->a", J, C, J.conj(), optimize=True))
    return np.sqrt(np.maximum(variance, 0.0)).reshape(n, n)
