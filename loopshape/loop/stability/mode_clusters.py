"""Several resonances within a few lines of each other, followed together: poles over one polynomial, fitted jointly.

Where neither noise nor one pole explains a stretch of lines, poles are added one after the other, each where it
explains most of what is left, and all are moved together by Gauss and Newton's steps, the residues following (Golub
and Pereyra, SIAM Journal on Numerical Analysis 10, 1973), until noise alone is left. What is left then bounds a pole
sharper still. Where no pole explains more than chance would, the lines scatter: that is an error of theirs.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from enum import Enum
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from scipy.special import fdtrc, fdtri

from loopshape.core.units import TWO_PI, Array, ComplexArray
from loopshape.loop.stability.windows import Windows, window_over
from loopshape.loop.tolerances import TOL

#: less damping than this no resonance is taken to have, as half width over frequency
SHARPEST = 1e-4
#: lines beside a stretch on either side; most poles in one; complex degrees of freedom that a fit must leave
BESIDE, MOST, SPARE = TOL.window_lines + 2, 6, 4
#: highest order of the polynomial over many lines; poles wider than so many gaps are resolved by the lines
STEEPEST, RESOLVED = 6, 2.0
#: a delay is taken out where a polynomial's squared misfit falls by so many times
DELAYED = 10.0
#: half widths in gaps, and places in a gap, where the next pole is looked for; steps of all together
_WIDTHS, _PLACES, _STEPS = (0.03, 0.1, 0.3, 1.0, 3.0), np.linspace(0.05, 0.95, 10), 40
#: two sharp poles within so many gaps of each other may be three
SAME = 0.5
#: ways of residues and polynomial for each pole that is moved alone
OF_REST = 3
#: seed of the draws of what residues and polynomial may be
SEED = 20074
#: what a fit rounds off, as a share of residue and half width
UNEXACT = 0.01
#: how far in gaps each pole is moved while the others stay
_OFFSETS_GAPS = np.array([-0.5, -0.25, -0.1, -0.03, 0.0, 0.03, 0.1, 0.25, 0.5])


class Residual(Enum):
    """What poles leave of a stretch of lines: noise, more than it, or as much as chance, where they explain nothing."""

    NOISE = "noise"
    MORE = "more"
    SCATTER = "scatter"


class ClusterBand(NamedTuple):
    """Lines `first` .. `last` about gaps that neither noise nor one pole explains, and those fitted on with them."""

    first: int
    last: int
    low: int
    high: int


@dataclass(frozen=True, eq=False)
class ModeCluster:
    """Resonances between lines `first` .. `last` that explain them together, and what may hide beside them.

    m poles at `pole_hz` (nc, m) with `residue` (nc, m) over a `polynomial` (nc, order + 1) in ln f, all times a
    power of f and behind a delay: nc ways that the lines allow, the likeliest first, in single precision as the page of
    `shape` is given them. `hidden` (last - first,), Hz
    times P, bounds the residue of a pole sharper than the lines in each gap: 0 where noise alone is `left`. Lines
    that scatter have no pole.
    """

    first: int
    last: int
    window: Windows
    delay_s: float
    pole_hz: ComplexArray
    residue: ComplexArray
    polynomial: ComplexArray
    hidden: Array
    left: Residual

    def response(self, f: Array, ways: np.ndarray) -> ComplexArray:
        """P (n, k) in some `ways` (n,) at f (n, k) in Hz."""
        ends = np.log(self.window.around[0, [0, -1]])
        x = 2.0 * (np.log(f) - ends[0]) / (ends[1] - ends[0]) - 1.0
        made = np.zeros(f.shape, dtype=complex)
        for c in self.polynomial[ways].T[::-1]:
            made *= x
            made += c[:, None]
        for z, r in zip(self.pole_hz[ways].T, -1j * self.residue[ways].T, strict=True):
            made += r[:, None] / (f - z[:, None])
        late = 1j * TWO_PI * self.delay_s * (f - self.window.around[0, 0])
        made *= np.exp(self.window.power[0] * np.log(f / self.window.middle[0]) - late)
        return made


def cluster_bands(f: Array, residual: np.ndarray) -> Iterator[ClusterBand]:
    """One for each run of rough gaps (nf - 1,), fitted on with `BESIDE` lines aside, an octave at most, ten in all."""
    gaps = np.flatnonzero(residual)
    for run in np.split(gaps, np.flatnonzero(np.diff(gaps) > BESIDE) + 1):
        if run.size:
            first, last = int(run[0]), int(run[-1]) + 1
            low, high = np.searchsorted(f, [0.5 * f[first], 2.0 * f[last]])
            low, high = max(first - BESIDE + 1, int(low)), min(last + BESIDE - 1, int(high), residual.size)
            low = max(min(low, high + 1 - 2 * TOL.window_lines), 0)
            yield ClusterBand(first, last, low, min(max(high, low - 1 + 2 * TOL.window_lines), residual.size))


def interpolation_residual(f: Array, P: ComplexArray, variance: Array, stretch: ClusterBand) -> float:
    """How far the lines of a stretch leave a polynomial at most, in |P|.

    The residue of a pole in a gap is no larger than that times the gap: its tails would be.
    """
    window, _ = _window(f, P, variance, stretch)
    left = window.rest(window.data[:, :, None])[0, :, 0]
    return float(np.max(np.abs(left * window.reference(window.around)[0] / window.weight[0])))


def _window(f: Array, P: ComplexArray, variance: Array, stretch: ClusterBand) -> tuple[Windows, float]:
    """The lines of a stretch, and the delay in s taken out of them where that alone explains most of them."""
    order = int(np.clip(TOL.window_order + (stretch.high - stretch.low - 12) // 4, TOL.window_order, STEEPEST))
    rows = slice(stretch.low, stretch.high + 1)
    turn = np.angle(P[rows][1:] * P[rows][:-1].conj()) / np.diff(f[rows])
    delays = 0.0, float(-np.median(turn)) / TWO_PI
    floor = 1e-5  # lines are taken to err by this share of |P| at least: what the polynomial rounds off
    found = [
        (window_over(f, P * np.exp(1j * TWO_PI * delay * (f - f[stretch.low])), variance + (floor * np.abs(P)) ** 2,
                     stretch.low, stretch.high, order), delay)
        for delay in delays
    ]  # fmt: skip
    without, late = found
    return late if DELAYED * _misfit(late[0]) < _misfit(without[0]) else without


def _misfit(window: Windows) -> float:
    """Squared misfit of the polynomial alone."""
    return float(np.sum(np.abs(window.rest(window.data[:, :, None])) ** 2))


def cluster_of(
    f: Array, P: ComplexArray, variance: Array, freedom: float, stretch: ClusterBand, *, unstable: bool = False
) -> ModeCluster:
    """What explains a stretch of lines f (nf,) of P with errors of `variance` (nf,).

    `freedom` is that of each variance; `unstable` says whether the plant may have poles in the right half plane. The
    same lines, the same answer.
    """
    seen = f.tobytes(), np.asarray(P, dtype=complex).tobytes(), np.ascontiguousarray(variance).tobytes()
    return _remembered(*seen, float(freedom), stretch, unstable)


@lru_cache(maxsize=256)
def _remembered(
    f: bytes, P: bytes, variance: bytes, freedom: float, stretch: ClusterBand, unstable: bool
) -> ModeCluster:
    lines = np.frombuffer(f), np.frombuffer(P, dtype=complex), np.frombuffer(variance)
    window, delay_s = _window(*lines, stretch)
    fit = _Fit(window, float(lines[0][stretch.first]), float(lines[0][stretch.last]), unstable)
    slack = window.around.size - window.basis.shape[2]
    z, left = fit.grown(slack, 2.0 * min(freedom, 1e9))
    noise = max(fit.misfit(z) / max(slack - 2 * z.size, 1), 1.0)
    hidden = fit.one_of_several(z)
    if left is Residual.MORE:
        hidden = np.maximum(fit.unexplained(z, noise), hidden)
    poles, coefficients = (x.astype(np.complex64).astype(complex) for x in fit.allowed(z, noise))
    residue, polynomial = coefficients[:, : z.size], coefficients[:, z.size :]
    return ModeCluster(stretch.low, stretch.high, window, delay_s, poles, residue, polynomial, hidden, left)


class _Fit:
    """Poles z (m,) over the polynomial of one window; those off `low` .. `high` Hz are no sharper than two gaps."""

    def __init__(self, window: Windows, low: float, high: float, unstable: bool) -> None:
        self.window, self.low, self.high, self.unstable = window, low, high, unstable
        self.left = window.rest(window.data[:, :, None])[0, :, 0]
        self.f = window.around[0]
        self.gaps = np.diff(self.f)
        self.looks = float(np.log(TOL.tests_per_gap * self.gaps.size))

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

    def grown(self, slack: int, freedom: float) -> tuple[ComplexArray, Residual]:
        """The fewest poles that leave no more than noise, and whether any do; polynomials leave `slack` lines.

        None where they explain no more than chance would: the lines scatter.
        """
        z, first, quiet = np.zeros(0, dtype=complex), slack, False
        none = before = self.misfit(z)
        least = 0.0
        while z.size < MOST and slack >= (SPARE + 2 if z.size else 3):
            one_more = self.with_one_more(z)
            misfit = self.misfit(one_more)
            if quiet and before - misfit < TOL.one_more_pole + self.looks:
                break
            z, slack, before = one_more, slack - 2, misfit
            quiet = misfit < slack * float(fdtri(2 * slack, freedom, 1.0 - TOL.pole_by_chance))
            least = min(least, self._chance(none / misfit, z.size, slack))
        if first >= TOL.scatter_freedom and none < TOL.scatter_variances * first and least > np.log(TOL.pole_by_chance):
            return z[:0], Residual.SCATTER
        return z, Residual.NOISE if quiet else Residual.MORE

    def _chance(self, fell: float, poles: int, slack: int) -> float:
        """Logarithm of the chance that the misfit of lines without `poles` falls so many times and `slack` are left."""
        gained = max((fell - 1.0) * slack / (2 * poles), 0.0)
        with np.errstate(divide="ignore"):
            return float(np.log(fdtrc(4 * poles, 2 * slack, gained))) + poles * self.looks

    def with_one_more(self, z: ComplexArray) -> ComplexArray:
        """The best poles (m + 1,) that grow from z (m,)."""
        Q, every = self._beside(z), self._everywhere()
        column = _off(Q, self._columns(every.ravel()))
        drop = np.abs(column.conj().T @ self.left) ** 2 / np.maximum(np.sum(np.abs(column) ** 2, axis=0), 1e-300)
        drop = drop.reshape(every.shape)
        best = every[range(len(every)), np.argmax(drop, axis=1)]  # of each width
        starts = 3  # starts that are followed for each further pole
        found = [self._improved(np.append(z, best[k])) for k in np.argsort(-drop.max(axis=1))[:starts]]
        return min(found, key=self.misfit)

    def _everywhere(self) -> ComplexArray:
        """Poles (widths, n) of each half width at places in all gaps."""
        widths = np.array(_WIDTHS + tuple(-w for w in _WIDTHS if self.unstable))
        centre = (self.f[:-1, None] + self.gaps[:, None] * _PLACES).ravel()
        return self.possible(centre + 1j * widths[:, None] * np.repeat(self.gaps, _PLACES.size))

    def possible(self, z: ComplexArray) -> ComplexArray:
        """Poles within the window, no sharper than any resonance is, and stable where the plant is."""
        centre = np.clip(z.real, self.f[0], self.f[-1])
        gap = np.interp(centre, self.f[:-1], self.gaps)
        aside = (centre < self.low - gap) | (centre > self.high + gap)
        sharpest = np.where(aside, RESOLVED * gap, SHARPEST * centre)
        size = np.maximum(np.abs(z.imag) if self.unstable else z.imag, sharpest)
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
            if gained < 1e-3 * max(1.0, best):
                return z
        return z

    def unexplained(self, z: ComplexArray, noise: float) -> Array:
        """Largest residue (gaps,) of a sharp pole in each gap by what poles z leave, with three of its deviations."""
        Q, centre = self._beside(z), self.f[:-1, None] + self.gaps[:, None] * _PLACES
        bent = np.linalg.qr(np.concatenate([Q, self._bent(z)], axis=1))[0]
        rest = _off(Q, self.left)
        column = _off(bent, self._columns(centre.ravel() + 0.01j * np.repeat(self.gaps, _PLACES.size)))
        size = np.maximum(np.sum(np.abs(column) ** 2, axis=0), 1e-300)
        bound = np.abs(column.conj().T @ rest) / size + TOL.pole_radius_std * np.sqrt(0.5 * noise / size)
        scale = np.abs(self.window.reference(centre.reshape(1, -1)))[0]
        bound = (bound * scale).reshape(-1, _PLACES.size).max(axis=1)
        return np.where((self.f[1:] > self.low) & (self.f[:-1] < self.high), bound, 0.0)

    def one_of_several(self, z: ComplexArray) -> Array:
        """Largest residue (gaps,) of sharp poles within `SAME` gaps of each other, which lines cannot count."""
        size = np.abs(self.residues(z) * self.window.reference(z.real[None])[0])
        gap, hidden = np.interp(z.real, self.f[:-1], self.gaps), np.zeros(self.gaps.size)
        sharp = np.abs(z.imag) < SAME * gap
        near = (np.abs(z.real[:, None] - z.real) < SAME * gap) & sharp & sharp[:, None] & ~np.eye(z.size, dtype=bool)
        for k in np.flatnonzero(near.any(axis=1)):
            at = int(np.clip(np.searchsorted(self.f, z[k].real) - 1, 0, hidden.size - 1))
            hidden[at] = max(hidden[at], size[k])
        return hidden

    def allowed(self, z: ComplexArray, noise: float) -> tuple[ComplexArray, ComplexArray]:
        """Ways that the lines allow: poles (nc, m), and coefficients (nc, m + order + 1) of poles and polynomial.

        The likeliest, each pole moved alone, and what the fit rounds off.
        """
        moved = self.possible(np.array([z, *self._one_moved(z)]))
        most = noise * (TOL.pole_radius_std**2 + 2.0 * z.size)
        near = moved[self._misfits(moved) <= self.misfit(z) * (1.0 + 1e-9) + most]
        best, *drawn = self._coefficients(near, noise)
        off = UNEXACT * np.exp(0.25j * TWO_PI * np.arange(4))[:, None]
        rounded = np.concatenate([np.broadcast_to(z, (4, z.size)), self.possible(z + off * np.abs(z.imag))])
        r = best[0, : z.size] * np.concatenate([1.0 + off, np.ones_like(off)])
        given = np.concatenate([r, self._polynomial(rounded, r)], axis=1)
        poles = np.concatenate([*[near] * OF_REST, rounded])
        return poles, np.concatenate([best, *drawn, given])

    def _misfits(self, z: ComplexArray) -> Array:
        """Squared misfits (nc,) of poles z (nc, m) in units of noise."""
        columns = self.window.weight[0][:, None] / (1j * (self.f[:, None] - z[:, None, :]))
        Q = np.linalg.qr(_off(self.window.basis[0], columns))[0]
        along = np.einsum("cwm,w->cm", Q.conj(), self.left)
        return np.asarray(np.sum(np.abs(self.left) ** 2) - np.sum(np.abs(along) ** 2, axis=1))

    def _columns_of(self, z: ComplexArray) -> tuple[ComplexArray, Array]:
        """Weighted columns of poles z (nc, m) and of the polynomial: (nc, w, m) and (w, order + 1)."""
        x, weight = np.log(self.f / self.f[0]), self.window.weight[0][:, None]
        powers = (2.0 * x / x[-1] - 1.0)[:, None] ** np.arange(self.window.basis.shape[2])
        return np.asarray(weight / (1j * (self.f[:, None] - z[:, None, :]))), powers * weight

    def _polynomial(self, z: ComplexArray, r: ComplexArray) -> ComplexArray:
        """What is left to the polynomial by poles z with residues r (nc, m): (nc, order + 1)."""
        poles, powers = self._columns_of(z)
        left = self.window.data[0] - np.einsum("cwm,cm->cw", poles, r)
        return np.asarray(np.linalg.lstsq(powers, left.T, rcond=None)[0].T)

    def _coefficients(self, z: ComplexArray, noise: float) -> ComplexArray:
        """Those of least misfit for poles z (nc, m), and draws of their error: (1 + draws, nc, m + order + 1)."""
        poles, powers = self._columns_of(z)
        columns = np.concatenate([poles, np.broadcast_to(powers, (len(z), *powers.shape))], axis=2)
        size = np.sqrt(np.sum(np.abs(columns) ** 2, axis=1))
        inverse = np.linalg.pinv(columns / size[:, None, :], rcond=1e-12)
        best = inverse @ self.window.data[0]
        white = _white(np.random.default_rng(SEED), (OF_REST - 1, len(z), self.f.size))
        errors = np.sqrt(noise) * np.einsum("ckw,dcw->dck", inverse, white)
        return np.asarray((best + np.concatenate([np.zeros_like(errors[:1]), errors])) / size)

    def _one_moved(self, z: ComplexArray) -> Iterator[ComplexArray]:
        for k, one in enumerate(z):
            gap = float(np.interp(one.real, self.f[:-1], self.gaps))
            widths = np.append(np.geomspace(SHARPEST * one.real, 4.0 * gap, 13), abs(one.imag))
            for centre in one.real + gap * _OFFSETS_GAPS:
                for width in (*widths, *(-widths if self.unstable else ())):
                    yield np.concatenate([z[:k], [complex(centre, width)], z[k + 1 :]])


def _white(rng: np.random.Generator, shape: tuple[int, ...]) -> ComplexArray:
    """Circular draws with E|d|² = 1."""
    return np.asarray((rng.standard_normal(shape) + 1j * rng.standard_normal(shape)) / np.sqrt(2.0))


def _off(Q: ComplexArray, columns: ComplexArray) -> ComplexArray:
    """What orthonormal columns Q (w, m) leave of columns (w, ...)."""
    return np.asarray(columns - Q @ (Q.conj().T @ columns))
