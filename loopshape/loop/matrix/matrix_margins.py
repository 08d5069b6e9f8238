"""Several loops at once -> Margins, with intervals from the plant's covariance."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from loopshape.core.errors import WrongUseError
from loopshape.core.kernels.loops.margins import LARGE
from loopshape.core.units import Array, ComplexArray, db, deg
from loopshape.data.response.frf_arrays import channel_scales
from loopshape.data.response.smoothed import Dense
from loopshape.data.result.margins import Margins
from loopshape.data.signal.channel import Channel, sum_terms
from loopshape.loop.loop import Loop, responses, sensitivity
from loopshape.loop.matrix.determinant import closed_loops_stability, followed_matrix
from loopshape.loop.matrix.structured import mu_bounds, refined, upper_at
from loopshape.loop.stability.holes import HiddenAmong, hidden_among
from loopshape.loop.tolerances import TOL

#: lines whose gauge is within this of the largest, in ln, are read in each draw, and how many at most: fewer where a
#: search is needed for each (neighbours are smoothed together and say the same)
NEAR, MOST, MOST_SEARCHED = 0.7, 40, 16
SAME = 1e-9  #: both bounds of a margin within rounding
MIXED = "outputs have different units: singular values of S and T would depend on them and are not given"

#: gauges whose peaks over frequency the margins are
GAUGES = ("disk", "input_output", "modulus", "S", "T")
FIELDS = {
    "disk_margin": "disk",
    "input_output_disk_margin": "input_output",
    "modulus_margin": "modulus",
    "sensitivity_peak_db": "S",
    "complementary_peak_db": "T",
}


#: plants, controllers, and draws where there are any
_Seen = tuple[ComplexArray, ComplexArray, Dense | None]


class _Peak(NamedTuple):
    """Ln of a gauge's largest value over the lines, where, the scales that read it, and what it may reach beside them.

    `beside` is -inf where what lies above the last line, below the first, and in holes between them, cannot be larger
    than on the lines; `hole_hz` is the middle of the hole that decides it.
    """

    value: float
    at: int
    lower: float
    phases: ComplexArray
    scales: Array
    beside: float
    hole_hz: float | None


def matrix_margins(loops: Loop) -> Margins:
    """Margins of all loops at once, on the lines of the plant's matrix.

    With M = (S - T)/2 the loops stand every change of theirs by (1 + d/2)/(1 - d/2), |d| < a complex, as long as
    a < 1/mu(M) at all frequencies; the modulus margin is 1/mu(S) likewise. With one controller a loop both are the
    same at the plant's inputs and outputs. Above the last line L is taken to stay as small as it is there (in the
    scales that show it smallest): a may be no more than 2 (1 - l)/(1 + l). Below the first line L is taken to stay as
    large as it is there, and this counts where a peak still rises towards that line. Where either decides a number,
    that number is a bound, and `bounds` says how good it may be; `at_hz` stays with the largest line. Where lines are
    missing a bound is what a resonance may do that those about the hole do not show, and `at_hz` the hole's middle.

    With a covariance the lines are smoothed first, each number is freed of the bias that noise gives a largest of many,
    and has a 95 % interval: both from draws of the error (as in `loop.margin.margins`). For more than three loops,
    and for inputs and outputs at once, the margin is what is guaranteed (an upper bound of mu), and
    `disk_margin_reached` says from where on it is known to be lost. Peaks between lines are seen where a resonance that
    the lines show makes them, and by a parabola through the largest line and its neighbours, whose rise, and as much
    again, is in the bad half of the interval.
    """
    scatter = followed_matrix(loops) if loops.plant.covariance.any() else None
    P, f, c = loops.P, loops.frequency_hz, loops.c
    if scatter is not None:
        P, f = scatter.response, scatter.frequency_hz
        c = responses(loops.controllers, f)
    mixed = not _one_unit(loops)
    wanted = [g for g in GAUGES if not (mixed and g in "ST")]
    even = _in_even_units(P, c, scatter)
    seen = {g: (P, c, scatter) if g in "ST" else even for g in wanted}
    holes = hidden_among(loops)
    peaks = {g: _peak(g, *seen[g][:2], f, holes) for g in wanted}
    values = {g: peaks[g].value for g in wanted}
    reaches: Mapping[str, tuple[float, float]] = {}
    if scatter is not None:
        drawn = {g: (own, c) for g, (_, c, own) in seen.items() if own is not None}
        shifts = {g: _shift(g, own, c, peaks[g]) for g, (own, c) in drawn.items()}
        rises = {g: _between_lines(g, f, own.reference, c, peaks[g]) for g, (own, c) in drawn.items()}
        values = {g: values[g] - shifts[g][0] for g in wanted}
        half = {g: TOL.half_width_std * shifts[g][1] for g in wanted}
        reaches = {g: (half[g], rises[g] + np.hypot(half[g], rises[g])) for g in wanted}
    bounds = {
        n: _field(n, values[g] - reaches.get(g, (0.0, 0.0))[0])
        for n, g in FIELDS.items()
        if g in wanted and peaks[g].beside > values[g]
    }
    values |= {g: peaks[g].beside for n, g in FIELDS.items() if n in bounds}
    stability = closed_loops_stability(loops)
    disk = peaks["disk"]
    found = {name: _field(name, values[g]) for name, g in FIELDS.items() if g in values}
    intervals = {n: _ends(n, values[g], reaches[g]) for n, g in FIELDS.items() if g in reaches}
    a = found["disk_margin"]
    reached = a if "disk_margin" in bounds else min(a * float(np.exp(disk.value - disk.lower)), 2.0)
    if reached > (1.0 + SAME) * a > 0.0:  # between what is guaranteed and what is known to be lost nothing is known
        low, high = intervals.get("disk_margin", (a, a))
        intervals["disk_margin"] = low, high * reached / a
    return Margins.of(
        found | _of_the_disk(a),
        stability.outcome,
        intervals=intervals,
        at_hz={name: peaks[g].hole_hz or float(f[peaks[g].at]) for name, g in FIELDS.items() if g in peaks},
        bounds=bounds,
        stability_reason=stability.reason,
        stability_band_hz=stability.band_hz,
        missing_hz=() if holes is None else tuple((float(low), float(high)) for low, high in holes.ends_hz),
        loops=loops.names,
        disk_margin_reached=reached,
        worst_changes=_changes(disk),
        unstable_poles=stability.unstable_poles,
        notes=(MIXED,) if mixed else (),
    )


def _in_even_units(P: ComplexArray, c: ComplexArray, scatter: Dense | None) -> _Seen:
    """Plants (nf, n, n), controllers (nf, n) and draws in units in which the plant's elements have about one size.

    Structured singular values stay as they are; the searches for them do not, where 1 m is 1e9 nm.
    """
    rows, columns = channel_scales(P)
    even = rows[:, None] * columns
    if scatter is not None:
        moved = {n: getattr(scatter, n) * even for n in ("response", "reference", "deviations")}
        scatter = replace(scatter, **moved)
    return P * even, c / (rows * columns), scatter


def _of_the_disk(a: float) -> dict[str, float]:
    """What every loop's gain and phase may vary by, all at once, by the disk margin."""
    gain = float(db((2.0 + a) / (2.0 - a))) if a < 2.0 else float("inf")
    return {"gain_margin_db": gain, "phase_margin_deg": float(2.0 * deg(np.arctan(0.5 * a)))}


