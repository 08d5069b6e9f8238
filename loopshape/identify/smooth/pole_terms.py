"""Resonances as narrow as a few lines, taken out of a response before it is smoothed and put back after.

About each one a pole over a polynomial is fitted to a window of lines by Gauss and Newton's steps, all others held.
Pole and residue follow the lines' errors linearly, and so does what they add between the lines.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from loopshape.core.units import Array, ComplexArray
from loopshape.data.response.frf import FRF
from loopshape.identify.smooth.resonances import Phase, Resonance, resonances
from loopshape.identify.tolerances import TOL

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
    narrow = 6.0  # resonances whose half width is above this many gaps between lines are smooth enough by themselves
    found = [x for x in resonances(frf) if abs(x.pole_hz.imag) < narrow * np.interp(x.frequency_hz, f, gap)]
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
        size = np.linalg.norm(A, axis=0)  # the pole's column has the unit of P, the others have none
        step = np.linalg.lstsq(A / size, (y[rows] - one.response(f[rows])) / std[rows], rcond=1e-12)[0] / size
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
    size = np.linalg.norm(A, axis=0)
    inverse = np.linalg.pinv(A / size, rcond=1e-12) / size[:, None]
    rest = left[rows] / std[rows]
    rest = rest - A @ (inverse @ rest)
    misfit = float(np.sum(np.abs(rest) ** 2)) / max(rest.size - A.shape[1], 1)
    excess = float(np.sqrt(max(TOL.rounding_counts * misfit if misfit > TOL.noise_misfit else misfit, 1.0)))
    return np.asarray(excess * inverse[:2] / std[rows])


def _columns(one: Resonance, f: Array) -> ComplexArray:
    x = 2.0 * (f - f[0]) / (f[-1] - f[0]) - 1.0
    return np.concatenate([_slopes(f, one.residue, one.pole_hz), x[:, None] ** np.arange(ORDER + 1)], axis=1)


def _slopes(f: Array, residue: complex, z: complex) -> ComplexArray:
    """Of r/(j (f - z)), by r and by z: (n, 2)."""
    across = 1.0 / (np.asarray(f) - z)
    return np.stack([-1j * across, -1j * residue * across**2], axis=1)


@dataclass(frozen=True, eq=False)
class CommonPole:
    """A pole that the elements of a matrix share: one z, and in each element a residue (m,).

    `influence` (m, m, nf) turns errors of all lines of all elements into those of each residue, `moves` (m, nf) into
    that of the pole.
    """

    pole_hz: complex
    residue: ComplexArray
    influence: ComplexArray
    moves: ComplexArray

    @property
    def places_hz(self) -> Array:
        """Frequencies (81,) in Hz over its peak."""
        return self.pole_hz.real + abs(self.pole_hz.imag) * PLACES

    def response(self, f: Array) -> ComplexArray:
        """Its part of all elements at f (n,): (n, m)."""
        return np.asarray(_slopes(f, 1.0, self.pole_hz)[:, :1] * self.residue)

    def drawn(self, errors: ComplexArray) -> tuple[ComplexArray, ComplexArray]:
        """What errors (draws, nf, m) of all lines do to the residues (draws, m) and to the pole (draws,)."""
        residues = np.einsum("ekf,dfk->de", self.influence, errors, optimize=True)
        return residues, np.einsum("kf,dfk->d", self.moves, errors, optimize=True)

    def deviations(self, f: Array, drawn: tuple[ComplexArray, ComplexArray], k: int) -> ComplexArray:
        """What draws do to its part of the k-th element at f (n,): (draws, n)."""
        by_residue, by_pole = _slopes(f, 1.0, self.pole_hz).T
        return np.asarray(np.outer(drawn[0][:, k], by_residue) + np.outer(drawn[1] * self.residue[k], by_pole))


def common_poles(elements: Sequence[FRF], variance: Array) -> tuple[CommonPole, ...]:
    """Narrow resonances of a matrix's elements, those at one place as one; `variance` (nf, m) is the elements'.

    The place is the mean of the elements' that show it, weighted by how well they tell it; with it each element gives
    its residue, one that shows another pole beside it none.
    """
    shown = [(k, term) for k, one in enumerate(elements) for term in pole_terms(one, variance[:, k])]
    shown.sort(key=lambda x: x[1].resonance.pole_std_hz)
    groups: list[list[tuple[int, PoleTerm]]] = []
    for k, term in shown:
        near = next((g for g in groups if _near(g[0][1].resonance, term.resonance, 1.0 / 3.0)), None)
        if near is None:
            groups.append([(k, term)])
        elif k not in [other for other, _ in near]:
            near.append((k, term))
    found = []
    for group in groups:
        beside = (x for x in groups if x is not group and _near(x[0][1].resonance, group[0][1].resonance, 1.0))
        others = {k for x in beside for k, _ in x} - {k for k, _ in group}
        found.append(_common(group, elements, variance, others))
    return tuple(found)


def _near(one: Resonance, other: Resonance, share: float) -> bool:
    """Whether two poles lie no farther apart than a share of the wider one's half width, and their spread."""
    widths = share * max(abs(one.pole_hz.imag), abs(other.pole_hz.imag))
    spread = 3.0 * (one.pole_std_hz + other.pole_std_hz)
    return abs(one.frequency_hz - other.frequency_hz) < widths + spread


def _common(
    group: Sequence[tuple[int, PoleTerm]], elements: Sequence[FRF], variance: Array, without: set[int]
) -> CommonPole:
    f, m = elements[0].frequency_hz, len(elements)
    weight = np.array([1.0 / max(term.resonance.pole_std_hz, 1e-12) ** 2 for _, term in group])
    weight = weight / weight.sum()
    z = complex(sum(w * term.resonance.pole_hz for w, (_, term) in zip(weight, group, strict=True)))
    moves, influence = np.zeros((m, f.size), dtype=complex), np.zeros((m, m, f.size), dtype=complex)
    for w, (k, term) in zip(weight, group, strict=True):
        moves[k, term.resonance.first : term.resonance.last + 1] += w * term.influence[1]
    one = group[0][1].resonance
    rows = slice(one.first, one.last + 1)
    x = 2.0 * (f[rows] - f[one.first]) / (f[one.last] - f[one.first]) - 1.0
    basis = np.concatenate([_slopes(f[rows], 1.0, z)[:, :1], x[:, None] ** np.arange(ORDER + 1)], axis=1)
    residue = np.zeros(m, dtype=complex)
    for k, element in enumerate(elements):
        if k in without:
            continue
        y = element.siso[rows]
        std = np.sqrt(variance[rows, k] + (FLOOR * np.abs(y)) ** 2 + 1e-300)
        inverse = np.linalg.pinv(basis / std[:, None], rcond=1e-12)[0] / std
        residue[k] = inverse @ y
        influence[k, k, rows] += inverse
        influence[k] -= complex(inverse @ _slopes(f[rows], complex(residue[k]), z)[:, 1]) * moves
    return CommonPole(z, residue, influence, moves)
