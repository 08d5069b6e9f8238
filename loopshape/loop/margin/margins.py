"""Loop -> Margins, by definition, from a measured plant's lines; with intervals where it knows its scatter."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from loopshape.core.kernels.loops import margins as kernel
from loopshape.core.toolboxes import function_at
from loopshape.core.units import Array, ComplexArray, db, deg
from loopshape.data.control.controller import controller_bandwidth_hz
from loopshape.data.requirement.limits_over import MASKED, Mask
from loopshape.data.requirement.requirements import LIMIT_OF, LIMITS, Requirements
from loopshape.data.requirement.weight import Weight, over
from loopshape.data.response.smoothed import by_draw, spread
from loopshape.data.result.margins import Margins, Reading
from loopshape.loop.loop import Loop, slope_at_end
from loopshape.loop.margin.between import axis_crossings, interpolated, unit_crossings
from loopshape.loop.stability.holes import gaps_of, hidden_in
from loopshape.loop.stability.low_end import BELOW_RATIOS, LowModel, in_sight, is_large, low_models, poles_at_0
from loopshape.loop.stability.stability import closed_loop_stability
from loopshape.loop.tolerances import TOL

Interval = tuple[float, float]

#: limits that the kernel reads, each with its column
COLUMN_OF = {x.name: int(getattr(kernel, x.column)) for x in LIMIT_OF.values() if x.column}
_COLUMNS = tuple((LIMIT_OF[name], k) for name, k in COLUMN_OF.items())


#: what a crossover out of sight leaves open
_NEAR_MINUS_ONE = (
    "gain_margin_db", "modulus_margin", "disk_margin", "sensitivity_peak_db", "complementary_peak_db",
    "control_peak_db", "process_peak_db",
)  # fmt: skip


@dataclass(frozen=True)
class Reader:
    """Reads margins off lines: |CS| counts as high from `from_hz` on, responses are compared with `masks`,
    and their norm is that of `weights`."""

    from_hz: float = np.inf
    masks: tuple[Mask, ...] = ()
    weights: tuple[Weight, ...] = ()

    @classmethod
    def of(cls, requirements: Requirements) -> Reader:
        """A reader for the requirements at one operating point."""
        return cls(requirements.control_high_frequency_from_hz or np.inf, requirements.masks, requirements.weights)

    def read(
        self, L: ComplexArray, lines: kernel.Lines, *, bounded: bool = True, least: float = 0.0
    ) -> tuple[Array, Array]:
        """Columns (loops, columns) of the kernel for open loops L (loops, nf), and where they lie in Hz.

        What |L| may do above the last line counts where `bounded`: it stays below its last value, or `least`.
        """
        return kernel.read_margins(_seen(L)[0], *self._asked(lines, bounded, least))

    def read_drawn(
        self, reference: ComplexArray, factor: ComplexArray, draws: ComplexArray, lines: kernel.Lines, *,
        bounded: bool = True, least: float = 0.0,
    ) -> Array:  # fmt: skip
        """Columns (draws, columns) of loops that are drawn, as the kernel has them."""
        one, times, many = _seen(reference, factor, draws)
        return kernel.read_drawn(one, times, many, *self._asked(lines, bounded, least))

    def _asked(self, lines: kernel.Lines, bounded: bool, least: float) -> tuple[kernel.Lines, kernel.Asked]:
        """Lines as the kernel takes them, and what weighs squared magnitudes there; no rows where nothing does."""
        rows = None if self.masks or self.weights else 0
        on, above = _seen(*(over(self.masks, self.weights, x)[:rows] for x in (lines.f, lines.f_above)))
        return kernel.Lines(*_seen(*lines)), kernel.Asked(self.from_hz, on, above, bounded, True, least)


def _seen(*arrays: np.ndarray) -> list[np.ndarray]:
    """Arrays as the kernels are compiled for them, read-only."""
    views = [x.view() for x in arrays]
    for x in views:
        x.setflags(write=False)
    return views


@dataclass(frozen=True, eq=False)
class _Judged:
    """Lines that margins are read from, with the loop's scatter: draws of L are `reference` + `factor` `deviations`."""

    f: Array
    L: ComplexArray
    C: ComplexArray
    reference: ComplexArray | None = None
    factor: ComplexArray | None = None
    deviations: ComplexArray | None = None

    @cached_property
    def drowned(self) -> bool:
        """Whether errors as large as L itself, where L is not small, leave nothing that draws could tell."""
        if self.deviations is None or self.factor is None:
            return False
        size = np.abs(self.L)
        large = size > TOL.drowned_gain
        relative = (np.abs(self.factor) * spread(self.deviations)[1])[large] / size[large]
        return bool(relative.size and np.mean(relative > TOL.drowned_std) > 0.1)

    def drawn_at(self, k: np.ndarray) -> ComplexArray:
        """What draws (draws, m) do to L on some lines k (m,); none where no scatter is known."""
        if self.factor is None or self.deviations is None:
            return np.zeros((0, k.size), dtype=complex)
        return np.asarray(self.factor[k] * self.deviations[:, k])


