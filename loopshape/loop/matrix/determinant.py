"""Closed-loop stability of several loops from the data: the count of det(I + L) with the contour closed.

Unstable closed-loop poles = unstable open-loop ones - encirclements of 0 by det(I + L) (MacFarlane and Postlethwaite,
International Journal of Control 25, 1977; Skogestad and Postlethwaite, Multivariable Feedback Control, 4.9). Its lines
are measured; below them it goes as 1/s^k, above them its loci die out, and where the data cannot carry that, or the
count between lines, the answer is "undecided" and names the band to measure.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from loopshape.core.outcomes import ClosedLoop
from loopshape.core.units import Array, ComplexArray, deg, rad
from loopshape.data.control.controller import Block, Controller
from loopshape.data.response.frf import FRF
from loopshape.data.response.frf_arrays import channel_scales
from loopshape.data.response.smoothed import Dense, spread
from loopshape.identify.smooth.smoothing import smoothed_matrix
from loopshape.loop.loop import Loop, characteristic_loci, responses, sensitivity
from loopshape.loop.margin.between import Path, chords_to_minus_one
from loopshape.loop.stability.holes import hole_among
from loopshape.loop.stability.low_end import lowest_count
from loopshape.loop.stability.obstacles import ON_IT, Sampling, Undecided, doubt, sampling
from loopshape.loop.stability.sampling import HiddenPole, between_lines
from loopshape.loop.stability.stability import Stability
from loopshape.loop.tolerances import TOL

UNKNOWN_POLES = (
    "the number of unstable poles of the whole plant is not known: declare unstable_poles in the requirements'"
    " [several], or name the controllers of the recorded loops in the map"
)
#: I + L is read between lines where L moves by so much of it and is no smaller than this, on so many places at most
STEP, SMALL, MOST = 0.2, 0.05, 8
#: phase and slope of the lowest lines that may be left beside the integrators, and how much more for each further loop
FIT_DEG, FIT_SLOPE, MORE = 75.0, 0.75, 0.3
#: a locus below 1 at the first line must not fall faster than this, as a power of frequency, nor all such det(I + L)
FLAT, FLAT_DEG = -0.3, 30.0


def closed_loops_stability(loops: Loop) -> Stability:
    """The count for all loops of a plant at once, on the lines of its matrix.

    Integrators and unstable poles of the whole plant are the noun's word; a wrong word gives a wrong answer. Gain and
    phase at the lowest lines must go together as below a plant's corners (phase 90 deg times slope, Bode 1945), in one
    sense or the other: then det(I + L) is carried on to zero frequency along 1/s^k, and its sign there is read off. So
    a pair whose det P(0) has the wrong sign is unstable though each of its loops looks well. Undecided where lines do
    not reach low or high enough, where det(I + L) turns too far between two of them, or where its own 95 % reach
    covers zero.
    """
    counted = encirclement_count(loops)
    from_held = count_from_held(loops) if loops.recorded_under else counted
    if isinstance(from_held, Undecided) and isinstance(counted, Undecided):
        return Stability(ClosedLoop.UNDECIDED, None, counted.reason, counted.band_hz)
    poles = counted if isinstance(from_held, Undecided) else from_held
    assert isinstance(poles, int)
    if isinstance(counted, int) and counted != poles:
        reason = (
            f"{counted} unstable closed-loop poles by the declared integrators and unstable poles, and {poles} by the"
            " loops that were recorded and stood: one of them is wrong"
        )
        return Stability(ClosedLoop.UNDECIDED, None, reason)
    if poles < 0:
        reason = f"{-poles} encirclements too many for {loops.unstable_poles} unstable poles of the plant"
        return Stability(ClosedLoop.UNDECIDED, None, f"{reason}: declare unstable_poles of the whole plant")
    if poles:
        plural = "pole" if poles == 1 else "poles"
        return Stability(ClosedLoop.UNSTABLE, poles, f"{poles} closed-loop {plural} in the right half plane")
    reason = "the encirclements of 0 by det(I + L) balance the unstable poles"
    if not isinstance(counted, int):
        reason = "from the loops that were recorded and stood to these, det(I + L) does not encircle 0"
    return Stability(ClosedLoop.STABLE, 0, reason)


def encirclement_count(loops: Loop) -> int | Undecided:
    """Unstable closed-loop poles, or what keeps the lines from telling.

    Negative where the plant's unstable poles are fewer than those that the encirclements would need.
    """
    if loops.unstable_poles is None:
        return Undecided(UNKNOWN_POLES)
    loci = characteristic_loci(loops.L_i)
    low = low_end(loops.frequency_hz, loci)
    ends = low_doubt(loops, loci, low) or _high_doubt(loops, loci)
    if ends is not None:
        return ends
    D = loops.determinant
    path = _path(loops)
    between = _sampling(loops, _as_one(loops, D, determinant_variance(loops)), path)
    before = 2.0 * D[0] * np.exp(-1j * rad(np.clip(low.phase_deg - 90.0 * low.slope, -60.0, 60.0)))
    found = _doubt(loops, loci, path, between, complex(before))
    if found is not None:
        return found
    integrators = (loops.integrators or 0) + loops.controller_integrators()
    poles = count_by_determinant(1.0 + path.L, loci, low, integrators, loops.unstable_poles)
    return poles - 2 * between.turns


def count_from_held(loops: Loop) -> int | Undecided:
    """Unstable closed-loop poles by what changed since the loops were recorded and stood, or what keeps from telling.

    det(I + L) over what it was under the recorded controllers: the plant's own poles cancel, integrators and unstable
    ones alike, so that nothing is to be declared. The ratio must be near the real axis at the first line, as gains of
    one sign make it there; what differs below the first line by more than that is not seen.
    """
    stood = replace(loops, controllers=loops.recorded_under, recorded_under=())
    D = loops.determinant / stood.determinant
    more = loops.controller_integrators() - stood.controller_integrators()
    path = _path(loops, stood)
    between = _sampling(loops, _as_one(loops, D, determinant_variance(loops, stood)), path)
    loci, before = characteristic_loci(loops.L_i), characteristic_loci(stood.L_i)
    f, swing = loops.frequency_hz, float(np.angle(D[0] * 1j**more))
    # phase and slope that the ratio of det(I + L) to that of the recorded loops may have at the first line
    held_deg, held_slope = 60.0, 0.5
    if abs(deg(swing)) > held_deg or abs(slopes(f, D[:, None])[0] + more) > held_slope:
        reason = f"det(I + L) does not agree with that of the recorded loops at the lowest frequency, {f[0]:.3g} Hz"
        return Undecided(f"{reason}: measure lower", (0.1 * float(f[0]), float(f[0])))
    found = _high_doubt(loops, loci) or _high_doubt(stood, before)
    found = found or _doubt(loops, loci, path, between, complex(2.0 * D[0]))
    if found is not None:
        return found
    end = float(np.sum(np.angle(1.0 + before[-1])) - np.sum(np.angle(1.0 + loci[-1])))
    whole = 1.0 + path.L
    turn = float(np.angle(whole[0] * 1j**more)) + float(np.sum(np.angle(whole[1:] / whole[:-1]))) + end
    return round(0.5 * more - turn / np.pi) - 2 * between.turns


def followed_matrix(loops: Loop, draws: int | None = None) -> Dense:
    """The smoothed plant with (some of) its draws, on lines and on places between them where I + L moves far."""
    lines, P = loops.frequency_hz, loops.P
    found = smoothed_matrix(loops.plant)
    dense = Dense(lines, P, P, np.zeros((1, *P.shape), dtype=complex)) if found is None else found[0]
    dense = replace(dense, deviations=dense.deviations[:draws])
    L = dense.response * responses(loops.controllers, dense.frequency_hz)[:, None, :]
    even = channel_scales(P)[0]
    L = L * (even[:, None] / even)  # singular values that do not depend on the outputs' units
    with np.errstate(divide="ignore"):
        room = 1.0 / np.linalg.norm(sensitivity(L), 2, axis=(1, 2))
    moved = np.linalg.norm(np.diff(L, axis=0), 2, axis=(1, 2))
    small = np.linalg.norm(L, 2, axis=(1, 2)) < SMALL
    return dense.between(np.where(small[1:], 0.0, moved), np.minimum(room[1:], room[:-1]), STEP, MOST)


def _path(loops: Loop, stood: Loop | None = None) -> Path:
    """det(I + L) - 1 between lines, with `stood` over that of the same plant under other controllers."""
    dense = followed_matrix(loops, TOL.deviation_draws)
    D, moved = _determinant(loops, dense)
    if stood is not None:
        before, moved_before = _determinant(stood, dense)
        D, moved = D / before, moved - moved_before
    rms, _, alike = spread(moved)
    return Path(dense.frequency_hz, D - 1.0, np.abs(D) * rms, alike, np.isin(dense.frequency_hz, loops.frequency_hz))


def _determinant(loops: Loop, dense: Dense) -> tuple[ComplexArray, ComplexArray]:
    """det(I + L) (n,), and what draws of the plant's error do to its logarithm (draws, n): tr(C S_o dP)."""
    c = responses(loops.controllers, dense.frequency_hz)
    whole = np.eye(len(loops.names)) + c[:, :, None] * dense.response
    slope = np.linalg.inv(whole) * c[:, None, :]
    return np.linalg.det(whole), np.einsum("fij,dfji->df", slope, dense.deviations, optimize=True)


