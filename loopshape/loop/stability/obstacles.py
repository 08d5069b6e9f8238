"""What keeps the lines of a loop from carrying a count of encirclements, and the band to measure for it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import ndtr

from loopshape.core.units import TWO_PI, Array, ComplexArray
from loopshape.identify import tolerances as estimates
from loopshape.identify.spectra.averages import pooled_variance
from loopshape.loop.loop import Loop, slope_at_end
from loopshape.loop.margin.between import (
    Path,
    chords_to_minus_one,
    turns_past_cluster,
    without_narrow,
)
from loopshape.loop.stability.holes import hole
from loopshape.loop.stability.mode_clusters import (
    BESIDE,
    SHARPEST,
    ClusterBand,
    ModeCluster,
    Residual,
    cluster_bands,
    cluster_of,
    interpolation_residual,
)
from loopshape.loop.stability.sampling import BetweenLines, HiddenPole, between_lines
from loopshape.loop.tolerances import TOL

#: a band to measure goes on beyond the lines in question by this factor
WIDER = 1.05
#: nearer to -1 than this a chord says nothing
ON_IT = 1e-3


@dataclass(frozen=True)
class Undecided:
    """Why a count cannot be given, and the band in Hz to measure, None where measuring does not help.

    `finer` tells that the lines there lie too far apart; else they are too uncertain, or there are none.
    """

    reason: str
    band_hz: tuple[float, float] | None = None
    finer: bool = False


@dataclass(frozen=True, eq=False)
class Sampling:
    """What lies between lines and not on a path along them: whole turns of 1 + L, and gaps (nf - 1,) past resonances.

    Of several that stand close together all that they may be was looked at. One alone may turn 1 + L where its peak in
    L, the diameter of its circle, is larger than the path's distance from -1: that is left open.

    `unclear` is the first gap where the lines allow several answers, None where there is none.
    """

    turns: int
    interpolated: np.ndarray
    unclear: Undecided | None

    def past(self, path: Path) -> np.ndarray:
        """Places (n,) of a path within such gaps, its lines not among them."""
        if not self.interpolated.size:
            return np.zeros(path.f.size, dtype=bool)
        gap = np.clip(np.cumsum(path.line) - 1, 0, self.interpolated.size - 1)
        return np.asarray(~path.line & self.interpolated[gap])


def sampling(loop: Loop, path: Path) -> Sampling:
    """Turns of 1 + L past resonances of the plant that lines and `path` step over."""
    f = loop.frequency_hz
    clusters = _clusters(loop, path)
    turns, interpolated, unclear = _past_clusters(loop, path, [x for x in clusters if x.left is not Residual.SCATTER])
    for pole in hidden_in(loop):
        first = int(np.clip(np.searchsorted(f, pole.low_hz, side="right") - 1, 0, f.size - 2))
        last = int(np.clip(np.searchsorted(f, pole.high_hz), first + 1, f.size - 1))
        gaps, gap = slice(first, last), np.clip(np.searchsorted(f, pole.pole_hz.real) - 1, 0, f.size - 2)
        if interpolated[gap] or pole.peak * _larger(np.abs(loop.C))[gaps].max() <= _nearest(path)[gaps].min():
            continue
        interpolated[gaps] = True
        unclear = unclear or Undecided(
            f"a resonance between {f[first]:.4g} and {f[last]:.4g} Hz, sharper than the lines, may or may not"
            " encircle -1: measure finer there",
            (float(f[first]), float(f[last])),
            True,
        )
    return Sampling(
        turns, interpolated, unclear or _scatters(loop, path, [x for x in clusters if x.left is Residual.SCATTER])
    )


def _past_clusters(loop: Loop, path: Path, clusters: Sequence[ModeCluster]) -> tuple[int, np.ndarray, Undecided | None]:
    """Turns past resonances that stand close together, gaps (nf - 1,) where they do, what is unclear of them."""
    f, C, unclear = loop.frequency_hz, _larger(np.abs(loop.C)), None
    turns, interpolated = 0, np.zeros(max(f.size - 1, 0), dtype=bool)
    for cluster in clusters:
        least, most, near, sure = turns_past_cluster(cluster, loop, path)
        gaps, turns = slice(cluster.first, cluster.last), turns + least
        interpolated[gaps] = True
        hidden = np.flatnonzero(C[gaps] * cluster.hidden > SHARPEST * f[gaps] * near)
        if unclear is None and hidden.size:
            unclear = _unexplained(float(f[cluster.first + hidden[0]]), float(f[cluster.first + hidden[-1] + 1]))
        elif unclear is None and (least != most or not sure):
            low, high = float(f[cluster.first]), float(f[cluster.last])
            reason = f"resonances between {low:.4g} and {high:.4g} Hz, close together, may or may not encircle -1"
            unclear = Undecided(f"{reason}: measure finer there", (low, high), True)
    return turns, interpolated, unclear


def _scatters(loop: Loop, path: Path, clusters: Sequence[ModeCluster]) -> Undecided | None:
    """Gaps about which lines that scatter lie so near -1 that their error, a disk about them, holds it."""
    f, (residual, scatter) = loop.frequency_hz, interpolation_residuals(loop)
    for cluster in clusters:
        scatter[cluster.first : cluster.last] = True
    if not scatter.any():
        return None
    gaps = np.flatnonzero(TOL.scatter_std * _larger(np.abs(loop.C)) * np.where(scatter, residual, 0.0) > _nearest(path))
    return _unexplained(float(f[gaps[0]]), float(f[gaps[-1] + 1])) if gaps.size else None


def _larger(values: Array) -> Array:
    """The larger of the values (nf,) on either side of each gap (nf - 1,)."""
    return np.asarray(np.maximum(values[1:], values[:-1]))


def _nearest(path: Path) -> Array:
    """How near a path comes to -1 in each gap between lines (nf - 1,)."""
    return np.asarray(np.minimum.reduceat(chords_to_minus_one(path.L)[0], np.flatnonzero(path.line)[:-1]))


def _unexplained(low_hz: float, high_hz: float) -> Undecided:
    reason = f"neither noise nor resonances explain the lines between {low_hz:.4g} and {high_hz:.4g} Hz"
    return Undecided(f"{reason}: measure finer there", (low_hz, high_hz), True)


def may_be_oscillatory(loop: Loop) -> bool:
    """Whether a pair of the plant's poles may lie in the right half plane."""
    return loop.unstable_poles is None or loop.unstable_poles > 1