def margins(loop: Loop, reader: Reader | None = None) -> Margins:
    """Margins of a loop on its FRF's lines; crossings are interpolated between lines.

    - gain margin: the factor that brings L to -1 from within, least over all crossings of the negative real
      axis with |L| < 1, and never more than 1/|L| at the last line: beyond it L is taken to cross somewhere,
      no larger; the reduction margin the same for |L| > 1, as a factor down;
    - phase margin: least rotation, either way, that brings L onto -1 over all 0 dB crossings;
    - delay margin: least delay that does so;
    - modulus margin: least |1 + L|, chords between lines included; peak |S| is its inverse;
    - above the last line |L| is taken to stay below its last value l: there |S| may reach 1/(1 - l), |T|
      l/(1 - l) and |CS| |C|/(1 - l), and the margins and peaks count that; where it decides a number, that number is a
      bound, and `bounds` says how good it may be;
    - a loop without integrators whose gain at 0 Hz is negative crosses the negative real axis there: small models of
      the lowest lines lead to it (`loop.stability.low_end`), and what they disagree about widens the interval;
    - disk margin: least |2 (1 + L)/(1 - L)|, the largest a such that L (1 + d/2)/(1 - d/2) stays off -1 for every
      complex |d| < a (Seiler, Packard and Gahinet, IEEE Control Systems 40(5), 2020, balanced case);
    - bandwidth of S: where |S| first rises through -3 dB (0 where it starts above); of T: where |T| last falls through
      -3 dB (0 where it never reaches it, the last line where it does not fall);
    - masks: by how much each response exceeds its mask at the worst frequency, on the lines and above the last one as
      far as what was stated of it goes; below the first line nothing is judged;
    - norm of the weighted loop: the largest root of the sum of squared weighted responses, on the same lines; above the
      last one each response counts with the most that it may be there;
    - bandwidth: first 0 dB crossing of L, downwards from the lowest line; 0 where it is out of sight. Where L
      starts below 1 small models of the lowest lines lead to it, at most a third of an octave below the first.

    With the loop's `scatter` every number is freed of the bias that noise gives it (the largest of many noisy values
    is too large) and has a 95 % interval: both from what draws of the error do to the same reading (a parametric
    bootstrap; Davison and Hinkley, Bootstrap methods, 1997, chapter 5), normal on the scale of dB, degrees or ln. The
    interval knows the FRF's noise, not what differs from day to day. Without scatter lines are taken at face value:
    the peak of |S| comes out too high. With it L is read between lines too, along splines and the resonances that the
    lines show, and what a spline adds to a straight line widens the interval. Margins mean room only where
    `stable` says "stable".
    """
    j = _judged(loop)
    readings = _readings_from_below(loop, j)
    known, first = _found(loop, j, readings, reader or Reader()), readings[0]
    stability = closed_loop_stability(loop)
    crossings, crossing_intervals = _crossings(first, unit=True)
    phase_crossings, phase_intervals = _crossings(first, unit=False)
    made = Margins.of(
        known.values,
        stability.outcome,
        intervals=known.intervals,
        at_hz=known.at_hz,
        bounds=known.bounds,
        crossings_hz=crossings,
        phase_crossings_hz=phase_crossings,
        stability_reason=stability.reason,
        stability_band_hz=getattr(stability, "band_hz", None),
        missing_hz=tuple((gap.low_hz, gap.high_hz) for gap in gaps_of(loop) if gap.missing),
        last_hz=float(j.f[-1]),
        last_gain=float(abs(j.L[-1])),
        last_slope=slope_at_end(j.f, j.L),
        crossing_intervals_hz=crossing_intervals,
        phase_crossing_intervals_hz=phase_intervals,
    )
    return made.with_readings(**{x.name: function_at(x.read)(loop) for x in LIMITS if x.read})


