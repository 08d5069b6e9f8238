"""Systems of other programs as blocks that stay as they are: zeros, poles and gain, state space, sections."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from loopshape.core.errors import WrongUseError
from loopshape.core.units import TWO_PI, Array, ComplexArray
from loopshape.data.control.block import BlockTemplate, Polynomial

#: poles of continuous and of discrete systems this near to s = 0, relative to the largest, are integrators
AT_ZERO, AT_ONE = 1e-12, 1e-9


def fixed(system: Any, *, rate_hz: float | None = None, prewarp_hz: float | None = None) -> tuple[BlockTemplate, ...]:
    """Blocks that run as a given system: sections of second order in series, with nothing left to tuning.

    `system` is a python-control or scipy system, (zeros, poles, gain) in rad/s, (A, B, C, D), or second-order sections
    (n, 6) as scipy has them, falling powers. With `rate_hz`, or a timebase of its own, it is discrete, and the blocks
    are exactly that at this rate, in a controller with the same `prewarp_hz`; else it is continuous, and runs after
    Tustin's rule like every block. Refuses several inputs or outputs, more zeros than poles, and unstable poles
    (integrators may stay), and what has a pole at half the rate.

    >>> import loopshape as ls
    >>> from scipy import signal
    >>> sos = signal.butter(4, 100.0, fs=1000.0, output="sos")
    >>> ls.controller(ls.gain(2.0), *ls.fixed(sos, rate_hz=1000.0), rate_hz=1000.0)
    Controller: gain, section, section at 1000 Hz
    """
    rate = _rate_hz(getattr(system, "dt", None), rate_hz)
    k = None if rate is None else _tustin_constant(rate, prewarp_hz)
    if isinstance(system, np.ndarray) and system.ndim == 2 and system.shape[1] == 6:
        return tuple(_of_row(row, k) for row in np.asarray(system, dtype=float))
    zeros, poles, gain = roots_of(system)
    if zeros.size > poles.size:
        raise WrongUseError(
            "a system with more zeros than poles cannot run (it is improper)",
            f"{zeros.size} zeros and {poles.size} poles",
            "add poles far above the band",
        )
    if k is not None:
        zeros, poles, gain = _continuous(zeros, poles, gain, k)
    return _sections(zeros, _settled(poles, AT_ZERO if k is None else AT_ONE, k or 0.0), gain)


def _rate_hz(dt: Any, rate_hz: float | None) -> float | None:
    """The rate of a discrete system, None of a continuous one; refuses two that differ, and a timebase without one."""
    if dt is True and rate_hz is None:
        raise WrongUseError("a discrete system needs its rate", "dt = True", "give rate_hz")
    own = 1.0 / float(dt) if isinstance(dt, (int, float)) and dt is not True and dt > 0.0 else None
    if own is not None and rate_hz is not None and abs(own - rate_hz) > 1e-9 * own:
        raise WrongUseError("a discrete system has its own rate", f"{own:g} and {rate_hz:g} Hz", "leave rate_hz out")
    return rate_hz if own is None else own


def _tustin_constant(rate_hz: float, prewarp_hz: float | None) -> float:
    from loopshape.data.control.block import Block
    from loopshape.data.control.controller import Controller

    return Controller("", (Block("gain", {"gain": 1.0}),), rate_hz, prewarp_hz=prewarp_hz).tustin_constant


def roots_of(system: Any) -> tuple[ComplexArray, ComplexArray, float]:
    """Zeros, poles and gain of whatever was given."""
    if isinstance(system, tuple) and len(system) == 4:
        return _of_states(*system)
    if isinstance(system, tuple) and len(system) == 3:
        z, p, gain = system
        return np.atleast_1d(np.asarray(z, dtype=complex)), np.atleast_1d(np.asarray(p, dtype=complex)), float(gain)
    if hasattr(system, "to_zpk"):
        made = system.to_zpk()
        return np.asarray(made.zeros, dtype=complex), np.asarray(made.poles, dtype=complex), float(made.gain)
    if hasattr(system, "num") and hasattr(system, "den"):
        return _of_polynomials(_alone(system.num), _alone(system.den))
    if all(hasattr(system, name) for name in "ABCD"):
        return _of_states(system.A, system.B, system.C, system.D)
    raise WrongUseError(
        "a fixed block comes from a system of python-control or scipy, zeros, poles and gain, (A, B, C, D) or sections",
        type(system).__name__,
    )


def _of_polynomials(num: Array, den: Array) -> tuple[ComplexArray, ComplexArray, float]:
    top, below = np.trim_zeros(num, "f"), np.trim_zeros(den, "f")
    if not top.size or not below.size:
        raise WrongUseError("a fixed block needs a numerator and a denominator", f"{num} over {den}")
    return np.roots(top).astype(complex), np.roots(below).astype(complex), float(top[0] / below[0])


def _of_states(A: ArrayLike, B: ArrayLike, C: ArrayLike, D: ArrayLike) -> tuple[ComplexArray, ComplexArray, float]:
    """Zeros are the finite generalised eigenvalues of the system's matrix; the gain follows from one value."""
    from scipy import linalg

    b, c = np.atleast_2d(np.asarray(B, dtype=float)), np.atleast_2d(np.asarray(C, dtype=float))
    if b.shape[1] != 1 or c.shape[0] != 1:
        raise WrongUseError("a fixed block has one input and one output", f"{b.shape[1]} and {c.shape[0]}", "take one")
    a, d = np.atleast_2d(np.asarray(A, dtype=float)), np.atleast_2d(np.asarray(D, dtype=float))
    poles = np.linalg.eigvals(a).astype(complex)
    left, right = np.block([[a, b], [c, d]]), np.zeros((len(a) + 1,) * 2)
    right[: len(a), : len(a)] = np.eye(len(a))
    with np.errstate(all="ignore"):
        found = np.asarray(linalg.eigvals(left, right), dtype=complex)
    largest = max(1.0, float(np.abs(poles).max(initial=0.0)))
    # zeros of a state space this many times farther out than its poles are at infinity
    zeros = found[np.isfinite(found) & (np.abs(found) < 1e6 * largest)]
    s = 2.0 * max(largest, float(np.abs(zeros).max(initial=0.0)))
    value = (c @ np.linalg.solve(s * np.eye(len(a)) - a, b) + d)[0, 0]
    return zeros, poles, float(np.real(value * np.prod(s - poles) / np.prod(s - zeros)))


