"""Closed-loop stability of several loops from the data: the count of det(I + L) with the contour closed.

Unstable closed-loop poles = unstable open-loop ones - encirclements of 0 by det(I + L) (MacFarlane and Postlethwaite,
International Journal of Control 25, 1977; Skogestad and Postlethwaite, Multivariable Feedback Control, 4.9). Its lines
are measured; below them it goes as 1/s^k, above them its loci die out, and where the data cannot carry that, or the
count between lines, the answer is "undecided" and names the band to measure.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from loopshape.check.between import bulges
from loopshape.check.crossings import chords_to_minus_one
from loopshape.check.doubt import chance_of_error, reach_of
from loopshape.check.loci import characteristic_loci
from loopshape.check.obstacles import COARSE_DEG, ON_IT, REACH_95, WRONG, Obstacle, Sampling, sampling
from loopshape.check.sampling import HiddenPole, hidden_poles
from loopshape.check.several_low_end import LowEnd, low_doubt, low_end, slopes
from loopshape.controller import Block, Controller
from loopshape.frf import FRF
from loopshape.loop import Loop
from loopshape.loop_matrix import LoopMatrix, responses
from loopshape.several import Certificate
from loopshape.units import Array, ComplexArray, deg, rad

UNKNOWN_POLES = (
    "the number of unstable poles of the whole plant is not known: declare unstable_poles in the requirements'"
    " [several], or name the controllers of the recorded loops in the map"
)
#: phase and slope that the ratio of det(I + L) to that of the recorded loops may have at the first line
HELD_DEG, HELD_SLOPE = 60.0, 0.5
_SAME = 1e-9  # det(I + L) that differs by less from that of the recorded loops does not differ


def closed_loops_stability(loops: LoopMatrix) -> Certificate:
    """The count for all loops of a plant at once, on the lines of its matrix.

    Integrators and unstable poles of the whole plant are the noun's word; a wrong word gives a wrong answer. Gain and
    phase at the lowest lines must go together as below a plant's corners (phase 90 deg times slope, Bode 1945), in one
    sense or the other: then det(I + L) is carried on to zero frequency along 1/s^k, and its sign there is read off. So
    a pair whose det P(0) has the wrong sign is unstable though each of its loops looks well. Undecided where lines do
    not reach low or high enough, where det(I + L) turns too far between two of them, or where its own 95 % reach
    covers zero.
    """
    counted = encirclement_count(loops)
    from_held = count_from_held(loops) if loops.held else counted
    if isinstance(from_held, Obstacle) and isinstance(counted, Obstacle):
        return Certificate("undecided", None, counted.reason, counted.band_hz)
    poles = counted if isinstance(from_held, Obstacle) else from_held
    assert isinstance(poles, int)
    if isinstance(counted, int) and counted != poles:
        reason = (
            f"{counted} unstable closed-loop poles by the declared integrators and unstable poles, and {poles} by the"
            " loops that were recorded and stood: one of them is wrong"
        )
        return Certificate("undecided", None, reason)
    if poles < 0:
        reason = f"{-poles} encirclements too many for {loops.unstable_poles} unstable poles of the plant"
        return Certificate("undecided", None, f"{reason}: declare unstable_poles of the whole plant")
    if poles:
        plural = "pole" if poles == 1 else "poles"
        return Certificate("unstable", poles, f"{poles} closed-loop {plural} in the right half plane")
    return Certificate("stable", 0, _why_stable(isinstance(counted, int)))


def _why_stable(counted: bool) -> str:
    """Which of the two counts says so."""
    if counted:
        return "the encirclements of 0 by det(I + L) balance the unstable poles"
    return "from the loops that were recorded and stood to these, det(I + L) does not encircle 0"


def encirclement_count(loops: LoopMatrix) -> int | Obstacle:
    """Unstable closed-loop poles, or what keeps the lines from telling.

    Negative where the plant's unstable poles are fewer than those that the encirclements would need.
    """
    if loops.unstable_poles is None:
        return Obstacle(UNKNOWN_POLES)
    loci = characteristic_loci(loops.L_i)
    low = low_end(loops.frequency_hz, loci)
    ends = low_doubt(loops, loci, low) or _high_doubt(loops, loci)
    if ends is not None:
        return ends
    f, D = loops.frequency_hz, loops.determinant
    as_one = _as_one(loops, D, determinant_variance(loops))
    between = _sampling(loops, as_one)
    before = 2.0 * D[0] * np.exp(-1j * rad(np.clip(low.phase_deg - 90.0 * low.slope, -60.0, 60.0)))
    found = _chord_doubt(f, loci, D, between.followed) or _noise_doubt(as_one, D, complex(before)) or between.unclear
    if found is not None:
        return found
    integrators = (loops.integrators or 0) + loops.controller_integrators()
    poles = count_by_determinant(D, loci, low, integrators, loops.unstable_poles)
    return poles - 2 * between.turns


def count_from_held(loops: LoopMatrix) -> int | Obstacle:
    """Unstable closed-loop poles by what changed since the loops were recorded and stood, or what keeps from telling.

    det(I + L) over what it was under the recorded controllers: the plant's own poles cancel, integrators and unstable
    ones alike, so that nothing is to be declared. The ratio must be near the real axis at the first line, as gains of
    one sign make it there; what differs below the first line by more than that is not seen.
    """
    stood = replace(loops, controllers=loops.held, held=())
    D = loops.determinant / stood.determinant
    more = loops.controller_integrators() - stood.controller_integrators()
    as_one = _as_one(loops, D, determinant_variance(loops, stood))
    between = _sampling(loops, as_one)
    loci, before = characteristic_loci(loops.L_i), characteristic_loci(stood.L_i)
    f, swing = loops.frequency_hz, float(np.angle(D[0] * 1j**more))
    if abs(deg(swing)) > HELD_DEG or abs(slopes(f, D[:, None])[0] + more) > HELD_SLOPE:
        reason = f"det(I + L) is not in step with that of the recorded loops at the first line, {f[0]:.3g} Hz"
        return Obstacle(f"{reason}: measure lower", (0.1 * float(f[0]), float(f[0])))
    doubts = (_high_doubt(loops, loci), _high_doubt(stood, before), _noise_doubt(as_one, D, complex(2.0 * D[0])))
    found = next((x for x in (*doubts, _chord_doubt(f, loci, D, between.followed), between.unclear) if x), None)
    if found is not None:
        return found
    end = float(np.sum(np.angle(1.0 + before[-1])) - np.sum(np.angle(1.0 + loci[-1])))
    turn = swing + float(np.sum(np.angle(D[1:] / D[:-1]))) + end
    return round(0.5 * more - turn / np.pi) - 2 * between.turns


def _as_one(loops: LoopMatrix, D: ComplexArray, variance: Array) -> Loop:
    """A loop whose 1 + L is D, with E|d ln D|² (nf,)."""
    plant, rate_hz = loops.plant, loops.controllers[0].rate_hz
    own = np.nan_to_num(np.abs(D) ** 2 * variance, posinf=0.0)  # nan: D passes 0 on a line
    made = FRF(
        loops.frequency_hz, (D - 1.0)[:, None, None], own[:, None, None].astype(complex), plant.trusted, ("1",),
        ("1",), f"det(I + L) - 1 of {plant.method}", plant.recording, "+".join(loops.names), plant.rate_hz,
        line_overlap=plant.line_overlap, variance_freedom=plant.variance_freedom,
    )  # fmt: skip
    return Loop(made, Controller("det", (Block("gain", {"gain": 1.0}),), rate_hz), None, 0)


def _sampling(loops: LoopMatrix, as_one: Loop) -> Sampling:
    """What lies between the lines of det(I + L), where an element of the plant shows a pole there too.

    The determinant's poles are those of the elements; what only it shows is a bend near a crossover. A pole that the
    elements show and the determinant does not has no weight in it, as far as its own noise lets see.
    """
    f, freedom = loops.frequency_hz, loops.plant.variance_freedom
    nothing = Sampling(0, np.zeros(max(f.size - 1, 0), dtype=bool), None)
    poles: list[HiddenPole] = []
    for element, variance in zip(_elements(loops.P), _elements(loops.plant.variance), strict=True):
        if element.any():
            poles += hidden_poles(f, element, np.maximum(variance, 1e-20 * np.max(np.abs(element)) ** 2), freedom)
    if not poles or np.abs(as_one.L).max() < _SAME:
        return nothing
    found = sampling(as_one)
    gaps = np.clip(np.searchsorted(f, [pole.centre_hz[0] for pole in poles]) - 1, 0, f.size - 2)
    return found if found.followed[gaps].any() else nothing


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


def _high_doubt(loops: LoopMatrix, loci: ComplexArray) -> Obstacle | None:
    f = loops.frequency_hz
    size = float(np.abs(loci[-1]).max())
    rate_hz = loops.controllers[0].rate_hz
    if size >= 1.0:
        reason = f"an eigenvalue of L is still {size:.2g} at the last line, {f[-1]:.3g} Hz: measure higher"
        return Obstacle(reason, (float(f[-1]), float(min(10.0 * f[-1], 0.5 * rate_hz))))
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
    return Obstacle(f"{reason}: excite more there", (float(f[-1]), float(above.frequency_hz[-1])))


def _chord_doubt(f: Array, loci: ComplexArray, D: ComplexArray, followed: np.ndarray) -> Obstacle | None:
    """Chords that pass 0 too near, turn too far, or bend too much; not where a hidden pole's path was followed."""
    if f.size < 2:
        return Obstacle("one line does not make a curve")

    def gap(k: int) -> tuple[float, float]:
        return float(f[k]), float(f[k + 1])

    distance = np.min([np.where(followed, np.inf, chords_to_minus_one(one)[0]) for one in loci.T], axis=0)
    k = int(np.argmin(distance))
    if distance[k] < ON_IT:
        return Obstacle(f"an eigenvalue of L passes -1 within {distance[k]:.1g} at {f[k]:.3g} Hz", gap(k))
    every = np.column_stack([1.0 + loci, D])
    turns = np.where(followed, 0.0, np.abs(deg(np.angle(every[1:] / every[:-1]))).max(axis=1))
    k = int(np.argmax(turns))
    words = f"between {f[k]:.4g} and {f[k + 1]:.4g} Hz"
    if turns[k] > COARSE_DEG:
        return Obstacle(f"det(I + L) turns by {turns[k]:.0f} deg {words}: measure finer there", gap(k))
    room = np.where(followed, np.inf, chords_to_minus_one(D - 1.0)[0]) - bulges(f, D - 1.0)
    k = int(np.argmin(room))
    if room[k] < 0.0:
        words = f"between {f[k]:.4g} and {f[k + 1]:.4g} Hz"
        reason = f"det(I + L) bends too much {words} to tell on which side it passes 0: measure finer there"
        return Obstacle(reason, gap(k))
    return None