def controller_bandwidth(loop: Loop) -> Reading:
    """Highest frequency in Hz at which |C| is within 3 dB of its largest."""
    return Reading(controller_bandwidth_hz(loop.controller))


class _Found(NamedTuple):
    """Readings by limit: values, how good bounds may be, intervals, places."""

    values: dict[str, float]
    bounds: dict[str, float]
    intervals: dict[str, Interval]
    at_hz: dict[str, float]

    def worst(self, name: str, value: float, at_hz: float, best: float | None = None) -> None:
        """Make a reading a bound: no worse than `value`, at best as it was read, or as `best`."""
        good = max if LIMIT_OF[name].sense == "at_least" else min
        read = good(self.intervals.get(name, (self.values[name],)))
        self.bounds[name] = self.bounds.get(name, read) if best is None else best
        if name in self.intervals and value != self.values[name]:
            self.intervals[name] = (value, value)
        self.values[name], self.at_hz[name] = value, at_hz

    def nothing(self, name: str) -> None:
        """Take a reading away."""
        self.values[name] = float("nan")
        self.bounds.pop(name, None)
        self.intervals.pop(name, None)


def _found(loop: Loop, j: _Judged, readings: Sequence[_Judged], reader: Reader) -> _Found:
    """What a loop's lines say with what lies below them: the first of the readings, and how the others differ."""
    first = readings[0]
    found, at = _read(loop, first, first.L[None], reader)
    value, low, high = _with_intervals(loop, first, found[0], reader)
    for other in readings[1:]:  # what the models disagree about is as unknown as what noise hides
        _, lower, higher = _with_intervals(loop, other, _read(loop, other, other.L[None], reader)[0][0], reader)
        low, high = np.minimum(low, lower), np.maximum(high, higher)
    bounds = _bounds(loop, first, found[0], reader)
    ends = _values(low), _values(high)
    pairs = {} if j.deviations is None else {n: (ends[0][n], ends[1][n]) for n in ends[0] if n in ends[1]}
    intervals = {n: (min(pair), max(pair)) for n, pair in pairs.items()}
    known = _Found(_values(value), bounds, intervals, _places(at[0], float(j.f[0])))
    if first is j and not is_large(loop) and j.f.size > 1 and j.f[0] > kernel.AT_ZERO * j.f[1]:
        _bounded_below(loop, j, known)
    _bounded_above(loop, j, known)
    _bounded_between(loop, first, reader, known)
    return known


def _bounded_below(loop: Loop, j: _Judged, found: _Found) -> None:
    """What may lie below the first line, where no model tells it and |L| is not large there.

    |L| stays above its value there, so |PS| stays below |T|/|C|. Bandwidths of which the lines show nothing lie
    anywhere below them. A crossover out of sight leaves no phase, delay and reduction margin, and may hide the first
    crossing, the gain margin, and peaks of |S|, |CS| and |PS| of any size.
    """
    first_hz, first, hidden = float(j.f[0]), float(abs(j.L[0])), not in_sight(loop)
    for name in ("bandwidth_hz", "sensitivity_bandwidth_hz"):
        if found.values[name] == 0.0 or hidden:
            found.worst(name, 0.0, first_hz, max(found.values[name], first_hz))
    if found.values["complementary_bandwidth_hz"] == 0.0:
        found.worst("complementary_bandwidth_hz", 0.0, first_hz, first_hz)
    if not hidden:
        C = loop.controller.response(first_hz * BELOW_RATIOS)
        peak_db = float(db(first / max(first - 1.0, 1e-9) / np.abs(C).min()))
        if peak_db > found.values["process_peak_db"]:
            found.worst("process_peak_db", peak_db, first_hz)
        return
    for name in _NEAR_MINUS_ONE:
        found.worst(name, 0.0 if LIMIT_OF[name].sense == "at_least" else np.inf, first_hz)
    for limit in LIMITS:
        if limit.crossing:
            found.nothing(limit.name)