def _alone(coefficients: Any) -> Array:
    """Coefficients of a transfer function, which python-control keeps in lists of lists."""
    found = coefficients
    while isinstance(found, (list, np.ndarray)) and len(found) and isinstance(found[0], (list, np.ndarray)):
        if len(found) != 1:
            raise WrongUseError("a fixed block has one input and one output", f"{len(found)}", "take one")
        found = found[0]
    return np.atleast_1d(np.asarray(found, dtype=float))


def _continuous(
    zeros: ComplexArray, poles: ComplexArray, gain: float, k: float
) -> tuple[ComplexArray, ComplexArray, float]:
    """Zeros, poles and gain in s of a discrete system, by z = (k + s)/(k - s); zeros at z = inf lie at s = k."""
    if np.any(np.abs(poles + 1.0) < AT_ONE):
        raise WrongUseError("a system with a pole at half the rate cannot run as blocks", "z = -1", "take it out")
    finite = zeros[np.abs(zeros + 1.0) >= AT_ONE]
    late, at_half = poles.size - zeros.size, zeros.size - finite.size
    scale = np.prod(1.0 + finite) * (2.0 * k) ** at_half * (-1.0) ** late / np.prod(1.0 + poles)
    moved = k * (finite - 1.0) / (finite + 1.0)
    return np.append(moved, np.full(late, k)), k * (poles - 1.0) / (poles + 1.0), float(np.real(gain * scale))


def _settled(poles: ComplexArray, near: float, scale: float) -> ComplexArray:
    """Poles with those that rounding moved off s = 0 put back; refuses unstable ones."""
    largest = max(scale, float(np.abs(poles).max(initial=0.0)))
    kept = np.where(np.abs(poles) <= near * largest, 0.0, poles)
    unstable = kept[(kept.real >= 0.0) & (kept != 0.0)]
    if unstable.size or int(np.sum(kept == 0.0)) > 2:
        raise WrongUseError(
            "a fixed block of a controller must be stable, with two integrators at most",
            f"poles at {', '.join(f'{pole:.4g}' for pole in kept)} rad/s",
        )
    return kept