def _as_one(loops: Loop, D: ComplexArray, variance: Array) -> Loop:
    """A loop whose 1 + L is D, with E|d ln D|² (nf,)."""
    plant, rate_hz = loops.plant, loops.controllers[0].rate_hz
    own = np.nan_to_num(np.abs(D) ** 2 * variance, posinf=0.0)  # nan: D passes 0 on a line
    made = FRF(
        loops.frequency_hz, (D - 1.0)[:, None, None], own[:, None, None].astype(complex), plant.valid, ("1",),
        ("1",), f"det(I + L) - 1 of {plant.method}", plant.recording, "+".join(loops.names), plant.rate_hz,
        line_overlap=plant.line_overlap, variance_freedom=plant.variance_freedom,
    )  # fmt: skip
    return Loop(made, Controller("det", (Block("gain", {"gain": 1.0}),), rate_hz), None, 0)


def _sampling(loops: Loop, as_one: Loop, path: Path) -> Sampling:
    """What lies between the lines of det(I + L) and off its path, where an element of the plant shows a pole there too.

    The determinant's poles are those of the elements; what only it shows is a bend near a crossover. A pole that the
    elements show and the determinant does not has no weight in it, as far as its own noise lets see.
    """
    f, freedom = loops.frequency_hz, loops.plant.variance_freedom
    nothing, found = Sampling(0, np.zeros(max(f.size - 1, 0), dtype=bool), None), smoothed_matrix(loops.plant)
    poles: list[HiddenPole] = []
    rest = loops.P if found is None else loops.P - found[1]
    for element, variance in zip(_elements(rest), _elements(loops.plant.variance), strict=True):
        if element.any():
            known = np.maximum(variance, 1e-20 * np.max(np.abs(element)) ** 2)
            poles += between_lines(f, element, known, freedom).poles
    same = 1e-9  # det(I + L) that differs by less from that of the recorded loops does not differ
    if not poles or np.abs(as_one.L).max() < same:
        return nothing
    shown = sampling(as_one, path)
    gaps = np.clip(np.searchsorted(f, [pole.pole_hz.real for pole in poles]) - 1, 0, f.size - 2)
    return shown if shown.interpolated[gaps].any() else nothing