def _bounded_above(loop: Loop, j: _Judged, found: _Found) -> None:
    """Above the last line |L| stays below its last value, and |P| too: how far |T| may still rise, and |PS|."""
    last_hz, last = float(j.f[-1]), max(float(abs(j.L[-1])), loop.largest_above)
    if not loop.above_hz.size:
        return
    room, name = max(1.0 - last, 1e-9), "complementary_bandwidth_hz"
    if last / room >= np.sqrt(0.5):
        found.worst(name, found.values[name], last_hz, np.inf)
    peak_db = float(db(abs(j.L[-1] / j.C[-1]) / room))
    if peak_db > found.values["process_peak_db"]:
        found.worst("process_peak_db", peak_db, last_hz)


def _bounded_between(loop: Loop, j: _Judged, reader: Reader, found: _Found) -> None:
    """Between lines that are missing a resonance may move L without a trace: what that makes of each limit at worst."""
    hidden = hidden_in(loop)
    among = hidden.missing & (hidden.ends_hz[:, 1] <= j.f[-1])
    ends, moved = hidden.ends_hz[among], hidden.moved[among]
    if not ends.size:
        return
    rows = [(j.f >= low_hz) & (j.f <= high_hz) for low_hz, high_hz in ends]
    least = [(np.abs(1.0 + j.L[k]).min(), np.abs(j.L[k]).min(), np.abs(j.C[k]).min()) for k in rows]
    most = [(np.abs(j.L[k]).max(), np.abs(j.C[k]).max()) for k in rows]
    (room, low, least_C), (high, C) = np.transpose(least), np.transpose(most)
    crosses, room, low, high = low > 1.0, np.maximum(room - moved, 0.0), np.maximum(low - moved, 0.0), high + moved
    weights = over(reader.masks, reader.weights, ends.ravel()).reshape(-1, *ends.shape).max(axis=2)
    with np.errstate(divide="ignore"):
        S, T, inner = 1.0 / room, high / room, np.minimum(np.maximum(1.0 - room, 0.0), high)
        CS, PS = C * S, T / least_C
        phase_deg = np.where((low < 1.0) & (high > 1.0), 2.0 * deg(np.arcsin(np.minimum(0.5 * room, 1.0))), np.inf)
        worst = {
            "modulus_margin": room,
            "disk_margin": 2.0 * room / (1.0 + high),
            "sensitivity_peak_db": db(S),
            "complementary_peak_db": db(T),
            "control_peak_db": db(CS),
            "process_peak_db": db(PS),
            "control_high_frequency_db": np.where(ends[:, 1] >= reader.from_hz, db(CS), -np.inf),
            "gain_margin_db": -db(inner),
            "gain_reduction_margin_db": np.where(high > 1.0, db(np.maximum(1.0 + room, low)), np.inf),
            "phase_margin_deg": phase_deg,
            "delay_margin_s": phase_deg / 360.0 / ends[:, 1],
            "bandwidth_hz": np.where(crosses & (low < 1.0), ends[:, 0], np.inf),
            "sensitivity_bandwidth_hz": np.where(2.0 * room**2 < 1.0, ends[:, 0], np.inf),
        }
        squares = np.array([S, T, CS, PS, high, 1.0 / low, S, T, CS, PS]) ** 2
        weighed = np.multiply(weights, squares, out=np.zeros_like(weights), where=weights > 0.0)
        worst |= {name: 0.5 * db(row) for name, row in zip(MASKED, weighed, strict=False)}
        worst["weighted_norm"] = np.sqrt(weighed[len(MASKED) :].sum(axis=0))
    for name, values in worst.items():
        falls = LIMIT_OF[name].sense == "at_least"
        k = int(np.argmin(values) if falls else np.argmax(values))
        if name in found.values and (values[k] < found.values[name] if falls else values[k] > found.values[name]):
            at_hz = found.at_hz.get(name, 0.0)
            guessed = bool(((ends[:, 0] < at_hz) & (at_hz < ends[:, 1])).any())  # read off the lines on both sides
            best = (np.inf if falls else -np.inf) if guessed else None
            found.worst(name, float(values[k]), float(np.sqrt(ends[k].prod())), best)


