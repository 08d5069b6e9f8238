"""Resonances between the lines of a measured plant, found by the tails that they leave on the lines beside them.

A pole at f0 with half width w adds r/(j (f - f0) + w) to the plant. Where w is much less than the spacing no line
meets its peak, but the lines around see r/(j (f - f0)) over a plant that is smooth otherwise: local rationals show it
(McKelvey and Guerin, SYSID 2012).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from scipy.special import fdtri

from loopshape.core.units import Array, ComplexArray
from loopshape.identify import tolerances as estimates
from loopshape.loop.stability.mode_clusters import SHARPEST, UNEXACT
from loopshape.loop.stability.windows import Windows, windows_of
from loopshape.loop.tolerances import TOL

#: wider than this a pole is resolved by the lines, in gaps
RESOLVED = 2.0
#: what is left of lines counts where it is more than this share of |P|
ROUGH = 0.005
#: where a pole is looked for first: places in the gap and half widths, in gaps
_PLACES, _WIDTHS = (0.03, 0.12, 0.3, 0.5, 0.7, 0.88, 0.97), (0.03, 0.3, 1.0)


@dataclass(frozen=True, eq=False)
class HiddenPole:
    """A pole whose tails are seen on the lines about `low_hz` .. `high_hz`, between which it lies, and not its peak.

    `pole_hz` is the likeliest z, centre + j half width, of r/(j (f - z)) with its `residue`; `peak`, in the unit of P,
    the largest |r|/half width that these lines allow. `significance` is the drop of the squared misfit in units of the
    noise.
    """

    low_hz: float
    high_hz: float
    pole_hz: complex
    residue: complex
    peak: float
    significance: float


class BetweenLines(NamedTuple):
    """What lines tell of what lies between them, gap by gap (nf - 1,); fewer than ten lines tell nothing.

    `poles` have their tails on the lines. Not found are one whose tails lie below the noise, two within a few lines of
    each other, and any in the first and the last gap. `visible_residue`, Hz times P, is the size from which a sharp
    pole's residue amid a gap is found in 99.9 % of cases, infinite where no pole is looked for.

    `roughness` is what is left of the lines about a gap, as |P|, where neither noise nor one pole explains it; else 0.
    Two resonances within a few lines leave it, or lines so coarse that nothing between them can be told. Not where ten
    lines span two octaves, as the lowest of an even grid do. `scattered` are rough gaps at which lines scatter all
    along, more than their variance says: no resonance does that, but friction and play do, the same way in every
    period.
    """

    poles: tuple[HiddenPole, ...]
    visible_residue: Array
    roughness: Array
    scattered: np.ndarray


def between_lines(
    f: Array, P: ComplexArray, variance: Array, freedom: float = np.inf, *, unstable: bool = False
) -> BetweenLines:
    """What lines f (nf,) in Hz of a plant P (nf,) with errors of `variance` E|d|² (nf,) tell.

    `freedom` is that of each variance; `unstable` says whether the plant may have poles in the right half plane. Errors
    that neighbouring lines share do no harm; lines that were smoothed on purpose have lost tails: give raw ones.
    """
    seen = f.tobytes(), np.asarray(P, dtype=complex).tobytes(), np.ascontiguousarray(variance).tobytes()
    return _remembered(*seen, float(freedom), unstable)


@lru_cache(maxsize=256)
def _remembered(f: bytes, P: bytes, variance: bytes, freedom: float, unstable: bool) -> BetweenLines:
    """All answers for a plant, which is asked about under many controllers."""
    lines = np.frombuffer(f)
    if lines.size < 2 * TOL.window_lines:
        none = np.zeros(max(lines.size - 1, 0))
        return BetweenLines((), np.full(none.size, np.inf), none, none > 0.0)
    windows = windows_of(lines, np.frombuffer(P, dtype=complex), np.frombuffer(variance))
    share = TOL.pole_by_chance / (TOL.tests_per_gap * windows.gap.size)
    freedom = min(freedom, 1e9)
    threshold = float(fdtri(2, freedom, 1.0 - share))
    significance, visible, misfit = _screen(windows)
    found = [_pole(windows[int(k)], threshold, unstable) for k in np.flatnonzero(significance > threshold)]
    poles = _apart([pole for pole in found if pole is not None])
    free = TOL.window_freedom
    residual = _unexplained(windows, poles, misfit, free * float(fdtri(2 * free, freedom, 1.0 - share)))
    visible = (np.sqrt(threshold) + TOL.found_std) * visible
    visible[[0, -1]] = np.inf
    scatter = _scattered(windows, misfit, residual)
    for made in (visible, residual, scatter):
        made.setflags(write=False)
    return BetweenLines(poles, visible, residual, scatter)


def _screen(windows: Windows) -> tuple[Array, Array, Array]:
    """Drop of the squared misfit by the best pole in each gap (n,), in units of the noise and of what is left.

    And the standard deviation of a sharp pole's residue amid the gap (n,), and the squared misfit left (n,).
    """
    left = windows.rest(windows.data[:, :, None])
    drop, deviation = np.zeros(windows.gap.size), np.zeros(windows.gap.size)
    for width in _WIDTHS:
        z = windows.low[:, None] + windows.gap[:, None] * (np.array(_PLACES) + 1j * width)
        drops, _, variance = _explained(windows, left, z)
        drop = np.maximum(drop, drops.max(axis=1))
        deviation = np.sqrt(variance[:, len(_PLACES) // 2]) if width == _WIDTHS[0] else deviation
    misfit = (np.abs(left[:, :, 0]) ** 2).sum(1) - drop
    noise = np.maximum(misfit / TOL.window_freedom, 1.0)
    drop[[0, -1]] = 0.0  # beyond one line alone, which an error of its own explains as well
    scale = np.abs(windows.reference(windows.low + 0.5 * windows.gap))
    return drop / noise, deviation * scale * np.sqrt(noise), misfit


def _unexplained(windows: Windows, poles: tuple[HiddenPole, ...], misfit: Array, limit: float) -> Array:
    """Root mean square (n,) of what one pole leaves of windows whose `misfit` (n,) is above a limit, else 0."""
    residual = np.zeros(misfit.size)
    known = np.array([x.pole_hz for x in poles], dtype=complex)
    widest = 4.0  # lines from f to so many times f and more are no neighbours whom one polynomial should follow
    narrow, free = windows.around[:, -1] < widest * windows.around[:, 0], TOL.window_freedom
    for k in np.flatnonzero(narrow & (misfit > limit) & (np.sqrt(misfit / free) * windows.std > ROUGH * windows.size)):
        window = windows[int(k)]
        left = window.rest(window.data[:, :, None])
        before = float((np.abs(left) ** 2).sum())
        enough = max(limit, free * float((ROUGH * window.size[0] / window.std[0]) ** 2))
        tried = known[(known.real > window.around[0, 0]) & (known.real < window.around[0, -1])]
        if tried.size and before - _explained(window, left, tried[None, :])[0].max() < enough:
            continue
        z = _improved(window, left, _start(window, left, beside=TOL.window_lines - 0.5))
        rest = before - _explained(window, left, np.array([[z]]))[0][0, 0]
        if rest > enough or abs(z.imag) < RESOLVED * window.gap[0]:
            residual[k] = np.sqrt(max(rest, limit) / free) * window.std[0]
    return residual


def _scattered(windows: Windows, misfit: Array, residual: Array) -> np.ndarray:
    """At which rough gaps (n,) most windows about, of other lines, leave much too, by their `misfit` (n,)."""
    scatter = residual > 0.0
    off = np.arange(2 * TOL.window_lines, TOL.scatter_gaps)
    gaps = np.flatnonzero(scatter)[:, None] + np.concatenate([-off[::-1], off])  # of a million lines few are rough
    about = (gaps >= 0) & (gaps < residual.size)
    apart = TOL.scatter_comparable * residual[scatter] / windows.std[scatter]
    least = np.maximum(apart**2, estimates.TOL.noise_misfit) * TOL.window_freedom
    left = misfit[np.clip(gaps, 0, residual.size - 1)]
    count, alike = about.sum(axis=1), (about & (left > least[:, None])).sum(axis=1)
    scatter[scatter] = (count > TOL.scatter_gaps // 2) & (alike > TOL.scatter_share * count)
    return np.asarray(scatter)


def _noise(misfit: Array) -> Array:
    """Power of the errors in units of the variance, by what a pole leaves over; one at least.

    Much more than noise leaves is what the polynomial rounds off. It looks like a pole more often than noise does, and
    counts for more.
    """
    left = misfit / TOL.window_freedom
    rounded = estimates.TOL.rounding_counts * left
    return np.maximum(np.where(left > estimates.TOL.noise_misfit, rounded, left), 1.0)


def _explained(windows: Windows, left: ComplexArray, z: ComplexArray) -> tuple[Array, ComplexArray, Array]:
    """Drop of the squared misfit, residue in units of the reference, and its variance, for poles z (n, j)."""
    column = windows.pole(z)
    size = np.maximum((np.abs(column) ** 2).sum(1), 1e-300)
    along = (column.conj() * left).sum(1)
    return np.abs(along) ** 2 / size, np.asarray(along / size), 1.0 / size


def _pole(window: Windows, threshold: float, unstable: bool) -> HiddenPole | None:
    """The pole that explains one window, where it is significant, in or beside its gap, and not resolved."""
    left, gap = window.rest(window.data[:, :, None]), float(window.gap[0])
    z = _possible(_improved(window, left, _start(window, left)), unstable)
    drop, r, variance = _explained(window, left, np.array([[z]]))
    noise = float(_noise((np.abs(left) ** 2).sum() - drop[0, 0]))
    if drop[0, 0] < threshold * noise or not -0.2 * gap < z.real - window.low[0] < 1.2 * gap:
        return None
    slope = np.abs(r[0, 0]) * np.sqrt((np.abs(_bent(window, z)) ** 2).sum())
    spread = TOL.pole_radius_std * float(np.sqrt(noise) / slope)
    if abs(z.imag) - spread > RESOLVED * gap:
        return None
    spread = min(spread, float(window.around[0, -1] - window.around[0, 0]))
    residue = complex(r[0, 0] * np.exp(window.power[0] * np.log(z / window.middle[0])))
    error = UNEXACT + TOL.pole_radius_std * float(np.sqrt(0.5 * noise * variance[0, 0]) / np.abs(r[0, 0]))
    narrowest = max((1.0 - UNEXACT) * abs(z.imag) - spread, SHARPEST * z.real)
    return HiddenPole(
        low_hz=float(min(window.low[0], z.real - spread)),
        high_hz=float(max(window.low[0] + gap, z.real + spread)),
        pole_hz=z,
        residue=residue,
        peak=(1.0 + error) * abs(residue) / narrowest,
        significance=float(drop[0, 0] / noise),
    )


def _possible(z: complex, unstable: bool) -> complex:
    """The pole, no sharper than any resonance is, and stable where the plant is."""
    sharpest = SHARPEST * abs(z.real)
    size = max(abs(z.imag), sharpest) if unstable else max(z.imag, sharpest)
    return complex(z.real, -size if unstable and z.imag < 0.0 else size)


def _start(window: Windows, left: ComplexArray, beside: float = 0.45) -> complex:
    """The best of a grid of poles in the gap and as many gaps beside it."""
    gap = float(window.gap[0])
    count = 2 * round(20.0 * (0.5 + beside)) + 1
    places, widths = np.meshgrid(np.linspace(-beside, 1.0 + beside, count), [0.003, 0.03, 0.1, 0.3, 0.6, 1.0, 2.0, 4.0])
    z = window.low[0] + gap * (places + 1j * widths).ravel()
    return complex(z[np.argmax(_explained(window, left, z[None, :])[0])])


def _bent(window: Windows, z: complex) -> ComplexArray:
    """What neither polynomials nor the pole itself explain of the change 1/(j (f - z))² when the pole moves, (w,)."""
    column, change = window.pole(np.array([[z]]))[0, :, 0], window.pole(np.array([[z]]), 2)[0, :, 0]
    return np.asarray(change - column * (column.conj() @ change) / np.sum(np.abs(column) ** 2))


def _improved(window: Windows, left: ComplexArray, z: complex, steps: int = 12) -> complex:
    """Gauss and Newton's steps for the pole z, the residue following; each halved until it improves."""

    def drop(at: complex) -> float:
        return float(_explained(window, left, np.array([[at]]))[0][0, 0])

    best = drop(z)
    for _ in range(steps):
        _, r, _ = _explained(window, left, np.array([[z]]))
        change = _bent(window, z) * r[0, 0] * 1j
        step = complex((change.conj() @ left[0, :, 0]) / np.sum(np.abs(change) ** 2))
        for _ in range(6):
            now = drop(z + step)
            if now > best:
                break
            step *= 0.5
        else:
            return z
        z, best, gained = z + step, now, now - best
        if gained < 1e-3:
            return z
    return z


def _apart(poles: list[HiddenPole]) -> tuple[HiddenPole, ...]:
    """The most significant first; those that lie in the same gap are the same."""
    kept: list[HiddenPole] = []
    for pole in sorted(poles, key=lambda x: -x.significance):
        if all(pole.pole_hz.real > x.high_hz or pole.pole_hz.real < x.low_hz for x in kept):
            kept.append(pole)
    return tuple(sorted(kept, key=lambda x: x.low_hz))