def _field(name: str, value: float) -> float:
    """A margin or a peak in dB from ln of its gauge."""
    if name.endswith("_db"):
        return float(db(np.exp(value)))
    return float(min(np.exp(-value), 1.0 if name == "modulus_margin" else 2.0))


def _ends(name: str, value: float, reach: tuple[float, float]) -> tuple[float, float]:
    ends = _field(name, value - reach[0]), _field(name, value + reach[1])
    return min(ends), max(ends)


def _one_unit(loops: Loop) -> bool:
    units = set()
    for output in loops.plant.outputs:
        try:
            units.add(Channel.from_column(sum_terms(output)[0]).unit)
        except WrongUseError:
            units.add("")
    return len(units) == 1


def gauge_matrix(name: str, P: ComplexArray, c: ComplexArray) -> ComplexArray:
    """The matrix (..., m, m) whose size is one gauge, of plants P (..., n, n) and controllers c (nf, n)."""
    if name == "input_output":
        return _half_difference(broken_twice(P, c))
    L = P * c[..., None, :]
    if name == "disk":
        return _half_difference(L)
    S = sensitivity(L)
    return S if name in ("modulus", "S") else L @ S


def _half_difference(L: ComplexArray) -> ComplexArray:
    """(S - T)/2 = S - I/2."""
    return np.asarray(sensitivity(L) - 0.5 * np.eye(L.shape[-1]))


def broken_twice(P: ComplexArray, c: ComplexArray) -> ComplexArray:
    """Open loop (..., 2n, 2n) broken at the plant's inputs and outputs at once: [[0, C], [-P, 0]]."""
    n = P.shape[-1]
    L = np.zeros((*P.shape[:-2], 2 * n, 2 * n), dtype=complex)
    L[..., n:, :n] = -P
    L[..., np.arange(n), n + np.arange(n)] = c
    return L


def _peak(name: str, P: ComplexArray, c: ComplexArray, f: Array, holes: HiddenAmong | None) -> _Peak:
    M = gauge_matrix(name, P, c)
    nf, m = M.shape[:2]
    if name in ("S", "T"):
        size = np.linalg.norm(M, 2, axis=(1, 2))
        lower, phases, scales = size, np.ones((nf, m), dtype=complex), np.zeros((nf, m))
    else:
        size, lower, scales, phases = mu_bounds(M)
    k = int(np.argmax(size))
    beside = _above_last(name, P[-1:], c[-1:])
    if nf > 1 and size[0] > size[1]:
        beside = max(beside, _below_first(name, P[:1], c[:1]))
    within, hole_hz = (0.0, None) if holes is None else _in_holes(size, f, holes)
    hole_hz, beside = (hole_hz, within) if within > max(beside, size[k]) else (None, beside)
    beside = float(np.log(beside)) if beside > size[k] else -np.inf
    return _Peak(float(np.log(size[k])), k, float(np.log(lower[k])), phases[k], scales, beside, hole_hz)