def _spread(loop: Loop) -> tuple[Array, float]:
    """Variance (nf,) of the measured lines and its degrees of freedom, pooled where few are known."""
    lines = loop.measured
    return pooled_variance(lines), max(lines.variance_freedom, estimates.TOL.decided_freedom)


def _between(loop: Loop) -> BetweenLines:
    """What the measured lines of a loop's plant tell of what lies between them, whatever its controller."""
    rest = without_narrow(loop)
    return between_lines(loop.frequency_hz, rest, *_spread(loop), unstable=may_be_oscillatory(loop))


def hidden_in(loop: Loop) -> tuple[HiddenPole, ...]:
    """Resonances between the lines of a loop's plant, by their tails."""
    return _between(loop).poles


def _clusters(loop: Loop, path: Path) -> list[ModeCluster]:
    """Resonances close together that might encircle -1, of measured lines: a narrow one may have been several."""
    found = cluster_bands_in(loop)
    if not found:
        return []
    f, near = loop.frequency_hz, _nearest(path)
    radius = _larger(np.abs(loop.C)) * np.minimum(np.diff(f) / (SHARPEST * f[:-1]), TOL.unseen_peak)
    return [
        cluster_in(loop, band)
        for band in found
        if np.any((polynomial_residual(loop, band) * radius > near)[band.low : band.high])
    ]


def cluster_bands_in(loop: Loop) -> tuple[ClusterBand, ...]:
    """Stretches of a loop's measured lines that neither noise nor one pole explains, whatever its controller."""
    return tuple(cluster_bands(loop.frequency_hz, _not_one(loop)))


def polynomial_residual(loop: Loop, band: ClusterBand) -> float:
    """How far the lines of a stretch leave a polynomial at most, in |P|."""
    return interpolation_residual(loop.frequency_hz, loop.measured.siso, _spread(loop)[0], band)


def cluster_in(loop: Loop, band: ClusterBand) -> ModeCluster:
    """What explains the lines of a stretch, whatever the controller."""
    unstable = may_be_oscillatory(loop)
    return cluster_of(loop.frequency_hz, loop.measured.siso, *_spread(loop), band, unstable=unstable)