def _judged(loop: Loop) -> _Judged:
    if loop.scatter is None:
        return _Judged(loop.frequency_hz, loop.L, loop.C)
    dense, own = interpolated(loop)
    return _Judged(dense.frequency_hz, own * dense.response, own, own * dense.reference, own, by_draw(dense.deviations))


def _from_below(loop: Loop, j: _Judged, model: LowModel) -> _Judged:
    """The lines with those before them as a model tells them, down to 0 Hz where L is finite there.

    Where L starts on the negative real axis it crosses that at 0 Hz, from the mirrored side.
    """
    finite = poles_at_0(loop) <= 0
    f = j.f[0] * (BELOW_RATIOS if finite else BELOW_RATIOS[1:])
    C = loop.controller.response(f)
    L = C * model.response(f)
    if finite:
        L[0] = complex(L[0].real, -1e-9 * abs(L[0]) * (1.0 if L[1].imag >= 0.0 else -1.0) * (L[0].real < 0.0))
    reference = factor = deviations = None
    if loop.scatter is not None and j.deviations is not None and j.reference is not None and j.factor is not None:
        moved = C * model.deviations(f, loop.scatter.deviations)
        if finite:
            moved[:, 0] = moved[:, 0].real
        reference = np.concatenate([L, j.reference])
        factor = np.concatenate([np.ones(f.size), j.factor])
        deviations = by_draw(np.concatenate([moved, j.deviations], axis=1))
    f, L, C = np.concatenate([f, j.f]), np.concatenate([L, j.L]), np.concatenate([C, j.C])
    return _Judged(f, L, C, reference, factor, deviations)


def _readings_from_below(loop: Loop, j: _Judged) -> list[_Judged]:
    """The lines with what lies below them, once for each model that tells it.

    As they are where L is large at the first, or where its crossover is out of sight.
    """
    if loop.integrators is None or is_large(loop) or not in_sight(loop):
        return [j]
    return [_from_below(loop, j, model) for model in low_models(loop)] or [j]


def _read(loop: Loop, j: _Judged, L: ComplexArray, reader: Reader, *, bounded: bool = True) -> tuple[Array, Array]:
    return reader.read(L, _lines(loop, j), bounded=bounded, least=loop.largest_above)


def _lines(loop: Loop, j: _Judged) -> kernel.Lines:
    return kernel.Lines(j.f, j.C, loop.above_hz, loop.C_above)


def _bounds(loop: Loop, j: _Judged, found: Array, reader: Reader) -> dict[str, float]:
    """How good the quantities may be that what lies above the last line bounds: the good end of what lines alone tell.

    A bandwidth that the lines do not reach is at least their last frequency.
    """
    best, _ = _read(loop, j, j.L[None], reader, bounded=False)
    ends = {x.name: float("inf") for x, k in _COLUMNS if x.open and found[k] == np.log(j.f[-1])}
    bounded = found != best[0]
    if not bounded.any():
        return ends
    _, low, high = _with_intervals(loop, j, best[0], reader, bounded=False)
    better = np.where(best[0] > found, np.maximum(low, high), np.minimum(low, high))
    good = _values(np.where(bounded, better, np.nan))
    return ends | {name: value for name, value in good.items() if not np.isnan(value)}


def _with_intervals(
    loop: Loop, j: _Judged, found: Array, reader: Reader, *, bounded: bool = True
) -> tuple[Array, Array, Array]:
    """Each column freed of its bias, with the ends of its interval."""
    if j.deviations is None or j.reference is None or j.factor is None:
        return found, found, found
    lines, least = _lines(loop, j), loop.largest_above
    drawn = reader.read_drawn(j.reference, j.factor, j.deviations, lines, bounded=bounded, least=least)
    reference, _ = _read(loop, j, j.reference[None], reader, bounded=bounded)
    if j.drowned:
        return found, np.full_like(found, -np.inf), np.full_like(found, np.inf)
    ordered = np.sort(drawn, axis=0)
    usual = np.isfinite(drawn).all(axis=0) & np.isfinite(reference[0]) & np.isfinite(found)
    usual &= _of_one_piece(np.where(usual, ordered, 0.0))
    for limit, column in _COLUMNS:
        if np.isfinite(limit.distance):
            usual[column] = usual[column] and drawn[:, column].std() <= limit.distance
    shift = np.where(usual, drawn - np.where(usual, reference, 0.0), 0.0)
    value = found - shift.mean(axis=0)
    reach = np.hypot(TOL.half_width_std * shift.std(axis=0), _between(loop, j, reference[0], reader, bounded))
    # where draws jump, never come to the crossing or come as near to -1 as L itself, their own order tells
    k = round(0.025 * (len(drawn) - 1))
    low = np.where(usual, value - reach, np.minimum(ordered[k], found))
    return value, low, np.where(usual, value + reach, np.maximum(ordered[-1 - k], found))