def _in_holes(size: Array, f: Array, holes: HiddenAmong) -> tuple[float, float]:
    """The largest that a gauge of `size` (nf,) may reach in holes, and in the middle of which, in Hz.

    A resonance that moves I + L by a share of its size moves S by share/(1 - share) of its own, which is no larger than
    the gauge and 1.
    """
    each = []
    for (low_hz, high_hz), share in zip(holes.ends_hz, holes.spread, strict=True):
        known = size[(f >= low_hz) & (f <= high_hz)].max(initial=0.0)
        more = share / (1.0 - share) if share < 1.0 else np.inf
        each.append((float(known + (known + 1.0) * more), float(np.sqrt(low_hz * high_hz))))
    return max(each)


def _above_last(name: str, P: ComplexArray, c: ComplexArray) -> float:
    """What a gauge may reach above the last line, if L stays as small as it is there."""
    last = _size(name, broken_twice(P, c) if name == "input_output" else P * c[..., None, :])
    return _reach(name, last, 1.0 - last)


def _below_first(name: str, P: ComplexArray, c: ComplexArray) -> float:
    """What a gauge may reach below the first line, if L stays as large as it is there; 0 where it is large."""
    L = broken_twice(P, c) if name == "input_output" else P * c[..., None, :]
    first = 1.0 / max(_size(name, np.asarray(np.linalg.pinv(L), dtype=complex)), 1e-9)
    if first >= LARGE:
        return 0.0
    return _reach(name, first, first - 1.0)


def _reach(name: str, size: float, room: float) -> float:
    """The largest of a gauge where L is of this size, and so far from 1."""
    room = max(room, 1e-9)
    return {"modulus": 1.0 / room, "S": 1.0 / room, "T": size / room}.get(name, 0.5 * (1.0 + size) / room)


def _size(name: str, L: ComplexArray) -> float:
    return float(np.linalg.norm(L[0], 2) if name in ("S", "T") else mu_bounds(L).upper[0])


def _shift(name: str, scatter: Dense, c: ComplexArray, peak: _Peak) -> tuple[float, float]:
    """Mean and standard deviation of what the draws do to ln of a gauge's peak, against the reference without them."""
    near = _near(name, scatter.reference, c, peak)
    reference = _read(name, scatter.reference[None, near], c[near], peak.scales[near])[0]
    drawn = _read(name, scatter.reference[near] + scatter.deviations[:, near], c[near], peak.scales[near])
    return float(np.mean(drawn) - reference), float(np.std(drawn))


def _between_lines(name: str, f: Array, P: ComplexArray, c: ComplexArray, peak: _Peak) -> float:
    """How far ln of a gauge rises between lines: a parabola through its largest line and the two beside it."""
    near = slice(peak.at - 1, peak.at + 2)
    if not 0 < peak.at < f.size - 1:
        return 0.0
    y = np.log(_sizes(name, gauge_matrix(name, P[near], c[near]), peak.scales[near]))
    bend, slope, _ = np.polyfit(f[near] - f[peak.at], y, 2)
    return float(-0.25 * slope**2 / bend) if bend < 0.0 and y[1] >= max(y[0], y[2]) else 0.0


def _near(name: str, P: ComplexArray, c: ComplexArray, peak: _Peak) -> np.ndarray:
    """Lines (indices) where a gauge may reach its peak."""
    size = np.log(_sizes(name, gauge_matrix(name, P, c), peak.scales))
    searched = name not in ("S", "T") and peak.scales.shape[1] > 2
    near = np.argsort(-size)[: MOST_SEARCHED if searched else MOST]
    return np.sort(near[size[near] > size.max() - NEAR])


def _read(name: str, P: ComplexArray, c: ComplexArray, scales: Array) -> Array:
    """Ln of a gauge's peak (draws,) over some lines, of plants P (draws, lines, n, n)."""
    M = gauge_matrix(name, P, c)
    if name not in ("S", "T") and M.shape[-1] > 2:
        flat = M.reshape(-1, *M.shape[2:])
        scales = refined(flat, np.tile(scales, (len(M), 1))).reshape(*M.shape[:2], -1)
    return np.asarray(np.log(_sizes(name, M, scales)).max(axis=-1))


def _sizes(name: str, M: ComplexArray, scales: Array) -> Array:
    if name in ("S", "T"):
        return np.asarray(np.linalg.norm(M, 2, axis=(-2, -1)))
    return upper_at(M, scales)


def _changes(peak: _Peak) -> tuple[complex, ...]:
    """Factors, one a loop, that bring all loops to their limit at the peak's line: (1 + d/2)/(1 - d/2), |d| = 1/mu."""
    d = 0.5 * np.exp(-peak.lower) * peak.phases
    with np.errstate(divide="ignore", invalid="ignore"):
        return tuple(((1.0 + d) / (1.0 - d)).tolist())
