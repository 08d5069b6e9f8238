"""Several resonances within a few lines of each other, followed together: poles over one polynomial, fitted jointly.

Where neither noise nor one pole explains a stretch of lines, poles are added one after the other, each where it explains
most of what is left, and all are moved together by Gauss and Newton's steps, the residues following (Golub and Pereyra,
SIAM Journal on Numerical Analysis 10, 1973), until noise alone is left. What is left then bounds a pole sharper still.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.stats import f as f_distribution

from loopshape.core.units import Array, ComplexArray
from loopshape.loop.windows import HALF, ORDER, Windows, window_over

#: less damping than this no resonance is taken to have, as half width over frequency
SHARPEST = 1e-4
#: lines beside a stretch on either side; most poles in one; complex degrees of freedom that a fit must leave
BESIDE, MOST, SPARE = HALF + 2, 6, 4
#: lines are taken to err by this share of |P| at least: what the polynomial rounds off
FLOOR = 1e-4
#: chance that noise leaves more than it should
FALSE_ALARM = 1e-3
#: half widths in gaps, and places in a gap, where the next pole is looked for; steps of all together
_WIDTHS, _PLACES, _STEPS = (0.03, 0.1, 0.3, 1.0, 3.0), np.linspace(0.05, 0.95, 10), 40
#: starts that are followed for each further pole
_STARTS = 3
#: poles that the lines allow lie within so many standard deviations; draws of them, and their seed
REACH, DRAWS, SEED = 3.0, 60, 20073
#: how far in gaps each pole is moved while the others stay
_ASIDE = np.array([-0.5, -0.25, -0.1, -0.03, 0.0, 0.03, 0.1, 0.25, 0.5])


@dataclass(frozen=True, eq=False)
class Crowd:
    """Resonances between lines `first` .. `last` that explain them together, and what may hide beside them.

    m poles at `pole_hz` (nc, m) with `residue` (nc, m) over a `polynomial` (nc, order + 1) in ln f, all times a power of
    f: nc ways that the lines allow, the likeliest first. `hidden` (last - first,), Hz times P, bounds the residue of a
    pole sharper than the lines in each gap: 0 where noise alone is left.
    """

    first: int
    last: int
    window: Windows
    pole_hz: ComplexArray
    residue: ComplexArray
    polynomial: ComplexArray
    hidden: Array

    def response(self, f: Array) -> ComplexArray:
        """P (nc, n) in each way at f (nc, n) in Hz."""
        ends = np.log(self.window.around[0, [0, -1]])
        x = 2.0 * (np.log(f) - ends[0]) / (ends[1] - ends[0]) - 1.0
        made = sum(c[:, None] * x**k for k, c in enumerate(self.polynomial.T))
        for z, r in zip(self.pole_hz.T, self.residue.T, strict=True):
            made = made + r[:, None] / (1j * (f - z[:, None]))
        return np.asarray(made * np.exp(self.window.power[0] * np.log(f / self.window.middle[0])))


def crowds(
    f: Array, P: ComplexArray, variance: Array, freedom: float, rough: np.ndarray, *, unstable: bool = False
) -> tuple[Crowd, ...]:
    """One for each stretch of `rough` gaps (nf - 1,) of lines f (nf,) of P with errors of `variance` (nf,).

    `freedom` is that of each variance; `unstable` says whether the plant may have poles in the right half plane. The
    same lines, the same answer.
    """
    if not rough.any():
        return ()
    seen = f.tobytes(), np.asarray(P, dtype=complex).tobytes(), np.ascontiguousarray(variance).tobytes()
    return _remembered(*seen, float(freedom), rough.tobytes(), unstable)


@lru_cache(maxsize=256)
def _remembered(
    f: bytes, P: bytes, variance: bytes, freedom: float, rough: bytes, unstable: bool
) -> tuple[Crowd, ...]:
    lines = np.frombuffer(f), np.frombuffer(P, dtype=complex), np.frombuffer(variance)
    made = (_crowd(*lines, *ends, freedom, unstable) for ends in stretches(np.frombuffer(rough, dtype=bool)))
    return tuple(one for one in made if one is not None)


def stretches(rough: np.ndarray) -> Iterator[tuple[int, int]]:
    """First and last line of each run of rough gaps, with `BESIDE` lines on either side; those that meet are one."""
    gaps = np.flatnonzero(rough)
    for run in np.split(gaps, np.flatnonzero(np.diff(gaps) > BESIDE) + 1):
        if run.size:
            yield max(int(run[0]) - BESIDE + 1, 0), min(int(run[-1]) + BESIDE, rough.size)


def _crowd(
    f: Array, P: ComplexArray, variance: Array, first: int, last: int, freedom: float, unstable: bool
) -> Crowd | None:
    window = window_over(f, P, variance + (FLOOR * np.abs(P)) ** 2, first, last)
    left = window.rest(window.data[:, :, None])[0, :, 0]
    fit, z = _Fit(window, left, unstable), np.zeros(0, dtype=complex)
    misfit, spare = float(np.sum(np.abs(left) ** 2)), last - first - ORDER
    while z.size < MOST and spare >= SPARE + 2:
        z, spare = fit.with_one_more(z), spare - 2
        misfit = fit.misfit(z)
        if misfit < spare * float(f_distribution.isf(FALSE_ALARM, 2 * spare, 2.0 * min(freedom, 1e9))):
            hidden = np.zeros(last - first)
            break
    else:
        hidden = fit.unexplained(z, max(misfit / max(spare, 1), 1.0))
    if not z.size:
        return None
    pole, residue = fit.allowed(z, max(misfit / spare, 1.0))
    return Crowd(first, last, window, pole, residue, fit.polynomial(pole, residue), hidden)


class _Fit:
    """Poles z (m,) over the polynomial of one window, whose lines `left` (w,) are what the polynomial leaves."""

    def __init__(self, window: Windows, left: ComplexArray, unstable: bool) -> None:
        self.window, self.left, self.unstable = window, left, unstable
        self.f = window.around[0]
        self.gaps = np.diff(self.f)

    def _columns(self, z: ComplexArray, power: int = 1) -> ComplexArray:
        return self.window.pole(z[None, :], power)[0]

    def _beside(self, z: ComplexArray) -> ComplexArray:
        """Orthonormal columns (w, m) of the poles."""
        return np.asarray(np.linalg.qr(self._columns(z))[0])

    def misfit(self, z: ComplexArray) -> float:
        """Squared misfit in units of noise."""
        return float(np.sum(np.abs(_off(self._beside(z), self.left)) ** 2))

    def residues(self, z: ComplexArray) -> ComplexArray:
        """Residues (m,) of least misfit, in units of the reference."""
        return np.asarray(np.linalg.lstsq(self._columns(z), self.left, rcond=None)[0])

    def polynomial(self, z: ComplexArray, r: ComplexArray) -> ComplexArray:
        """Coefficients (nc, order + 1) of what poles z with residues r (nc, m) leave, in powers of x in [-1, 1]."""
        window, x = self.window, np.log(self.f / self.f[0])
        powers = (2.0 * x / x[-1] - 1.0)[:, None] ** np.arange(ORDER + 1) * window.weight[0][:, None]
        poles = np.einsum("cm,cmw->cw", r, 1.0 / (1j * (self.f - z[:, :, None]))) * window.weight[0]
        return np.asarray(np.linalg.lstsq(powers, (window.data[0] - poles).T, rcond=None)[0].T)

    def with_one_more(self, z: ComplexArray) -> ComplexArray:
        """The best poles (m + 1,) that grow from z (m,)."""
        Q, every = self._beside(z), self._everywhere()
        column = self._columns(every)
        column = column - Q @ (Q.conj().T @ column)
        drop = np.abs(column.conj().T @ self.left) ** 2 / np.maximum(np.sum(np.abs(column) ** 2, axis=0), 1e-300)
        drop, every = drop.reshape(-1, len(_WIDTHS)), every.reshape(-1, len(_WIDTHS))
        best = every[np.argmax(drop, axis=0), range(len(_WIDTHS))]  # of each width
        found = [self._improved(np.append(z, best[k])) for k in np.argsort(-drop.max(axis=0))[:_STARTS]]
        return min(found, key=self.misfit)

    def _everywhere(self) -> ComplexArray:
        """Places in all gaps, each with all half widths: (n,)."""
        centre = self.f[:-1, None] + self.gaps[:, None] * _PLACES
        width = np.repeat(self.gaps[:, None], _PLACES.size, axis=1)
        return np.asarray((centre[..., None] + 1j * width[..., None] * np.array(_WIDTHS)).ravel())

    def possible(self, z: ComplexArray) -> ComplexArray:
        """Poles within the window, no sharper than any resonance is, and stable where the plant is."""
        centre = np.clip(z.real, self.f[0], self.f[-1])
        size = np.maximum(np.abs(z.imag) if self.unstable else z.imag, SHARPEST * centre)
        return np.asarray(centre + 1j * np.where(self.unstable & (z.imag < 0.0), -size, size))

    def _bent(self, z: ComplexArray) -> ComplexArray:
        """What moving each pole changes (w, m), beside what polynomial and residues make up for."""
        return np.asarray(_off(self._beside(z), 1j * self._columns(z, 2) * self.residues(z)))

    def _improved(self, z: ComplexArray) -> ComplexArray:
        """Gauss and Newton's steps for all poles, each halved until it improves."""
        best = self.misfit(z)
        for _ in range(_STEPS):
            step = np.linalg.lstsq(self._bent(z), _off(self._beside(z), self.left), rcond=1e-9)[0]
            step *= min(1.0, float(np.min(2.0 * np.median(self.gaps) / np.maximum(np.abs(step), 1e-300))))
            for _ in range(8):
                tried = self.possible(z + step)
                now = self.misfit(tried)
                if now < best:
                    break
                step *= 0.5
            else:
                return z
            z, best, gained = tried, now, best - now
            if gained < 1e-3 * max(1.0, 1e-3 * best):
                return z
        return z

    def unexplained(self, z: ComplexArray, noise: float) -> Array:
        """Largest residue (gaps,) of a sharp pole in each gap by what poles z leave, with three of its deviations."""
        Q, centre = self._beside(z), self.f[:-1, None] + self.gaps[:, None] * _PLACES
        bent = np.linalg.qr(np.concatenate([Q, self._bent(z)], axis=1))[0]
        rest = _off(Q, self.left)
        column = _off(bent, self._columns(centre.ravel() + 0.01j * np.repeat(self.gaps, _PLACES.size)))
        size = np.maximum(np.sum(np.abs(column) ** 2, axis=0), 1e-300)
        bound = np.abs(column.conj().T @ rest) / size + REACH * np.sqrt(0.5 * noise / size)
        scale = np.abs(self.window.reference(centre.reshape(1, -1)))[0]
        return np.asarray((bound * scale).reshape(-1, _PLACES.size).max(axis=1))

    def allowed(self, z: ComplexArray, noise: float) -> tuple[ComplexArray, ComplexArray]:
        """Poles and residues (nc, m) that the lines allow: z, draws about it, and each pole moved alone."""
        most = self.misfit(z) + noise * (REACH**2 + 2.0 * z.size)
        every = [self.possible(one) for one in (*self._drawn(z, noise), *self._one_moved(z))]
        kept = [z, *(one for one in every if self.misfit(one) < most)]
        pairs = [(one, r) for one in kept for r in self._residues_drawn(one, noise)]
        return np.array([one for one, _ in pairs]), np.array([r for _, r in pairs])

    def _drawn(self, z: ComplexArray, noise: float) -> ComplexArray:
        """Draws (draws, m) of the poles by the errors of the lines."""
        R = np.linalg.qr(self._bent(z))[1]
        white = _white(np.random.default_rng(SEED), (DRAWS, z.size))
        moved = np.sqrt(noise) * (np.linalg.pinv(R, rcond=1e-9) @ white.T).T
        return np.asarray(z + np.linspace(0.3, 2.0, DRAWS)[:, None] * moved)

    def _one_moved(self, z: ComplexArray) -> Iterator[ComplexArray]:
        for k, one in enumerate(z):
            gap = float(np.interp(one.real, self.f[:-1], self.gaps))
            widths = np.geomspace(SHARPEST * one.real, 4.0 * gap, 13) * (-1.0 if one.imag < 0.0 else 1.0)
            for centre in one.real + gap * _ASIDE:
                for width in (one.imag, *widths):
                    yield np.concatenate([z[:k], [complex(centre, width)], z[k + 1 :]])

    def _residues_drawn(self, z: ComplexArray, noise: float) -> Iterator[ComplexArray]:
        """The residues for poles z, and two draws of their error."""
        r, R = self.residues(z), np.linalg.qr(self._columns(z))[1]
        yield r
        for one in _white(np.random.default_rng(SEED + 1), (2, z.size)):
            yield r + np.sqrt(noise) * (np.linalg.pinv(R, rcond=1e-12) @ one)


def _white(rng: np.random.Generator, shape: tuple[int, ...]) -> ComplexArray:
    """Circular draws with E|d|² = 1."""
    return np.asarray((rng.standard_normal(shape) + 1j * rng.standard_normal(shape)) / np.sqrt(2.0))


def _off(Q: ComplexArray, columns: ComplexArray) -> ComplexArray:
    """What orthonormal columns Q (w, m) leave of columns (w, ...)."""
    return np.asarray(columns - Q @ (Q.conj().T @ columns))
