"""Loop -> Margins, by definition, from the lines of a measured plant."""

from __future__ import annotations

import numpy as np

from loopshape.check.crossings import (
    axis_crossings,
    first_level_crossing,
    last_level_crossing,
    nearest_to_minus_one,
    unit_crossings,
)
from loopshape.check.low_end import judged_lines
from loopshape.check.stability import closed_loop_stability
from loopshape.loop import Loop
from loopshape.requirements import Margins
from loopshape.units import Array, ComplexArray, db, deg

INF = float("inf")
#: -3 dB
HALF_POWER = float(np.sqrt(0.5))


def margins(loop: Loop, *, high_frequency_from_hz: float | None = None) -> Margins:
    """Margins of a loop on its FRF's lines; crossings are interpolated between lines.

    - gain margin: the factor that brings L to -1 from within, least over all crossings of the negative real
      axis with |L| < 1, and never more than 1/|L| at the last line: beyond it L is taken to cross somewhere,
      no larger; the reduction margin the same for |L| > 1, as a factor down;
    - phase margin: least rotation, either way, that brings L onto -1 over all 0 dB crossings;
    - delay margin: least delay that does so;
    - modulus margin: least |1 + L|, chords between lines included; peak |S| is its inverse;
    - above the last line |L| is taken to stay below its last value l: there |S| may reach 1/(1 - l), |T|
      l/(1 - l) and |CS| |C|/(1 - l), and the margins and peaks count that;
    - disk margin: least |2 (1 + L)/(1 - L)|, the largest a such that L (1 + d/2)/(1 - d/2) stays off -1 for every
      complex |d| < a (Seiler, Packard and Gahinet, IEEE Control Systems 40(5), 2020, balanced case);
    - bandwidth of S: where |S| first rises through -3 dB (0 where it starts above); of T: where |T| last falls through
      -3 dB (0 where it never reaches it, the last line where it does not fall);
    - bandwidth: first 0 dB crossing of L, downwards from the lowest line; 0 where it is out of sight. Where L
      starts below 1 a fit's model leads to it, at most an octave below the first line.

    Read from noisy lines at their face value: the peak of |S| comes out too high, the margins too small. A
    resonance between two lines is not seen. Margins mean room only where `stable` says "stable".
    """
    f, L, C = judged_lines(loop) or (loop.frequency_hz, loop.L, loop.C)
    at_hz: dict[str, float] = {}
    unit_f, unit_L = unit_crossings(f, L)
    axis_f, axis_L = axis_crossings(f, L)
    phase, delay = _phase_and_delay(unit_f, unit_L, at_hz) if abs(L[-1]) < 1.0 else (0.0, 0.0)
    gain, reduction = _gain(axis_f, axis_L, f[-1], float(abs(L[-1])), at_hz)
    distance = _distance(f, L, at_hz)
    worst_S = 1.0 / max(1.0 - float(abs(L[-1])), 1e-9)  # above the last line, at most
    S = 1.0 / (1.0 + L)
    f_all = np.concatenate([f, loop.above_hz])
    CS = np.concatenate([C * S, loop.controller.response(loop.above_hz) * worst_S])
    high = f_all >= (np.inf if high_frequency_from_hz is None else high_frequency_from_hz)
    stability = closed_loop_stability(loop)
    return Margins(
        gain_margin_db=gain,
        gain_reduction_margin_db=reduction,
        phase_margin_deg=phase,
        modulus_margin=distance,
        delay_margin_s=delay,
        sensitivity_peak_db=float(-db(distance)),
        complementary_peak_db=_peak(
            np.append(f, f[-1]), np.append(L * S, abs(L[-1]) * worst_S), "complementary_peak_db", at_hz
        ),
        control_peak_db=_peak(f_all, CS, "control_peak_db", at_hz),
        control_high_frequency_db=_peak(f_all[high], CS[high], "control_high_frequency_db", at_hz),
        process_peak_db=_peak(f, L / C * S, "process_peak_db", at_hz),
        disk_margin=_disk(f, L, at_hz),
        sensitivity_bandwidth_hz=first_level_crossing(f, np.abs(S), HALF_POWER, rising=True),
        complementary_bandwidth_hz=last_level_crossing(f, np.abs(L * S), HALF_POWER),
        bandwidth_hz=float(unit_f[0]) if abs(L[0]) >= 1.0 and unit_f.size else 0.0,
        crossings_hz=tuple(unit_f.tolist()),
        phase_crossings_hz=tuple(axis_f.tolist()),
        at_hz=at_hz,
        stable=stability.outcome,
        stability_reason=stability.reason,
    )


def _distance(f: Array, L: ComplexArray, at_hz: dict[str, float]) -> float:
    """Least |1 + L|, which above the last line may come down to 1 - |L| there."""
    distance, where = nearest_to_minus_one(f, L)
    beyond = max(1.0 - float(abs(L[-1])), 0.0)
    if beyond < distance:
        distance, where = beyond, float(f[-1])
    at_hz["modulus_margin"] = at_hz["sensitivity_peak_db"] = where
    return distance


def _phase_and_delay(f: Array, L: ComplexArray, at_hz: dict[str, float]) -> tuple[float, float]:
    if not f.size:
        return INF, INF
    ahead = deg(np.angle(-L)) % 360.0  # rotation by lag that brings L onto -1, in [0, 360)
    either = np.minimum(ahead, 360.0 - ahead)
    delay = ahead / 360.0 / f
    at_hz["phase_margin_deg"] = float(f[np.argmin(either)])
    at_hz["delay_margin_s"] = float(f[np.argmin(delay)])
    return float(either.min()), float(delay.min())


def _gain(f: Array, L: Array, last_hz: float, last: float, at_hz: dict[str, float]) -> tuple[float, float]:
    """Gain margin and reduction margin from real-axis crossings, the first bounded by |L| at the last line."""
    sizes = np.append(db(L), -np.inf)
    inside = sizes <= 0.0
    down = np.where(inside, -sizes, np.inf)
    down[-1] = max(float(-db(last)), 0.0)  # beyond the last line, no larger
    places = np.append(f, last_hz)
    k = int(np.argmin(down))
    at_hz["gain_margin_db"] = float(places[k])
    if inside[:-1].all():
        return float(down[k]), INF
    up = np.where(inside, np.inf, sizes)
    at_hz["gain_reduction_margin_db"] = float(places[np.argmin(up)])
    return float(down[k]), float(up.min())


def _disk(f: Array, L: ComplexArray, at_hz: dict[str, float]) -> float:
    """Least |2 (1 + L)/(1 - L)| over the lines, 2 at most where |L| dies out above the last line."""
    with np.errstate(divide="ignore"):
        radius = np.abs(2.0 * (1.0 + L) / (1.0 - L))
    k = int(np.argmin(radius))
    at_hz["disk_margin"] = float(f[k])
    return float(min(radius[k], 2.0 * max(1.0 - abs(L[-1]), 0.0) / (1.0 + abs(L[-1]))))


def _peak(f: Array, response: ComplexArray, name: str, at_hz: dict[str, float]) -> float:
    if not f.size:
        return -INF
    k = int(np.argmax(np.abs(response)))
    at_hz[name] = float(f[k])
    return float(db(response[k]))