def _elements(P: np.ndarray) -> np.ndarray:
    """Elements of a matrix (nf, n, n) as rows (n n, nf)."""
    return P.reshape(len(P), -1).T


def count_by_determinant(
    determinant: ComplexArray, loci: ComplexArray, low: LowEnd, integrators: int, unstable_poles: int
) -> int:
    """Closed-loop poles in the right half plane, by the bare count: it trusts every line and what lies between.

    With P unstable open-loop poles and k integrators, passed on the right, the turn of det(I + L) over s = j0+ to j inf
    is pi (P + k/2 - Z) for Z unstable closed-loop poles. Above the last line all loci are taken to shrink to zero.
    """
    start = rad(low.phase_deg + 90.0 * integrators - (180.0 if low.negative else 0.0)) + low.rest_rad
    turn = float(start) + float(np.sum(np.angle(determinant[1:] / determinant[:-1])))
    turn -= float(np.sum(np.angle(1.0 + loci[-1])))
    return round(unstable_poles + 0.5 * integrators - turn / np.pi)


def _high_doubt(loops: Loop, loci: ComplexArray) -> Undecided | None:
    f = loops.frequency_hz
    size = float(np.abs(loci[-1]).max())
    rate_hz = loops.controllers[0].rate_hz
    if size >= 1.0:
        reason = f"an eigenvalue of L is still {size:.2g} at the highest frequency, {f[-1]:.3g} Hz: measure higher"
        return Undecided(reason, (float(f[-1]), float(min(10.0 * f[-1], 0.5 * rate_hz))))
    if loops.beyond is None or not (kept := loops.beyond.frequency_hz < 0.5 * rate_hz).any():
        return None
    above = loops.beyond.select(kept)
    c = responses(loops.controllers, above.frequency_hz)
    radius = np.abs(np.linalg.eigvals(c[:, :, None] * above.response)).max(axis=1)
    k = int(np.argmax(radius))
    if radius[k] < 1.0:
        return None
    at = above.frequency_hz[k]
    reason = f"an eigenvalue of L reaches {radius[k]:.2g} at {at:.3g} Hz, above the band that is known well"
    return Undecided(f"{reason}: excite more there", (float(f[-1]), float(above.frequency_hz[-1])))