def _sections(zeros: ComplexArray, poles: ComplexArray, gain: float) -> tuple[BlockTemplate, ...]:
    """Blocks of two poles each, one where their number is odd, with the zeros nearest to them; the first has the gain.

    A pair of zeros is placed before single ones, so that it finds two poles.
    """
    at_zero = min(int(np.sum(zeros == 0.0)), int(np.sum(poles == 0.0)))
    zeros, poles = _less(zeros, at_zero), _less(poles, at_zero)
    if not poles.size:
        return (BlockTemplate("gain", {"gain": gain}),)
    below, above = _groups(poles), [(z,) for z in zeros[zeros.imag == 0.0]]
    placed: list[list[complex]] = [[] for _ in below]
    for group in [*((z, z.conjugate()) for z in zeros[zeros.imag > 0.0]), *above]:
        free = [k for k, (own, den) in enumerate(zip(placed, below, strict=True)) if len(own) + len(group) <= len(den)]
        k = min(free, key=lambda k: min(abs(group[0] - pole) for pole in below[k]))
        placed[k] += group
    gains = [gain, *np.ones(len(below) - 1)]
    return tuple(
        _block(_polynomial(one, top), _polynomial(1.0, den)) for one, top, den in zip(gains, placed, below, strict=True)
    )


def _less(roots: ComplexArray, at_zero: int) -> ComplexArray:
    """Roots without so many at s = 0, rounding taken off conjugate pairs and real ones."""
    real = np.abs(roots.imag) <= 1e-9 * np.abs(roots)
    kept = np.where(real, roots.real, roots)
    return np.delete(kept, np.flatnonzero(kept == 0.0)[:at_zero])


def _groups(poles: ComplexArray) -> list[tuple[complex, ...]]:
    """Conjugate pairs, and real poles in twos by size."""
    real = sorted(poles[poles.imag == 0.0], key=abs)
    pairs = [tuple(real[k : k + 2]) for k in range(0, len(real), 2)]
    return [*((p, p.conjugate()) for p in poles[poles.imag > 0.0]), *pairs]


def _polynomial(gain: float, roots: Sequence[complex]) -> Polynomial:
    """Gain times the product of s - root, in rising powers."""
    falling = gain * np.real(np.poly(np.asarray(roots, dtype=complex))) if len(roots) else np.array([gain])
    n0, n1, n2 = [*falling[::-1].tolist(), 0.0, 0.0][:3]
    return (n0, n1, n2)


def _of_row(row: np.ndarray, k: float | None) -> BlockTemplate:
    """The block of one section with falling powers; discrete rows by z = (k + s)/(k - s), digit for digit."""
    if k is None:
        return _block(_rising(row[:3]), _rising(row[3:]))
    first = row[2] == row[5] == 0.0
    return _block(*(_from_z(part, k, first) for part in (row[:3], row[3:])))


def _from_z(p: np.ndarray, k: float, first: bool) -> Polynomial:
    if first:
        return (float(k * (p[0] + p[1])), float(p[0] - p[1]), 0.0)
    return (float(k * k * (p[0] + p[1] + p[2])), float(2.0 * k * (p[0] - p[2])), float(p[0] - p[1] + p[2]))


def _rising(p: np.ndarray) -> Polynomial:
    return (float(p[2]), float(p[1]), float(p[0]))


def _block(num: Polynomial, den: Polynomial) -> BlockTemplate:
    """A section scaled so that the largest coefficient of the denominator at 1 Hz is 1."""
    size = max(abs(c) * TWO_PI**k for k, c in enumerate(den)) or 1.0
    names = [f"{part}{k}" for part in "nd" for k in range(3)]
    made = BlockTemplate("section", dict(zip(names, (c / size for c in (*num, *den)), strict=True)))
    made.block({})
    return made