def interpolation_residuals(loop: Loop) -> tuple[Array, np.ndarray]:
    """How far from its lines P may come in each gap (nf - 1,) that no one pole explains, and where lines scatter."""
    return _between(loop).roughness, np.array(_between(loop).scattered)


def _not_one(loop: Loop) -> np.ndarray:
    """Gaps (nf - 1,) about which neither noise nor one pole explains the lines, and poles beside these."""
    f, (size, scatter) = loop.frequency_hz, interpolation_residuals(loop)
    residual = np.where(scatter, 0.0, size) > 0.0
    if residual.any():
        narrow = () if loop.scatter is None else loop.scatter.pole_hz.real
        known = np.concatenate([[pole.pole_hz.real for pole in hidden_in(loop)], narrow])
        gaps = np.clip(np.searchsorted(f, known) - 1, 0, residual.size - 1)
        beside = np.convolve(residual, np.ones(2 * BESIDE + 1), "same")[: residual.size] > 0.0
        residual[gaps[beside[gaps]]] = True
    return residual


def obstacles(loop: Loop, path: Path, between: Sampling, before: complex) -> Iterator[Undecided]:
    """What keeps the lines from carrying a count; 1 + L comes from `before` to the first line."""
    return (x for x in _obstacles(loop, path, between, before) if x is not None)


def _obstacles(loop: Loop, path: Path, between: Sampling, before: complex) -> Iterator[Undecided | None]:
    yield _too_short(loop, loop.L, loop.frequency_hz)
    yield _rises_above(loop)
    yield comes_up_again(loop)
    yield on_it(path, between)
    freedom = loop.plant.variance_freedom if loop.raw is None else np.inf
    yield doubt(path, between, before if loop.model is None else None, freedom)
    yield between.unclear
    missing = hole(loop)
    yield None if missing is None else Undecided(*missing, finer=True)


def _too_short(loop: Loop, L: ComplexArray, f: Array) -> Undecided | None:
    if abs(L[-1]) < 1.0:
        return None
    top = min(f[-1] * (2.0 * abs(L[-1])) ** (1.0 / max(slope_at_end(f, L), 1.0)), 0.5 * loop.controller.rate_hz)
    reason = f"|L| is still {abs(L[-1]):.2g} at the last line, {f[-1]:.3g} Hz: measure higher"
    return Undecided(reason, (float(f[-1]), max(float(top), float(f[-1]))))


def _rises_above(loop: Loop) -> Undecided | None:
    if loop.rise_above < 1.0:
        return None
    last = float(loop.frequency_hz[-1])
    reason = f"the controller rises above the last line, {last:.3g} Hz: |L| may reach {loop.rise_above:.2g} there"
    return Undecided(f"{reason}; measure higher", (last, float(loop.above_hz[-1])))


def comes_up_again(loop: Loop) -> Undecided | None:
    """Where |L| reaches 1 above the lines used, as far as less sure lines there show it."""
    if loop.beyond is None:
        return None
    f = loop.beyond.frequency_hz
    f = f[f < 0.5 * loop.controller.rate_hz]
    size = np.abs(loop.controller.response(f) * loop.beyond.siso[: f.size])
    if not size.size or size.max() < 1.0:
        return None
    k = int(np.argmax(size))
    reason = f"|L| reaches {size[k]:.2g} at {f[k]:.3g} Hz, above the band that is known well: excite more there"
    return Undecided(reason, _around(f, np.flatnonzero(size >= 1.0)))


def on_it(path: Path, between: Sampling) -> Undecided | None:
    """A place where the path passes -1 so near that nothing tells on which side."""
    past = between.past(path)
    near = np.where(past[1:] | past[:-1], np.inf, chords_to_minus_one(path.L)[0])
    if not near.size or near.min() >= ON_IT:
        return None
    k = int(np.argmin(near))
    at = path.f[k] + chords_to_minus_one(path.L)[1][k] * (path.f[k + 1] - path.f[k])
    return Undecided(f"L passes -1 within {near[k]:.1g} at {at:.3g} Hz", _lines_beside(path, at), True)


