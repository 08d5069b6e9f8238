"""How far a high-order controller gets under the limits that a bound counts, for one plant: the bound from below.

Q is a sum of fixed stable functions, so the limits are convex in its coefficients (Boyd and Barratt, Linear controller
design, 1991). The largest violation is made small by Newton's method on its smooth maximum. What is
found is a controller, on the nodes and not realised; between what it reaches and the bound lies the best possible.

Phase, gain and delay margins are no convex sets, but half-planes that are enough for them are. |L| = 1 is Re S = 1/2
and the phase margin there is 2 asin(1/(2 |S|)): with Re S <= 1/2 up to the bandwidth, Re S >= 1/2 beyond and |S| small
enough on either side of it, L crosses 1 there alone and with its margin. L = -1/g is S = g/(g - 1): below that for Re S
every passage of the axis within 1 keeps the gain margin g, and above -1/(g - 1) every one beyond the margin downwards.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from loopshape.core.json_ready import Plain, keys
from loopshape.core.units import TWO_PI, Array, ComplexArray, from_db, rad
from loopshape.data.requirement.requirements import Requirements
from loopshape.loop.loop import Loop
from loopshape.toolbox.limits.bound_nodes import Ceilings, Nodes, impossible, nodes
from loopshape.toolbox.limits.bound_regions import own_ceilings

#: dampings of Q's pairs across the nodes and at the bandwidth tried
WIDE, NEAR = (0.4, 0.12), (0.2, 0.1, 0.05)


@dataclass(frozen=True, eq=False)
class Reached(Plain):
    """A bandwidth that a controller of many parameters reaches on one plant, with its L and C (n,) at nodes f (n,).

    0 where none was found, or where no limit says what to keep to. The counted limits are kept, and the margins
    where they were asked for.
    """

    IN_JSON = keys("recording", "bandwidth_hz", "parameters")

    recording: str
    bandwidth_hz: float
    parameters: int
    f: Array
    L: ComplexArray
    C: ComplexArray


def achieved(
    loop: Loop, limits: Requirements, bound_hz: float, density: int = 8, steps: int = 8, *, margins: bool = False
) -> Reached:
    """The largest bandwidth, by `steps` bisections below `bound_hz`, that a Q of `density` poles a decade reaches.

    With `margins` the half-planes of phase, gain and delay margins are kept too: enough for them, not needed.
    """
    at = nodes(loop, limits)
    most = own_ceilings(at, limits)
    best = Reached(loop.plant.recording, 0.0, 0, at.f, np.zeros(0, complex), np.zeros(0, complex))
    low, high = float(loop.frequency_hz[0]), min(bound_hz, float(loop.frequency_hz[-1]))
    if impossible(limits) or not any(np.isfinite(ceiling).any() for ceiling in (most.S, most.CS, most.disk)):
        return best
    for _ in range(steps):
        tried = float(np.sqrt(low * high))
        found = reached_at(loop, limits, tried, density, margins=margins)
        low, high, best = (low, tried, best) if found is None else (tried, high, found)
    return best


def reached_at(
    loop: Loop, limits: Requirements, tried_hz: float, density: int = 8, *, margins: bool = False
) -> Reached | None:
    """A controller of this bandwidth with room to its limits where there is some, None where none was found."""
    at = nodes(loop, limits)
    Q = _feasible(at, own_ceilings(at, limits), tried_hz, density, limits if margins else None)
    if Q is None:
        return None
    S, CS = at.s0 + at.s1 * Q[0], at.r0 + at.r1 * Q[0]
    return Reached(loop.plant.recording, tried_hz, Q[1], at.f, at.P * CS / S, CS / S)


def _feasible(
    at: Nodes, most: Ceilings, tried_hz: float, density: int, margins: Requirements | None
) -> tuple[ComplexArray, int] | None:
    """Q at the nodes with the number of its parameters, None where the limits could not be kept."""
    most = most if margins is None else _crossing_with_margin(at, most, tried_hz, margins)
    size = np.abs(at.s1) / np.where(np.isfinite(most.S), most.S, np.inf) + np.abs(at.r1) / most.CS
    basis = _orthonormal(_functions(at, tried_hz, density), np.maximum(size, 1e-12))
    rows = [
        (at.s0, at.s1, most.S),
        (at.r0, at.r1, most.CS),
        (at.s0 - 0.5, at.s1, np.where(np.isfinite(most.S), most.disk, np.inf)),
    ]
    kept = [(a[ok], b[ok, None] * basis[ok], m[ok]) for a, b, m in rows if (ok := np.isfinite(m)).any()]
    a, B, m = (np.concatenate(part) for part in zip(*kept, strict=True))
    sign, value, where = (np.concatenate(part) for part in zip(*half_planes(at, tried_hz, margins), strict=True))
    line = sign[:, None] * np.real(at.s1[where, None] * basis[where])
    found = _least_violation(a / m, B / m[:, None], sign * (np.real(at.s0[where]) - value), line)
    return None if found is None else (basis @ found, basis.shape[1])


def half_planes(at: Nodes, tried_hz: float, margins: Requirements | None) -> list[tuple[Array, Array, np.ndarray]]:
    """Half-planes sign (Re S - value) <= 0 at nodes `where`: |L| >= 1 up to a bandwidth, and what margins add."""
    lines, below = np.flatnonzero(at.inside), at.f < tried_hz
    asked = [(1.0, 0.5, lines[below[lines]])]
    if margins is not None:
        asked.append((-1.0, 0.5, lines[~below[lines]]))
        g, down = (float(from_db(x or 0.0)) for x in (margins.gain_margin_db, margins.gain_reduction_margin_db))
        asked += [(1.0, g / (g - 1.0), lines)] if g > 1.0 else []
        asked += [(-1.0, -1.0 / (down - 1.0), lines)] if down > 1.0 else []
    return [(np.full(where.size, sign), np.full(where.size, value), where) for sign, value, where in asked]


def _crossing_with_margin(at: Nodes, most: Ceilings, tried_hz: float, margins: Requirements) -> Ceilings:
    """Ceilings with |S| on either side of the bandwidth as small as the phase and the delay margin ask."""
    phase = float(rad(margins.phase_margin_deg or 0.0))
    phase = max(phase, TWO_PI * tried_hz * (margins.delay_margin_s or 0.0))
    k = int(np.searchsorted(at.f, tried_hz))
    S = most.S.copy()
    if phase > 0.0:
        S[k - 1 : k + 1] = np.minimum(S[k - 1 : k + 1], 0.5 / np.sin(0.5 * min(phase, np.pi)))
    return replace(most, S=S)


def _functions(at: Nodes, tried_hz: float, density: int) -> ComplexArray:
    """1, p/(s + p) and pairs over the lines and a decade on either side, closer about the bandwidth tried."""
    w, lines, s = at.s.imag, at.s.imag[at.inside], at.s
    low, high = max(w[0], lines[0] / 10.0), min(w[-1], 20.0 * lines[-1])
    count = max(2, round(density * np.log10(high / low)))
    poles = np.geomspace(low, high, count)
    tried = float(np.interp(tried_hz, at.f, w))
    pairs = [(x, d) for x in poles for d in WIDE] + [(tried, d) for d in NEAR]
    columns = [np.ones_like(s), *(p / (s + p) for p in poles)]
    for x, d in pairs:
        below = s * s + 2.0 * d * x * s + x * x
        columns += [x * x / below, x * s / below]
    return np.array(columns).T


def _orthonormal(functions: ComplexArray, scale: Array) -> ComplexArray:
    stacked = np.concatenate([(functions * scale[:, None]).real, (functions * scale[:, None]).imag])
    u, sizes, _ = np.linalg.svd(stacked / np.linalg.norm(stacked, axis=0), full_matrices=False)
    u = u[:, sizes > 1e-8 * sizes[0]]
    return (u[: scale.size] + 1j * u[scale.size :]) / scale[:, None]


def _least_violation(a: ComplexArray, B: ComplexArray, b: Array, line: Array) -> Array | None:
    """x with |a + B x| <= 1 and b + line x <= 0 throughout, None where Newton's method finds none."""
    x = np.zeros(B.shape[1])
    newton_steps = 40
    # smoothing of the largest violation, from coarse to fine
    for smoothing in (0.3, 0.1, 0.03, 0.01, 0.003, 0.001, 3e-4):
        for _ in range(newton_steps):
            value, share, z = _smooth(a, B, b, line, x, smoothing)
            if max(np.abs(z).max() - 1.0, np.max(b + line @ x, initial=-np.inf)) <= 0.0:
                return x
            step, promised = _newton(B, line, share, z, smoothing)
            if promised < 1e-3 * smoothing:
                break
            t = 1.0
            while not _smooth(a, B, b, line, x + t * step, smoothing)[0] <= value - 0.1 * t * promised:
                t *= 0.5
                if t < 1e-5:
                    return None
            x = x + t * step
    return None


def _smooth(
    a: ComplexArray, B: ComplexArray, b: Array, line: Array, x: Array, smoothing: float
) -> tuple[float, Array, ComplexArray]:
    """Smooth maximum of all violations, the share of each in it, and a + B x."""
    z = a + B @ x
    violations = np.concatenate([np.abs(z) ** 2 - 1.0, b + line @ x])
    top = violations.max()
    share = np.exp((violations - top) / smoothing)
    total = share.sum()
    return float(top + smoothing * np.log(total)), share / total, z


def _newton(B: ComplexArray, line: Array, share: Array, z: ComplexArray, smoothing: float) -> tuple[Array, float]:
    slopes = np.concatenate([2.0 * np.real(np.conj(z)[:, None] * B), line])
    slope = share @ slopes
    curvature = (slopes.T * (share / smoothing)) @ slopes - np.outer(slope, slope) / smoothing
    for part in (B.real, B.imag):
        curvature += (part.T * (2.0 * share[: z.size])) @ part
    curvature[np.diag_indices_from(curvature)] += 1e-9 * np.trace(curvature) / len(curvature) + 1e-300
    step = -cho_solve(cho_factor(curvature), slope)
    return step, float(-slope @ step)
