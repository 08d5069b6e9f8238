"""What a tuning is judged by at a point x: bandwidths and the room each requirement leaves, with slopes.

Room is scaled to be of order one: 0 at the limit, negative beyond. Between lines ln L is linear in ln f.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from loopshape.check.stability import count_unstable
from loopshape.tune.problem import Problem
from loopshape.units import TWO_PI, Array, ComplexArray, from_db, rad


@dataclass(frozen=True, eq=False)
class Measures:
    """ln bandwidth (points,) with slopes (points, n); rooms (m,) with slopes (m, n), each with what and where.

    `what` (m,) indexes `Margins`' names, `at` (m,) the flat line nearest to it. `stable` tells whether the
    bare Nyquist count is zero at every operating point.
    """

    ln_bandwidth: Array
    bandwidth_slopes: Array
    room: Array
    room_slopes: Array
    what: list[str]
    at: np.ndarray
    stable: bool

    @property
    def worst(self) -> float:
        """Least room, +inf where nothing is required."""
        return float(self.room.min()) if self.room.size else np.inf


@dataclass(eq=False)
class _Rows:
    room: list[Array]
    slopes: list[Array]
    what: list[str]
    at: list[np.ndarray]

    def add(self, what: str, room: Array, slopes: Array, at: np.ndarray) -> None:
        self.room.append(room)
        self.slopes.append(slopes)
        self.what += [what] * room.size
        self.at.append(at)


def measure(p: Problem, x: Array, tighten: dict[str, float]) -> Measures:
    """Measures at x; `tighten` moves limits inward by these amounts (in their own unit)."""
    C = p.response(x)
    L = C * p.P
    dlnC = p.slopes(x)
    rows = _Rows([], [], [], [])
    limits = {k: v for k, v in vars(p.requirements).items() if isinstance(v, (int, float))}
    _peaks(p, x, limits, tighten, C, L, dlnC, rows)
    ln_f, ln_f_slopes = _crossings(p, limits, tighten, L, dlnC, rows)
    n = dlnC.shape[0]
    return Measures(
        ln_bandwidth=ln_f,
        bandwidth_slopes=ln_f_slopes,
        room=np.concatenate([np.zeros(0), *rows.room]),
        room_slopes=np.concatenate([np.zeros((0, n)), *rows.slopes]),
        what=rows.what,
        at=np.concatenate([np.zeros(0, dtype=int), *rows.at]),
        stable=_stable(p, x, L),
    )


def _stable(p: Problem, x: Array, L: ComplexArray) -> bool:
    below, a, b = p.below(x), p.first, p.first_below
    for i, (k, u) in enumerate(zip(p.integrators, p.unstable, strict=True)):
        mine = L[a[i] : a[i + 1]]
        if abs(mine[-1]) >= 1.0 or count_unstable(mine, int(k), int(u), below[b[i] : b[i + 1]]) != 0:
            return False
    return True


def _peaks(
    p: Problem, x: Array, limits: dict[str, float], tighten: dict[str, float], C: ComplexArray, L: ComplexArray,
    dlnC: ComplexArray, rows: _Rows,
) -> None:  # fmt: skip
    """Rooms of |S|, |T|, |CS| at their local peaks: limits on ln of a magnitude, whose slope is Re(factor dlnC)."""
    S = 1.0 / (1.0 + L)
    T = L * S
    cases = (
        ("sensitivity_peak_db", S, -T),
        ("modulus_margin", S, -T),
        ("complementary_peak_db", T, S),
        ("control_peak_db", C * S, S),
        ("control_high_frequency_db", C * S, S),
    )
    for name, response, factor in cases:
        if name not in limits:
            continue
        if name == "modulus_margin":
            limit = -np.log(limits[name] + tighten.get(name, 0.0))
        else:
            limit = float(np.log(from_db(limits[name] - tighten.get(name, 0.0))))
        size = np.log(np.abs(response))
        chosen = _local_peaks(p, size, limit - 0.7)
        from_hz = limits["control_high_frequency_from_hz"] if name == "control_high_frequency_db" else 0.0
        chosen = chosen[p.f[chosen] >= from_hz]
        slopes = np.real(factor[chosen] * dlnC[:, chosen]).T
        rows.add(name, limit - size[chosen], -slopes, chosen)
        _peaks_above(p, x, name, limit, from_hz, L, dlnC, rows)


def _peaks_above(
    p: Problem, x: Array, name: str, limit: float, from_hz: float, L: ComplexArray, dlnC: ComplexArray, rows: _Rows
) -> None:
    """Rooms above the last lines, where |L| <= l, its last value: |S| <= 1/(1-l), |T| <= l/(1-l), |CS| <= |C|/(1-l)."""
    last = p.first[1:] - 1
    ln_last = np.log(np.minimum(np.abs(L[last]), 0.999999))
    share = np.exp(ln_last)
    worst_S, slope_S = -np.log1p(-share), (share / (1.0 - share))[:, None] * dlnC[:, last].real.T
    if name == "complementary_peak_db":
        rows.add(name, limit - ln_last - worst_S, -slope_S - dlnC[:, last].real.T, last)
    elif not name.startswith("control_"):
        rows.add(name, limit - worst_S, -slope_S, last)
    elif p.f_above.size:
        C, slopes = p.above(x)
        worst = int(np.argmax(worst_S))
        size = np.where(p.f_above >= from_hz, np.log(np.abs(C)) + worst_S[worst], -np.inf)
        chosen = np.flatnonzero(size > max(size.max() - 0.05, limit - 0.7))
        rows.add(name, limit - size[chosen], -slopes[:, chosen].real.T - slope_S[worst], p.f.size + chosen)


def _local_peaks(p: Problem, size: Array, above: float) -> np.ndarray:
    """Flat lines that are local maxima, or their neighbours, and lie above a level."""
    inner = np.concatenate([[-np.inf], size, [-np.inf]])
    peak = (inner[1:-1] >= inner[:-2]) & (inner[1:-1] >= inner[2:])
    peak[p.first[:-1]] = peak[p.first[1:] - 1] = True
    near = peak.copy()
    near[1:] |= peak[:-1]
    near[:-1] |= peak[1:]
    return np.flatnonzero(near & (size > above))


def _crossings(
    p: Problem, limits: dict[str, float], tighten: dict[str, float], L: ComplexArray, dlnC: ComplexArray, rows: _Rows
) -> tuple[Array, Array]:
    """Rooms at 0 dB and at real-axis crossings; gives ln bandwidth (points,) and its slopes (points, n)."""
    size, ln_f = np.log(np.abs(L)), np.log(p.f)
    inside = np.ones(p.f.size - 1, dtype=bool)
    inside[p.first[1:-1] - 1] = False
    turn = np.angle(L[1:] / L[:-1])

    k = np.flatnonzero((size[:-1] * size[1:] < 0.0) & inside)
    share = size[k] / (size[k] - size[k + 1])
    local = dlnC[:, k] + share * (dlnC[:, k + 1] - dlnC[:, k])
    span = ln_f[k + 1] - ln_f[k]
    move = -local.real * span / (size[k + 1] - size[k])  # d ln f_c/d x
    phase_slope = (local.imag + turn[k] / span * move).T
    phase = np.angle(L[k]) + share * turn[k]
    crossing = ln_f[k] + share * span
    _phase_rooms(limits, tighten, k, phase, phase_slope, crossing, move.T, rows)

    _gain_rooms(p, limits, tighten, L, size, turn, dlnC, inside, rows)

    owner = np.searchsorted(p.first, k, side="right") - 1
    return _bandwidths(p, limits, tighten, size, dlnC, k, owner, crossing, move.T, rows)


def _phase_rooms(
    limits: dict[str, float], tighten: dict[str, float], k: np.ndarray, phase: Array, slope: Array,
    crossing: Array, move: Array, rows: _Rows,
) -> None:  # fmt: skip
    ahead = (phase + np.pi) % (TWO_PI)  # rotation by lag onto -1
    if "phase_margin_deg" in limits:
        wished = float(rad(limits["phase_margin_deg"] + tighten.get("phase_margin_deg", 0.0)))
        lag = ahead <= np.pi
        either = np.where(lag, ahead, TWO_PI - ahead)
        rows.add("phase_margin_deg", either - wished, np.where(lag, 1.0, -1.0)[:, None] * slope, k)
    if "delay_margin_s" in limits:
        wished = limits["delay_margin_s"] + tighten.get("delay_margin_s", 0.0)
        ln_delay = np.log(np.maximum(ahead, 1e-12) / (TWO_PI)) - crossing
        rows.add("delay_margin_s", ln_delay - np.log(wished), slope / np.maximum(ahead, 1e-12)[:, None] - move, k)


def _gain_rooms(
    p: Problem, limits: dict[str, float], tighten: dict[str, float], L: ComplexArray, size: Array, turn: Array,
    dlnC: ComplexArray, inside: np.ndarray, rows: _Rows,
) -> None:  # fmt: skip
    if "gain_margin_db" not in limits and "gain_reduction_margin_db" not in limits:
        return
    to_axis = np.angle(-L)
    k = np.flatnonzero((to_axis[:-1] * to_axis[1:] <= 0.0) & (np.abs(turn) > 0.0) & inside)
    share = -to_axis[k] / turn[k]
    good = (share >= 0.0) & (share <= 1.0) & (np.abs(to_axis[k]) < 0.75 * np.pi)
    k, share = k[good], share[good]
    local = dlnC[:, k] + share * (dlnC[:, k + 1] - dlnC[:, k])
    value = size[k] + share * (size[k + 1] - size[k])
    slope = (local.real - local.imag * (size[k + 1] - size[k]) / turn[k]).T
    for name, rows_k, sign in (("gain_margin_db", value <= 0.0, -1.0), ("gain_reduction_margin_db", value > 0.0, 1.0)):
        if name in limits:
            wished = float(np.log(from_db(limits[name] + tighten.get(name, 0.0))))
            rows.add(name, sign * value[rows_k] - wished, sign * slope[rows_k], k[rows_k])
    if "gain_margin_db" in limits:
        wished = float(np.log(from_db(limits["gain_margin_db"] + tighten.get("gain_margin_db", 0.0))))
        last = p.first[1:] - 1
        rows.add("gain_margin_db", -size[last] - wished, -dlnC[:, last].real.T, last)


def _bandwidths(
    p: Problem, limits: dict[str, float], tighten: dict[str, float], size: Array, dlnC: ComplexArray,
    k: np.ndarray, owner: np.ndarray, crossing: Array, move: Array, rows: _Rows,
) -> tuple[Array, Array]:  # fmt: skip
    """First downward crossing of each operating point; below the lowest line along the integrators' slope."""
    points = p.first.size - 1
    ln_f, slopes = np.empty(points), np.empty((points, dlnC.shape[0]))
    at = p.first[:-1].copy()
    for i in range(points):
        a = p.first[i]
        mine = np.flatnonzero(owner == i)
        if size[a] >= 0.0 and mine.size:
            ln_f[i], slopes[i], at[i] = crossing[mine[0]], move[mine[0]], k[mine[0]]
        else:
            order = max(int(p.integrators[i]), 1)
            ln_f[i], slopes[i] = np.log(p.f[a]) + size[a] / order, dlnC[:, a].real / order
    if "bandwidth_hz" in limits:
        wished = float(np.log(limits["bandwidth_hz"] + tighten.get("bandwidth_hz", 0.0)))
        rows.add("bandwidth_hz", ln_f - wished, slopes, at)
    return ln_f, slopes