def _between(loop: Loop, j: _Judged, found: Array, reader: Reader, bounded: bool) -> Array:
    """How far columns may be off because lines are joined by chords: half of what changes with every other line.

    Where L bends evenly, chords over two gaps, even and odd ones in the mean, are off by a quarter of a gap's bend more
    than those over one, which are off by an eighth at most.
    """
    assert j.reference is not None
    changes = np.zeros((2, found.size))
    for first, change in enumerate(changes):
        kept = np.arange(j.f.size) % 2 == first
        kept[[0, -1]] = True
        lines = kernel.Lines(j.f[kept], j.C[kept], loop.above_hz, loop.C_above)
        coarse, _ = reader.read(j.reference[None, kept], lines, bounded=bounded, least=loop.largest_above)
        both = np.isfinite(coarse[0]) & np.isfinite(found)
        np.subtract(coarse[0], found, out=change, where=both)
    return 0.5 * np.asarray(np.abs(changes).mean(axis=0))


def _of_one_piece(ordered: Array) -> np.ndarray:
    """Whether ordered draws (n, columns) scatter as about one value, and do not jump from one crossing to another.

    They do not where their deviation is twice what their middle two thirds tell, or all lie within two deviations.
    """
    last = len(ordered) - 1
    spread = ordered.std(axis=0)
    core = (ordered[round(0.84 * last)] - ordered[round(0.16 * last)]) / 1.989
    tiny = 1e-12
    return np.asarray((spread <= 2.0 * core + tiny) & (ordered[-1] - ordered[0] >= 4.0 * spread - tiny))


def _values(columns: Array) -> dict[str, float]:
    """Quantities by name from the kernel's columns; a bias taken off may lead out of what can be."""
    read = [(x, columns[k]) for x, k in _COLUMNS if not x.asked or columns[k] > -np.inf]
    out = {x.name: float(x.value(column)) for x, column in read}
    for limit, _ in read:
        if limit.ceiling is not None and np.isfinite(out[limit.name]):
            out[limit.name] = min(max(out[limit.name], 0.0), limit.ceiling)
    return out


def _places(at: Array, first_hz: float) -> dict[str, float]:
    """Frequencies in Hz by quantity; 0 where the crossing lies there."""
    return {x.name: float(at[k]) if at[k] > 1e-3 * first_hz else 0.0 for x, k in _COLUMNS if np.isfinite(at[k])}


def _crossings(j: _Judged, *, unit: bool) -> tuple[tuple[float, ...], tuple[Interval, ...]]:
    """All 0 dB crossings, or crossings of the negative real axis, with the 95 % interval of each frequency."""
    f = unit_crossings(j.f, j.L) if unit else axis_crossings(j.f, j.L)
    if j.deviations is None:
        return tuple(f.tolist()), ()
    k = np.clip(np.searchsorted(j.f, f) - 1, 0, max(j.f.size - 2, 0))
    if unit:
        error = np.std((j.drawn_at(k) / j.L[k]).real, axis=0)
        rise = np.abs(np.log(np.abs(j.L[k + 1] / j.L[k])) / np.log(j.f[k + 1] / j.f[k]))
    else:
        error = np.std(j.drawn_at(k).imag, axis=0)
        rise = np.abs((j.L[k + 1] - j.L[k]).imag / np.log(j.f[k + 1] / j.f[k]))
    reach = np.exp(np.minimum(TOL.half_width_std * error / np.maximum(rise, 1e-12), 50.0))
    return tuple(f.tolist()), tuple(zip((f / reach).tolist(), (f * reach).tolist(), strict=True))