def doubt(
    path: Path, between: Sampling, before: complex | None, freedom: float, curve: str = "L", point: str = "-1"
) -> Undecided | None:
    """Places where errors may carry the path over -1: one whose 95 % circle holds it, or all of them together.

    Where L starts on the real axis, at `before` - 1, that start is as unsure as the first line.
    """
    std = path.std
    chord = np.concatenate([[np.inf], chords_to_minus_one(path.L)[0], [np.inf]])
    near = np.minimum(np.abs(1.0 + path.L), np.minimum(chord[1:], chord[:-1]))
    radius = np.where(between.past(path), np.inf, radius_of(near, std, freedom))
    if before is not None:
        radius[0] = min(radius[0], float(radius_of(np.array([before]), std[:1], freedom)[0]))
    k = int(np.argmin(radius))
    if radius[k] < TOL.radius_95:
        low, high = _lines_beside(path, float(path.f[k]))
        if not path.line[k] and std[k] > TOL.uncertain_ratio * float(std[np.searchsorted(path.f, [low, high])].max()):
            reason = (
                f"{curve} bends too much between {low:.4g} and {high:.4g} Hz to tell on which side it passes {point}"
            )
            return Undecided(f"{reason}: measure finer there", (low, high), True)
        reason = f"{point} lies within the uncertainty of {curve} at {path.f[k]:.3g} Hz: measure longer or excite more"
        return Undecided(reason, _around(path.f, np.flatnonzero(radius < TOL.radius_95)))
    chance, share = chance_of_error(radius, path.alike)
    if chance <= TOL.wrong_count:
        return None
    reason = (
        f"errors of {curve} may carry it over {point} (chance {100.0 * chance:.1g} %): measure longer or excite more"
    )
    return Undecided(reason, _around(path.f, np.flatnonzero(share >= 0.1 * share.max())))


def _lines_beside(path: Path, at_hz: float) -> tuple[float, float]:
    """The lines on either side of a place of a path, in Hz."""
    lines = path.f[path.line]
    k = int(np.clip(np.searchsorted(lines, at_hz), 1, lines.size - 1))
    return float(lines[k - 1]), float(lines[k])


def _around(f: Array, lines: np.ndarray) -> tuple[float, float]:
    """From the first to the last of some lines in Hz, with a line more on either side or as far as `WIDER`."""
    low, high = f[max(int(lines[0]) - 1, 0)], f[min(int(lines[-1]) + 1, f.size - 1)]
    return float(max(min(low, f[lines[0]] / WIDER), f[0])), float(min(max(high, f[lines[-1]] * WIDER), f[-1]))


def radius_of(g: ComplexArray, std: Array, freedom: float = np.inf) -> Array:
    """|g| (nf,) in standard deviations sqrt E|d|² of a circular error, inf where there is none.

    A deviation that was itself estimated, with `freedom` degrees, counts for less: |d|² follows an F distribution with
    2 and `freedom` degrees, and the reach given is that of equal chance of a normal error.
    """
    with np.errstate(divide="ignore"):
        radius = np.abs(g) / np.where(std > 0.0, std, np.nan)
    radius = np.nan_to_num(radius, nan=np.inf)
    return np.asarray(np.sqrt(0.5 * freedom * np.log1p(2.0 * radius**2 / freedom)) if np.isfinite(freedom) else radius)


def chance_of_error(radius: Array, alike: Array) -> tuple[float, Array]:
    """Chance that errors carry a path over a point, one at most, and the share (n,) of each place.

    `radius` (n,) is the distance from the point in deviations, `alike` (n - 1,) the correlation of neighbours' errors
    (`data.smoothed.spread`). The error along the shortest way is normal; it passes the point at the nearest place, or
    comes to do so from one place to the next: as often as a normal process rises through a level (Rice, Bell System
    Technical Journal 24, 1945).
    """
    level, beyond = np.exp(-(radius**2)), ndtr(-np.sqrt(2.0) * radius)
    nearest = int(np.argmin(radius))
    at_nearest = float(beyond[nearest])  # whatever carries it over
    level[nearest] = beyond[nearest] = 0.0
    rising = np.arccos(np.clip(alike, 0.0, 1.0)) / TWO_PI * (level[1:] + level[:-1])
    share = np.append(0.0, 0.5 * np.minimum(rising, beyond[1:] + beyond[:-1]))  # half of rising, half of coming back
    share[nearest] += at_nearest
    return min(float(share.sum()), 1.0), share
