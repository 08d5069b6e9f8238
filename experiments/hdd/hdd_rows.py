"""Rows of the hard disk's linear programme: slack of each limit where it is near, with its exact slopes by ln L.

Margins are read at 0 dB crossings and at passages of the negative real axis, between nodes. Where |L| turns back just
before 1 there is no crossing, and its phase is that of a margin to come: such a graze is held away from 1.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from loopshape.core.units import Array, ComplexArray, db, deg, rad

#: rows nearer to their limit than this (dB, degrees) are seen by a step
NEAR_DB, NEAR_DEG = 2.5, 25.0
#: dB from 1 that |L| keeps where it turns back with less than the phase margin; degrees that weigh as much as 1 dB
GRAZE_DB, DEG_A_DB = 0.05, 6.0
_DB, _DEG = float(db(np.e)), float(deg(1.0))


@dataclass(frozen=True)
class Limits:
    """Peak of |S|, gain margin either way, phase margin at every plant; up to 1 kHz |S| (cases, n) at most `low_db`."""

    peak_db: float = 6.39
    gain_db: float = 6.5
    phase_deg: float = 48.0
    low_db: Array | None = None


@dataclass(frozen=True, eq=False)
class Rows:
    """Slacks (m,) of cases (m,), whose slopes are Re(a d ln L at node i + b d ln L at node i + 1)."""

    slack: Array
    case: np.ndarray
    i: np.ndarray
    a: ComplexArray
    b: ComplexArray


def rows_of(L: ComplexArray, limits: Limits, ceiling: Array) -> Rows:
    """All rows of L (cases, n), |S| under a `ceiling` (cases, n) in dB."""
    parts = [sharp(L, ceiling), unit(L, limits.phase_deg), axis(L, limits.gain_db), grazes(L, limits.phase_deg)]
    names = ("slack", "case", "i", "a", "b")
    return Rows(*(np.concatenate([getattr(one, name) for one in parts]) for name in names))


def sharp(L: ComplexArray, ceiling: Array) -> Rows:
    """|S| near its ceiling, in dB."""
    slack = ceiling + db(np.abs(1.0 + L))
    case, i = np.nonzero(slack < NEAR_DB)
    return Rows(slack[case, i], case, i, _DB * L[case, i] / (1.0 + L[case, i]), np.zeros(i.size, dtype=complex))


def unit(L: ComplexArray, phase_deg: float) -> Rows:
    """Phase margins at 0 dB crossings, in units of `DEG_A_DB` degrees."""
    ln = np.log(np.abs(L))
    case, i = np.nonzero(ln[:, 1:] * ln[:, :-1] < 0.0)
    step = np.log(L[case, i + 1] / L[case, i])
    share = -ln[case, i] / step.real
    phase = np.angle(-L[case, i]) + share * step.imag
    slope = np.sign(phase) * _DEG / DEG_A_DB * (-1j - step.imag / step.real)
    return Rows((deg(np.abs(phase)) - phase_deg) / DEG_A_DB, case, i, (1.0 - share) * slope, share * slope)


def axis(L: ComplexArray, gain_db: float) -> Rows:
    """Gain margins either way at passages of the negative real axis, in dB."""
    crossed = (L.imag[:, 1:] * L.imag[:, :-1] < 0.0) & (L.real[:, 1:] + L.real[:, :-1] < 0.0)
    case, i = np.nonzero(crossed)
    step = np.log(L[case, i + 1] / L[case, i])
    share = -np.angle(-L[case, i]) / step.imag
    size = np.log(np.abs(L[case, i])) + share * step.real
    side = np.where(np.abs(L[case, i]) > 1.0, 1.0, -1.0)
    slope = side * _DB * (1.0 + 1j * step.real / step.imag)
    return Rows(side * _DB * size - gain_db, case, i, (1.0 - share) * slope, share * slope)


def grazes(L: ComplexArray, phase_deg: float) -> Rows:
    """Turns of |L| towards 1 that do not reach it: away from 1, or with the phase margin, whichever is nearer.

    In dB and in units of `DEG_A_DB` degrees.
    """
    size, phase = db(np.abs(L)), np.angle(-L)
    before, after = np.diff(size)[:, :-1], np.diff(size)[:, 1:]
    back = (before * after <= 0.0) & ((after - before) * size[:, 1:-1] > 0.0) & (np.abs(size[:, 1:-1]) < NEAR_DB)
    case, i = np.nonzero(back & (np.abs(phase[:, 1:-1]) < rad(phase_deg + NEAR_DEG)))
    i += 1
    level, turn = size[case, i], phase[case, i]
    away, clear = np.abs(level) - GRAZE_DB, (deg(np.abs(turn)) - phase_deg) / DEG_A_DB
    slope = np.where(away > clear, np.sign(level) * _DB, -1j * np.sign(turn) * _DEG / DEG_A_DB)
    return Rows(np.maximum(away, clear), case, i, slope, np.zeros(i.size, dtype=complex))


@dataclass(frozen=True)
class Margins:
    """Peak of |S| in dB, least gain margin either way in dB, least phase margin in degrees of one case."""

    peak_db: float
    gain_db: float
    phase_deg: float


def margins(L: ComplexArray) -> Iterator[Margins]:
    """Of each case on the nodes, crossings between them interpolated."""
    for one in L[:, None]:
        peak = float(np.max(-db(np.abs(1.0 + one))))
        gain = float(np.min(axis(one, 0.0).slack, initial=np.inf))
        yield Margins(peak, gain, DEG_A_DB * float(np.min(unit(one, 0.0).slack, initial=np.inf)))
