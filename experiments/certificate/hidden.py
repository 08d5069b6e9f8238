"""Poles between lines: how often one is found where there is none, and how often where there is one."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from loops import LINEAR, LOGARITHMIC, between

from loopshape.core.units import TWO_PI, Array, ComplexArray
from loopshape.data.response.model import TransferFunction
from loopshape.loop.stability.sampling import between_lines

RECORDS = 1000
WIDTHS, TAILS = (0.03, 0.1, 0.3, 1.0), (2.0, 4.0, 6.0, 8.0, 12.0, 20.0)


def smooth(rng: np.random.Generator, f: Array) -> ComplexArray:
    """A plant without resonances: an integrator or two, real poles and zeros, a delay."""
    integrators = int(rng.integers(0, 3))
    num, den = np.ones(1), np.ones(1)
    for _ in range(2):
        num = np.polymul(num, [1.0 / (TWO_PI * between(rng, 0.5, 30.0)), 1.0])
        den = np.polymul(den, [1.0 / (TWO_PI * between(rng, 0.5, 30.0)), 1.0])
    return TransferFunction(num, np.concatenate([den, np.zeros(integrators)]), between(rng, 0.001, 0.02)).response(f)


def errors(rng: np.random.Generator, size: int, overlap: int) -> ComplexArray:
    """Circular errors of unit E|d|², means of `overlap` independent ones."""
    white = rng.standard_normal(size + overlap - 1) + 1j * rng.standard_normal(size + overlap - 1)
    return np.asarray(np.convolve(white, np.full(overlap, np.sqrt(0.5 / overlap)), "valid"))


def alarms() -> Iterator[list]:
    """Records of smooth plants in which a pole was found."""
    for name, f in (("linear", LINEAR), ("logarithmic", LOGARITHMIC)):
        for noise, overlap in ((1e-6, 1), (0.02, 1), (0.1, 1), (0.1, 2), (0.1, 4)):
            rng, count = np.random.default_rng(3), 0
            for _ in range(RECORDS):
                P = smooth(rng, f)
                variance = (noise * np.abs(P)) ** 2
                noisy = P + np.sqrt(variance) * errors(rng, f.size, overlap)
                count += bool(between_lines(f, noisy, variance).poles)
            yield [name, noise, overlap, RECORDS, count]


def detection() -> Iterator[list]:
    """Poles of a width and with tails of a size, half a gap away, in deviations of the noise, that were found."""
    f = LINEAR
    for noise in (0.02, 0.1):
        for width in WIDTHS:
            for tail in TAILS:
                rng, count, held = np.random.default_rng(4), 0, 0
                for _ in range(RECORDS // 5):
                    P = smooth(rng, f)
                    k = int(rng.integers(60, 250))
                    gap, size = f[k + 1] - f[k], noise * abs(P[k])
                    centre, w = f[k] + rng.uniform(0.05, 0.95) * gap, width * gap
                    r = tail * size * 0.5 * gap * np.exp(1j * rng.uniform(0.0, TWO_PI))
                    variance = (noise * np.abs(P)) ** 2
                    noisy = P + r / (1j * (f - centre) + w) + np.sqrt(variance) * errors(rng, f.size, 1)
                    found = between_lines(f, noisy, variance).poles
                    near = [x for x in found if x.low_hz - gap < centre < x.high_hz + gap]
                    count += bool(near)
                    held += bool(near) and near[0].peak >= 0.99 * abs(r) / w
                yield [noise, width, tail, RECORDS // 5, count, held]
