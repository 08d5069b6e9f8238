"""Frequencies at which a bound looks at a plant, and what a free stable function Q makes of the loop there.

A loop with a stable plant is a choice of a stable CS = Q: S = 1 - P Q. Where the plant has unstable poles, all
controllers that stabilise it are C = (C0 + S0 Q/Y^2)/(1 - P S0 Q/Y^2) with one, C0, that does, S0 = 1/(1 + P C0) and
Y = s^k/(s + a)^k for C0's k integrators (Youla, Jabr and Bongiorno, IEEE Trans. Automatic Control 21(3), 1976).
Either way S and CS are affine in Q, a stable function of the discretised frequency, so the controllers
are all that can run at the rate, of whatever order.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from loopshape.core.errors import WrongUseError
from loopshape.core.units import TWO_PI, Array, ComplexArray, from_db
from loopshape.data.requirement.requirements import LIMITS, Requirements
from loopshape.loop.loop import Loop
from loopshape.loop.stability.stability import closed_loop_stability

#: nodes per decade between a plant's first and last line, and outside
WITHIN, OUTSIDE = 150, 50
#: decades below the first line that are looked at
BELOW = 2.0
#: limits that a bound counts; the others do not cut out a convex set of Q and are left out
COUNTED = (
    "sensitivity_peak_db", "modulus_margin", "complementary_peak_db", "control_peak_db", "control_high_frequency_db",
    "disk_margin", "process_peak_db", "sensitivity_bandwidth_hz",
)  # fmt: skip
LEFT_OUT = tuple(x.name for x in LIMITS if x.name not in (*COUNTED, "bandwidth_hz"))  # that it bounds itself


@dataclass(frozen=True, eq=False)
class Nodes:
    """Nodes (n,) of one plant in Hz, `s` their place after Tustin's rule, P, and S = s0 + s1 Q, CS = r0 + r1 Q.

    `P` is interpolated between lines (ln |P| and phase over ln f), goes on below them as the loop's model or
    its integrators do, and above them falls on as over its last lines; `inside` marks the lines' band.
    """

    f: Array
    s: ComplexArray
    P: ComplexArray
    inside: np.ndarray
    s0: ComplexArray
    s1: ComplexArray
    r0: ComplexArray
    r1: ComplexArray


def nodes(loop: Loop, limits: Requirements, *, halved: bool = False, within: int = WITHIN) -> Nodes:
    """Nodes of a loop, or these and those midway between; jumps of the limits have a node on either side."""
    f = _frequencies(loop, limits, within)
    if halved:
        f = np.sort(np.concatenate([f, np.sqrt(f[:-1] * f[1:])]))
    P, s = plant_at(loop, f), loop.controller.s_at(f)
    first, last = loop.frequency_hz[[0, -1]]
    s0, s1, r0, r1 = _about_controller(loop, f, s, P) if loop.unstable_poles else _itself(loop, f, s, P)
    return Nodes(f, s, P, (f >= first) & (f <= last), s0, s1, r0, r1)


def _itself(loop: Loop, f: Array, s: ComplexArray, P: ComplexArray) -> tuple[ComplexArray, ...]:
    """S = 1 - P Q, CS = Q, for a plant without unstable poles; the limits on S alone hold Q to the integrators."""
    one, zero = np.ones_like(P), np.zeros_like(P)
    return one, -P, zero, one


def _about_controller(loop: Loop, f: Array, s: ComplexArray, P: ComplexArray) -> tuple[ComplexArray, ...]:
    stability = closed_loop_stability(loop)
    if stability.outcome != "stable":
        raise WrongUseError(
            f"a bound for the unstable plant {loop.plant.recording} needs a controller that is known to stabilise it",
            f"{stability.outcome}: {stability.reason}",
        )
    C0 = loop.controller.response(f)
    S0 = 1.0 / (1.0 + P * C0)
    corner = abs(loop.controller.s_at(loop.frequency_hz[:1])[0])
    Y = (s / (s + corner)) ** loop.controller.integrators()
    return S0, -P * (S0 / Y) ** 2, C0 * S0, (S0 / Y) ** 2


def _frequencies(loop: Loop, limits: Requirements, count: int) -> Array:
    first, last = loop.frequency_hz[[0, -1]]
    rate = loop.controller.rate_hz
    w = np.geomspace(loop.controller.s_at(last).imag, 20.0 * rate, num=round(OUTSIDE * np.log10(20.0 * rate / last)))
    within = np.geomspace(first, last, round(count * np.log10(last / first)) + 2)
    below = np.geomspace(first * 10.0**-BELOW, first, round(OUTSIDE * BELOW), endpoint=False)
    above = np.arctan(w[1:] / (2.0 * rate)) * rate / (0.5 * TWO_PI)  # evenly where Tustin's rule puts them
    jumps = [x for x in (limits.control_high_frequency_from_hz, limits.sensitivity_bandwidth_hz) if x is not None]
    beside = [x * (1.0 + side) for x in (last, *jumps) for side in (-1e-9, 1e-9)]
    every = np.unique(np.concatenate([below, within, above, beside]))
    return every[every <= above[-1]]


def plant_at(loop: Loop, f: Array) -> ComplexArray:
    """P (nf,) at any frequency: interpolated between lines, continued outside them (see `Nodes`)."""
    lines, P = loop.frequency_hz, loop.plant.siso
    size, phase = np.log(np.abs(P)), np.unwrap(np.angle(P))
    found = np.exp(np.interp(np.log(f), np.log(lines), size) + 1j * np.interp(np.log(f), np.log(lines), phase))
    low, high = f < lines[0], f > lines[-1]
    found[low] = _below(loop, f[low])
    tail = lines > lines[-1] / 2.0
    slope = np.polyfit(np.log(lines[tail]), size[tail], 1)[0] if tail.sum() > 1 else 0.0
    found[high] *= (f[high] / lines[-1]) ** min(float(slope), 0.0)
    return np.asarray(found)


def _below(loop: Loop, f: Array) -> ComplexArray:
    first, P = float(loop.frequency_hz[0]), complex(loop.plant.siso[0])
    if loop.model is not None:
        return np.asarray(loop.model.response(f) * P / loop.model.response(np.array([first])))
    order = loop.integrators or 0
    rest = np.angle(P * 1j**order)  # phase beyond the integrators', taken to die out towards zero frequency
    return np.asarray(abs(P) * (first / f) ** order * (-1j) ** order * np.exp(1j * rest * f / first))


@dataclass(frozen=True, eq=False)
class Ceilings:
    """Largest |S|, |CS| and |S - 1/2| (n,) allowed at nodes; inf where nothing is asked."""

    S: Array
    CS: Array
    disk: float


def ceilings(limits: Requirements, f: Array, P: ComplexArray) -> Ceilings:
    """What the counted limits allow at frequencies f for a plant P: |T| and |PS| become limits on |CS| and |S|."""
    size = np.abs(P)
    S = np.full(f.size, _largest_sensitivity(limits))
    if limits.process_peak_db is not None:
        S = np.minimum(S, from_db(limits.process_peak_db) / size)
    if limits.sensitivity_bandwidth_hz is not None:
        S = np.where(f < limits.sensitivity_bandwidth_hz, np.minimum(S, np.sqrt(0.5)), S)
    CS = np.full(f.size, _linear(limits.control_peak_db))
    if limits.control_high_frequency_from_hz is not None:
        high = f >= limits.control_high_frequency_from_hz
        CS = np.where(high, np.minimum(CS, _linear(limits.control_high_frequency_db)), CS)
    CS = np.minimum(CS, _linear(limits.complementary_peak_db) / size)
    return Ceilings(S, CS, np.inf if limits.disk_margin is None else 1.0 / limits.disk_margin)


def ceiling_above(limits: Requirements, f: Array, P: ComplexArray) -> Array:
    """Largest |CS| above the last line: what is asked, or what |L| <= l, its last value, leaves: l/(1 - l)/|P|.

    The requirements bound l: |S| there counts as 1/(1 - l), |T| as l/(1 - l), the gain margin is 1/l at most and the
    disk margin 2 (1 - l)/(1 + l).
    """
    asked = ceilings(limits, f, P).CS
    last = 1.0 - 1.0 / max(_largest_sensitivity(limits), 1.0)
    T = _linear(limits.complementary_peak_db)
    last = min(last, T / (1.0 + T) if np.isfinite(T) else 1.0, 1.0 / _linear(limits.gain_margin_db or 0.0))
    disk = limits.disk_margin or 0.0
    last = min(last, (2.0 - disk) / (2.0 + disk))
    left = np.full(f.size, np.inf) if last >= 1.0 else last / (1.0 - last) / np.abs(P)
    return np.where(np.isfinite(asked), asked, left)


def _largest_sensitivity(limits: Requirements) -> float:
    modulus = np.inf if limits.modulus_margin is None else 1.0 / limits.modulus_margin
    return min(_linear(limits.sensitivity_peak_db), modulus)


def _linear(decibel: float | None) -> float:
    return np.inf if decibel is None else float(from_db(decibel))


def counted(limits: Requirements) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Names of the limits that a bound counts, and of those asked for that it leaves out."""
    asked = {name for name in (*COUNTED, *LEFT_OUT) if getattr(limits, name) is not None}
    return tuple(n for n in COUNTED if n in asked), tuple(n for n in LEFT_OUT if n in asked)