def _on_it(f: Array, loci: ComplexArray, interpolated: np.ndarray) -> Undecided | None:
    """A gap in which an eigenvalue of L passes -1 so near that nothing tells the side; none of those `interpolated`."""
    near = np.min([chords_to_minus_one(one)[0] for one in loci.T], axis=0)
    near = np.where(interpolated, np.inf, near) if interpolated.size else near
    k = int(np.argmin(near))
    if near[k] >= ON_IT:
        return None
    return Undecided(
        f"an eigenvalue of L passes -1 within {near[k]:.1g} at {f[k]:.3g} Hz", (float(f[k]), float(f[k + 1]))
    )


def _doubt(loops: Loop, loci: ComplexArray, path: Path, between: Sampling, before: complex) -> Undecided | None:
    """What keeps the path from telling on which side of 0 det(I + L) passes; it comes from `before`."""
    if path.f.size < 2:
        return Undecided("one frequency does not make a curve")
    if (missing := hole_among(loops)) is not None:
        return Undecided(*missing)
    near = _on_it(loops.frequency_hz, loci, between.interpolated)
    found = near or doubt(path, between, before, loops.plant.variance_freedom, "det(I + L)", "0")
    return found or between.unclear


def determinant_variance(loops: Loop, stood: Loop | None = None) -> Array:
    """E|d|² (nf,) of ln det(I + L), to first order in the plant's error: d ln det(I + P C) = tr(C S_o dP).

    With `stood`, the same plant under other controllers, that of their ratio. Where it is not well below 1 the first
    order is no more than an order of magnitude.
    """
    slope = (loops.CS if stood is None else loops.CS - stood.CS).reshape(len(loops.frequency_hz), -1)  # vec(dP)'s order
    with np.errstate(invalid="ignore"):
        made = np.real(np.einsum("fi,fij,fj->f", slope, loops.plant.covariance, slope.conj(), optimize=True))
    return np.asarray(np.maximum(made, 0.0))


class LowEnd(NamedTuple):
    """What the lowest lines say: phase of det(I + L)'s part that rules there, its slope, which loci are large.

    `phase_deg` is on the branch nearest to 90 deg times `slope`, plus 180 deg where det(I + L) starts `negative`;
    that is None where the phase lies between the two. `rest_rad` leads on from there to det(I + L) itself.
    """

    slope: float
    phase_deg: float
    negative: bool | None
    large: np.ndarray
    rest_rad: float


def low_end(f: Array, loci: ComplexArray) -> LowEnd:
    """The lowest lines of characteristic loci (nf, n).

    Loci of size 1 and above rule det(I + L) there by themselves, those below 1 by 1 + lambda.
    """
    count = lowest_count(f)
    large = np.abs(loci[0]) >= 1.0
    large |= _mirrored(loci[0], large)
    part = np.where(large, loci[:count], 1.0 + loci[:count])
    size = np.log(np.maximum(np.abs(part), 1e-300)).sum(axis=1)
    slope = float(np.polyfit(np.log(f[:count]), size, 1)[0]) if count > 1 else 0.0
    phase = float(deg(np.angle(part[0])).sum())
    away = _wrapped(phase - 90.0 * slope)
    negative = False if abs(away) <= FIT_DEG else True if abs(away) >= 180.0 - FIT_DEG else None
    branch = 90.0 * slope + (180.0 + _wrapped(away - 180.0) if negative else away)
    first = loci[0][large]
    return LowEnd(slope, branch, negative, large, float(np.angle((1.0 + first) / first).sum()))


