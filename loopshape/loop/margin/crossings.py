"""Where a sampled open loop crosses 0 dB and the negative real axis, between its lines too."""

from __future__ import annotations

import numpy as np

from loopshape.core.units import Array, ComplexArray


def unit_crossings(f: Array, L: ComplexArray) -> tuple[Array, ComplexArray]:
    """Frequencies in Hz and values of L where |L| = 1; between lines ln L is taken as linear in ln f."""
    size = np.log(np.abs(L))
    k = np.flatnonzero(size[:-1] * size[1:] < 0.0)
    share = size[k] / (size[k] - size[k + 1])
    turn = np.angle(L[k + 1] / L[k])
    at = f[k] * (f[k + 1] / f[k]) ** share
    exact = np.flatnonzero(size == 0.0)
    f_all = np.concatenate([at, f[exact]])
    values = np.concatenate([np.exp(1j * (np.angle(L[k]) + share * turn)), L[exact]])
    order = np.argsort(f_all)
    return f_all[order], values[order]


def axis_crossings(f: Array, L: ComplexArray) -> tuple[Array, Array]:
    """Frequencies in Hz and values (negative reals) where L crosses the negative real axis, along chords."""
    k = np.flatnonzero(L.imag[:-1] * L.imag[1:] < 0.0)
    share = L.imag[k] / (L.imag[k] - L.imag[k + 1])
    value = L.real[k] + share * (L.real[k + 1] - L.real[k])
    at = f[k] + share * (f[k + 1] - f[k])
    exact = np.flatnonzero(L.imag == 0.0)
    at, value = np.concatenate([at, f[exact]]), np.concatenate([value, L.real[exact]])
    order = np.argsort(at)
    negative = value[order] < 0.0
    return at[order][negative], value[order][negative]


def chords_to_minus_one(L: ComplexArray) -> tuple[Array, Array]:
    """Distance of each chord of L (..., n) from -1, and at which share of the chord it lies, (..., n - 1) each."""
    start, step = 1.0 + L[..., :-1], np.diff(L)
    with np.errstate(divide="ignore", invalid="ignore"):
        share = np.clip(-(start.real * step.real + start.imag * step.imag) / np.abs(step) ** 2, 0.0, 1.0)
    share = np.where(np.isfinite(share), share, 0.0)
    return np.abs(start + share * step), share