def impossible(limits: Requirements) -> tuple[str, ...]:
    """Names of the limits that no loop with a bandwidth keeps, whatever its plant.

    A sampled loop answers late, so S is 1 at z = inf, and by the maximum modulus principle |S| <= 1, or
    |S - 1/2| <= 1/2, at all frequencies leaves S = 1 alone: a controller that does nothing.
    """
    given = {name: getattr(limits, name) for name in ("sensitivity_peak_db", "modulus_margin", "disk_margin")}
    ends = {"sensitivity_peak_db": (-1.0, 0.0), "modulus_margin": (1.0, 1.0), "disk_margin": (1.0, 2.0)}
    return tuple(name for name, value in given.items() if value is not None and ends[name][0] * value >= ends[name][1])


def spans(loops: Sequence[Loop], f: Array) -> tuple[ComplexArray, np.ndarray]:
    """P of several loops at frequencies f (loops, nf), and where each has lines (loops, nf)."""
    band = np.array([(f >= one.frequency_hz[0]) & (f <= one.frequency_hz[-1]) for one in loops])
    return np.array([plant_at(one, f) for one in loops]), band


def weights(s: ComplexArray) -> tuple[Array, Array]:
    """Trapezoidal steps (n,) in ln w of nodes jw, and weights (n,) of an integral over w; both ends closed.

    Below the first node the integrand is taken constant, above the last one it falls as w^-2.
    """
    w = s.imag
    step = np.diff(np.log(w))
    du = np.maximum(0.5 * (np.append(step, 0.0) + np.append(0.0, step)), 1e-12)
    dw = w * du
    dw[0] += w[0]
    dw[-1] += w[-1]
    return du, dw