def slopes(f: Array, loci: ComplexArray) -> Array:
    """d ln|lambda|/d ln f (n,) of each locus (nf, n) over the lowest lines."""
    count = lowest_count(f)
    size = np.log(np.maximum(np.abs(loci[:count]), 1e-300))
    return np.asarray(np.polyfit(np.log(f[:count]), size, 1)[0] if count > 1 else np.zeros(loci.shape[1]))


def _mirrored(first: ComplexArray, large: np.ndarray) -> np.ndarray:
    """Values (n,) that are about the conjugates of large ones: a real plant's pair at low frequency counts as one.

    Not those on the real axis between -1 and 0, of which each is its own.
    """
    pairs = np.abs(first[:, None] - first[None, :].conj()) < 0.1 * np.abs(first)[:, None]
    with np.errstate(divide="ignore", invalid="ignore"):
        apart = np.abs(deg(np.angle((1.0 + first) / first))) < 120.0
    return np.asarray((pairs & large[None, :]).any(axis=1) & apart)


def _wrapped(angle_deg: float) -> float:
    return (angle_deg + 180.0) % 360.0 - 180.0


def read_integrators(loops: Loop) -> tuple[int | None, str]:
    """Integrators of the whole plant by the slope of the lowest lines, None where it is not near a whole number."""
    low = low_end(loops.frequency_hz, characteristic_loci(loops.L_i))
    own = loops.controller_integrators()
    every = round(-low.slope)
    read_slope = 0.25  # without a declaration the slope must be this near to a whole number of integrators, a loop
    if abs(every + low.slope) > read_slope * max(int(low.large.sum()), 1) or low.negative is None or every < own:
        return None, f"det(I + L) falls as with {-low.slope:.1f} integrators over its lowest frequencies, {own} of C's"
    word = "integrator" if every - own == 1 else "integrators"
    return every - own, f"plant taken to have {every - own} {word} in all, from the lowest frequencies of det(I + L)"


def low_doubt(loops: Loop, loci: ComplexArray, low: LowEnd) -> Undecided | None:
    """Why the lowest lines do not tell how det(I + L) goes on below them, None where they do."""
    f = loops.frequency_hz
    lower = (0.1 * float(f[0]), float(f[0]))
    if loops.integrators is None:
        way_out = "declare integrators of the whole plant in the requirements' [several]"
        return Undecided(f"the number of integrators of the plant is not known: {way_out}")
    small = _small_doubt(f, loci, low)
    if small is not None:
        return small
    own = loops.controller_integrators()
    every, more = loops.integrators + own, 1.0 + MORE * max(int(low.large.sum()) - 1, 0)
    swing = low.phase_deg + 90.0 * every - (180.0 if low.negative else 0.0)
    if low.negative is None or abs(swing) > FIT_DEG * more or abs(low.slope + every) > FIT_SLOPE * more:
        reason = (
            f"slope ({20.0 * low.slope:.0f} dB a decade) and phase ({low.phase_deg:.0f} deg) of det(I + L) at the first"
            f" lines ({f[0]:.3g} Hz) do not fit {every} integrators ({own} of them the controllers')"
        )
        return Undecided(f"{reason}: measure lower, or declare integrators of the whole plant", lower)
    return None


def _small_doubt(f: Array, loci: ComplexArray, low: LowEnd) -> Undecided | None:
    """Loci below 1 at the first line that may have been above it lower down, or that are near -1."""
    for k in np.flatnonzero(~low.large):
        first = loci[0, k]
        size = f"an eigenvalue of L is {abs(first):.2g} at the lowest frequency already, {f[0]:.3g} Hz"
        slope = slopes(f, loci)[k]
        if slope < FLAT:
            from_hz = float(f[0] * (0.5 * abs(first)) ** (1.0 / max(-slope, 1.0)))
            return Undecided(f"{size}, and falls: its crossover lies lower, measure there", (from_hz, float(f[0])))
    turned = float(deg(np.angle(1.0 + loci[0, ~low.large])).sum())
    if abs(turned) > FLAT_DEG:
        reason = f"eigenvalues of L below 1 turn det(I + L) by {turned:.0f} deg at the lowest frequency, {f[0]:.3g} Hz"
        return Undecided(f"{reason}: measure lower", (0.1 * float(f[0]), float(f[0])))
    return None