def _noise_doubt(as_one: Loop, D: ComplexArray, before: complex) -> Obstacle | None:
    """Lines whose errors may carry det(I + L) over 0: one whose 95 % circle holds it, or all of them together."""
    f, plant = as_one.frequency_hz, as_one.plant
    reach = reach_of(D, np.sqrt(plant.variance[:, 0, 0]), plant.variance_freedom)
    chance, share = chance_of_error(D, reach, before, 1.0, plant.line_overlap)
    k = int(np.argmin(reach))
    if reach[k] < REACH_95:
        held = np.flatnonzero(reach < REACH_95)
        reason = f"0 lies within the uncertainty of det(I + L) at {f[k]:.3g} Hz: measure longer or excite more"
    elif chance > WRONG:
        held = np.flatnonzero(share > 0.1 * share.max())
        reason = f"errors may carry det(I + L) over 0 (chance {100.0 * chance:.1g} %): measure longer or excite more"
    else:
        return None
    return Obstacle(reason, (float(f[max(held[0] - 1, 0)]), float(f[min(held[-1] + 1, f.size - 1)])))


def determinant_variance(loops: LoopMatrix, stood: LoopMatrix | None = None) -> Array:
    """E|d|² (nf,) of ln det(I + L), to first order in the plant's error: d ln det(I + P C) = tr(C S_o dP).

    With `stood`, the same plant under other controllers, that of their ratio. Where it is not well below 1 the first
    order is no more than an order of magnitude.
    """
    slope = (loops.CS if stood is None else loops.CS - stood.CS).reshape(len(loops.frequency_hz), -1)  # vec(dP)'s order
    with np.errstate(invalid="ignore"):
        made = np.real(np.einsum("fi,fij,fj->f", slope, loops.plant.covariance, slope.conj(), optimize=True))
    return np.asarray(np.maximum(made, 0.0))
