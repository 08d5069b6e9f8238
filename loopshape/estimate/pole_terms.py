"""Resonances as narrow as a few lines, taken out of a response before it is smoothed and put back after.

About each one a pole over a polynomial is fitted to a window of lines by Gauss and Newton's steps, all others held.
Pole and residue follow the lines' errors linearly, and so does what they add between the lines.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from loopshape.estimate.resonances import Phase, Resonance, resonances
from loopshape.frf import FRF
from loopshape.units import Array, ComplexArray

#: resonances whose half width is above this many gaps between lines are smooth enough by themselves
NARROW = 6.0
#: order of the polynomial beside the pole; rounds over all poles, steps in each
ORDER, ROUNDS, STEPS = 3, 3, 4
#: places where a narrow resonance is read between lines, in half widths
PLACES = np.tan(np.linspace(-1.45, 1.45, 81))
#: lines are taken to err by this share of |P| at least
FLOOR = 1e-6


@dataclass(frozen=True, eq=False)
class PoleTerm:
    """A resonance and how its residue and pole move with errors of its lines: `influence` (2, lines)."""

    resonance: Resonance
    influence: ComplexArray

    @property
    def places_hz(self) -> Array:
        """Frequencies (81,) in Hz over its peak."""
        return self.resonance.frequency_hz + abs(self.resonance.pole_hz.imag) * PLACES

    def deviations(self, f: Array, errors: ComplexArray) -> ComplexArray:
        """What errors (draws, nf) of all lines do to the term at f (n,): (draws, n)."""
        one = self.resonance
        moved = errors[:, one.first : one.last + 1] @ self.influence.T
        return np.asarray(moved @ _slopes(f, one.residue, one.pole_hz).T)


def pole_terms(frf: FRF, variance: Array) -> tuple[PoleTerm, ...]:
    """Narrow resonances of a 1 x 1 FRF with errors of `variance` (nf,), fitted together; none where none is seen."""
    f, y = frf.frequency_hz, frf.siso
    gap = np.gradient(f) if f.size > 1 else np.ones(1)
    found = [x for x in resonances(frf) if abs(x.pole_hz.imag) < NARROW * np.interp(x.frequency_hz, f, gap)]
    std = np.sqrt(variance + (FLOOR * np.abs(y)) ** 2 + 1e-300)
    for _ in range(ROUNDS if len(found) > 1 else 1):
        for k, one in enumerate(found):
            others = sum((x.response(f) for x in found if x is not one), np.zeros(f.size, dtype=complex))
            found[k] = _improved(one, f, y - others, std)
    whole = sum((x.response(f) for x in found), np.zeros(f.size, dtype=complex))
    return tuple(PoleTerm(x, _influence(x, f, y - whole, std)) for x in found)


def _improved(one: Resonance, f: Array, y: ComplexArray, std: Array) -> Resonance:
    rows = slice(one.first, one.last + 1)
    for _ in range(STEPS):
        A = _columns(one, f[rows]) / std[rows, None]
        step = np.linalg.lstsq(A, (y[rows] - one.response(f[rows])) / std[rows], rcond=1e-12)[0]
        z = one.pole_hz + complex(np.clip(abs(step[1]), 0.0, 0.5 * abs(one.pole_hz.imag))) * np.sign(step[1])
        one = _moved(one, one.residue + complex(step[0]), complex(z))
    return one


def _moved(one: Resonance, residue: complex, z: complex) -> Resonance:
    width = -z.imag if one.phase is Phase.RISING else z.imag
    width = max(width, 0.2 * abs(one.pole_hz.imag))
    return replace(one, frequency_hz=z.real, damping=width / z.real, residue=residue)


def _influence(one: Resonance, f: Array, left: ComplexArray, std: Array) -> ComplexArray:
    """Rows for residue and pole; what the window leaves over counts as noise where it is more than the lines' own."""
    rows = slice(one.first, one.last + 1)
    A = _columns(one, f[rows]) / std[rows, None]
    inverse = np.linalg.pinv(A, rcond=1e-12)
    rest = left[rows] / std[rows]
    rest = rest - A @ (inverse @ rest)
    excess = np.sqrt(max(float(np.sum(np.abs(rest) ** 2)) / max(rest.size - A.shape[1], 1), 1.0))
    return np.asarray(excess * inverse[:2] / std[rows])


def _columns(one: Resonance, f: Array) -> ComplexArray:
    x = 2.0 * (f - f[0]) / (f[-1] - f[0]) - 1.0
    return np.concatenate([_slopes(f, one.residue, one.pole_hz), x[:, None] ** np.arange(ORDER + 1)], axis=1)


def _slopes(f: Array, residue: complex, z: complex) -> ComplexArray:
    """Of r/(j (f - z)), by r and by z: (n, 2)."""
    across = 1.0 / (np.asarray(f) - z)
    return np.stack([-1j * across, -1j * residue * across**2], axis=1)
